"""Schema-driven traffic routing: paper A, section 4.1. `sfglab.fleet.policy` decides what is forwarded."""

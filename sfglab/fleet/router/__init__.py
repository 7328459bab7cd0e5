"""Schema-driven traffic routing: paper A, section 4.1. What crosses is said by `sfglab.fleet.policy`."""

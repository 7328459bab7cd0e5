"""Configurations for other people's routers, generated from and checked against the policy of the fleet.

What a router cannot express is refused, not approximated: see each generator.
"""

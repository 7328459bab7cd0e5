"""Deployment of a real fleet (paper A, section 4.4): images, containers, hosts, routers, checks and rollout."""

"""Configurations for other people's routers, from the fleet's policy; what one cannot express is refused."""

"""Configurations for other people's routers, generated from and checked against the policy of the fleet.

What a router cannot express is refused, not approximated: see each generator.
"""

from __future__ import annotations

from sfglab.deploy.routers.dds_router import render_dds_router
from sfglab.deploy.routers.dds_router_check import check_dds_router
from sfglab.deploy.routers.domain_bridge import render_domain_bridge
from sfglab.deploy.routers.targets import ROUTER_FILES, TARGETS, check_file, render_router, render_router_file
from sfglab.deploy.routers.zenoh import render_zenoh_acl, render_zenoh_bridge
from sfglab.deploy.routers.zenoh_check import check_zenoh

__all__ = [
    "ROUTER_FILES",
    "TARGETS",
    "check_dds_router",
    "check_file",
    "check_zenoh",
    "render_dds_router",
    "render_domain_bridge",
    "render_router",
    "render_router_file",
    "render_zenoh_acl",
    "render_zenoh_bridge",
]

"""Fleets: the nodes that every agent of a fleet runs (paper A, section 4), and the file that describes a fleet.

A public name is loaded from its module at its first use, because a process that needs one module of this
package starts faster without the others.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.lazy import loader

__all__ = [
    "TABLE_1",
    "AgentDescription",
    "AgentDiscoverer",
    "DecoderConfig",
    "Direction",
    "DiscoverySettings",
    "Fleet",
    "ForwardRule",
    "Offered",
    "Policy",
    "Router",
    "RouterSettings",
    "StatusProvider",
    "StatusSettings",
    "Withdrawn",
    "agent_changes",
    "discovery_topic",
    "load_fleet",
    "run_decoder",
]

_MODULES = {
    "TABLE_1": "policy",
    "AgentDescription": "status.description",
    "AgentDiscoverer": "discovery.node",
    "DecoderConfig": "decoder.config",
    "Direction": "policy",
    "DiscoverySettings": "discovery.config",
    "Fleet": "fleet_file",
    "ForwardRule": "policy",
    "Offered": "discovery.listener",
    "Policy": "policy",
    "Router": "router.node",
    "RouterSettings": "router.config",
    "StatusProvider": "status.node",
    "StatusSettings": "status.config",
    "Withdrawn": "discovery.listener",
    "agent_changes": "discovery.listener",
    "discovery_topic": "discovery.listener",
    "load_fleet": "fleet_file",
    "run_decoder": "decoder.node",
}

if TYPE_CHECKING:
    from sfglab.fleet.decoder.config import DecoderConfig
    from sfglab.fleet.decoder.node import run_decoder
    from sfglab.fleet.discovery.config import DiscoverySettings
    from sfglab.fleet.discovery.listener import Offered, Withdrawn, agent_changes, discovery_topic
    from sfglab.fleet.discovery.node import AgentDiscoverer
    from sfglab.fleet.fleet_file import Fleet, load_fleet
    from sfglab.fleet.policy import TABLE_1, Direction, ForwardRule, Policy
    from sfglab.fleet.router.config import RouterSettings
    from sfglab.fleet.router.node import Router
    from sfglab.fleet.status.config import StatusSettings
    from sfglab.fleet.status.description import AgentDescription
    from sfglab.fleet.status.node import StatusProvider
else:
    __getattr__ = loader(__name__, _MODULES)

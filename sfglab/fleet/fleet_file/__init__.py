"""The fleet file: one description of all agents, from which checks, routers and metadata come."""

from __future__ import annotations

from sfglab.fleet.fleet_file.deployment import (
    AUTO,
    Accelerator,
    Architecture,
    ContainerNetwork,
    DeploymentSpec,
    HostSpec,
    RosDistribution,
    RouterSoftware,
)
from sfglab.fleet.fleet_file.model import (
    MAX_DOMAIN,
    AgentSpec,
    Fleet,
    FrameSpec,
    FrameTree,
    NameUse,
    SensorSpec,
    StreamSpec,
    TopicUse,
    UnknownAgentError,
    load_fleet,
    read_fleet,
)

__all__ = [
    "AUTO",
    "MAX_DOMAIN",
    "Accelerator",
    "AgentSpec",
    "Architecture",
    "ContainerNetwork",
    "DeploymentSpec",
    "Fleet",
    "FrameSpec",
    "FrameTree",
    "HostSpec",
    "NameUse",
    "RosDistribution",
    "RouterSoftware",
    "SensorSpec",
    "StreamSpec",
    "TopicUse",
    "UnknownAgentError",
    "load_fleet",
    "read_fleet",
]

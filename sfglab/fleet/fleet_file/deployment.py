"""Where a fleet runs: the machine of each agent, and what is the same on all of them (paper A, section 4.4).

Says what a fleet file says; what follows from it (images, containers, services) is for `sfglab.deploy`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from sfglab.documents import NOWHERE, Place


class Architecture(Enum):
    """A processor architecture, by its name in container images."""

    AMD64 = "amd64"
    ARM64 = "arm64"


class Accelerator(Enum):
    """What a machine has beside its processor that can encode, decode or compute."""

    JETSON = "jetson"
    CUDA = "cuda"
    ROCM = "rocm"
    VAAPI = "vaapi"
    V4L2 = "v4l2"
    NONE = "none"


class RosDistribution(Enum):
    """The ROS 2 distribution inside the images, for the user's own nodes: sfglab needs none."""

    NONE = "none"
    HUMBLE = "humble"
    JAZZY = "jazzy"


class RouterSoftware(Enum):
    """What runs in an agent's second container."""

    SFGLAB = "sfglab"
    DDS_ROUTER = "dds-router"
    ZENOH_BRIDGE = "zenoh-bridge"


class ContainerNetwork(Enum):
    """Which network the agent's container sees."""

    BRIDGE = "bridge"
    HOST = "host"


@dataclass(frozen=True, slots=True, kw_only=True)
class HostSpec:
    """The machine that an agent runs on."""

    model: str = ""  #: Maker and model, for people.
    address: str = ""  #: Where SSH reaches it, ``[user@]host``; empty: it is this machine.
    architecture: Architecture = Architecture.AMD64  #: Its processor's.
    accelerator: Accelerator | None = None  #: What it has; None leaves it to detection.
    #: What the agent's container sees: a bridge of its own, or, for robots whose own controllers speak DDS over
    #: a cable, the host's interfaces.
    network: ContainerNetwork = ContainerNetwork.BRIDGE
    #: Device nodes that the agent needs beside its accelerator's, as in ``/dev/video0``.
    devices: tuple[str, ...] = ()
    workspace: str = ""  #: Folder of the user's colcon workspace, relative to the fleet file; empty: none.
    packages: tuple[str, ...] = ()  #: Debian packages that the agent's own software needs.
    #: Program and arguments of the user's software, beside the agent; empty: none.
    launch: tuple[str, ...] = ()
    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Where it stands.


@dataclass(frozen=True, slots=True, kw_only=True)
class DeploymentSpec:
    """What is the same for all machines of a fleet."""

    #: Where its images belong, a repository prefix as in ``localhost/esslingen``.
    images: str = "localhost/fleet"
    ros: RosDistribution = RosDistribution.NONE  #: The ROS 2 distribution inside the images.
    router: RouterSoftware = RouterSoftware.SFGLAB  #: What runs in the second container.
    router_image: str = ""  #: Image of another's router; empty for our own.
    time_servers: tuple[str, ...] = ()  #: Agents or hosts whose clocks count.
    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Where it stands.

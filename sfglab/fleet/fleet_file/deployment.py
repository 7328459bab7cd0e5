"""Places of a fleet: the machine of each agent, and what is the same on all of them (paper A, section 4.4).

Says what a fleet file's sections ``deployment`` and ``host`` say, and refuses what no machine could take; what
follows from it (images, containers, services) is for `sfglab.deploy`.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from enum import Enum

from sfglab.documents import NOWHERE, Place, Section, matching, read_by

AUTO = "auto"
"""In place of an accelerator's name: found out on the machine."""
_COMPONENT = r"[a-z0-9]+(?:(?:\.|_{1,2}|-+)[a-z0-9]+)*"
_REGISTRY = r"[a-zA-Z0-9](?:[a-zA-Z0-9.-]*[a-zA-Z0-9])?(?::[0-9]{1,5})?"
REPOSITORY = re.compile(rf"(?:{_REGISTRY}/)?{_COMPONENT}(?:/{_COMPONENT})*")
"""A repository of images (OCI Distribution Specification 1.1, "Pulling manifests")."""
IMAGE = re.compile(rf"{REPOSITORY.pattern}(?::[\w][\w.-]{{0,127}})?(?:@sha256:[0-9a-f]{{64}})?", re.ASCII)
ADDRESS = re.compile(r"(?:[a-z_][a-z0-9_-]*@)?[A-Za-z0-9](?:[A-Za-z0-9.-]*[A-Za-z0-9])?")
HOST = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9.:-]*[A-Za-z0-9])?")
DEVICE = re.compile(r"/dev/(?!(?:.*/)?\.\.(?:/|$))[A-Za-z0-9][A-Za-z0-9._/-]*")
PACKAGE = re.compile(r"[a-z0-9][a-z0-9+.-]+")  # Debian Policy 5.6.7
FOLDER = re.compile(r"[\w][\w./ -]*", re.ASCII)


def _read_accelerator(section: Section, key: str) -> Accelerator | None:
    choices = (AUTO, *(member.value for member in Accelerator))
    name = section.text(key, choices=choices)
    return None if name == AUTO else Accelerator(name)


def _read_folder(section: Section, key: str) -> str:
    folder: str = section.text(key)
    if not FOLDER.fullmatch(folder):
        raise section.refusal(key, folder, "a folder beside the fleet file")
    if ".." in folder.split("/"):
        raise section.refusal(key, folder, "a folder beside the fleet file, not above it")
    return folder


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
    #: Where SSH reaches it, ``[user@]host``; empty: it is this machine.
    address: str = field(default="", metadata=matching(ADDRESS, "[user@]host, as ssh takes it"))
    architecture: Architecture = Architecture.AMD64  #: Its processor's.
    #: What it has; None leaves it to detection.
    accelerator: Accelerator | None = field(default=None, metadata=read_by(_read_accelerator))
    #: What the agent's container sees: a bridge of its own, or, for robots whose own controllers speak DDS over
    #: a cable, the host's interfaces.
    network: ContainerNetwork = ContainerNetwork.BRIDGE
    #: Device nodes that the agent needs beside its accelerator's, as in ``/dev/video0``.
    devices: tuple[str, ...] = field(default=(), metadata=matching(DEVICE, "device nodes, as in /dev/video0"))
    #: Folder of the user's colcon workspace, relative to the fleet file; empty: none.
    workspace: str = field(default="", metadata=read_by(_read_folder))
    #: Debian packages that the agent's own software needs.
    packages: tuple[str, ...] = field(default=(), metadata=matching(PACKAGE, "names of Debian packages"))
    #: Program and arguments of the user's software, beside the agent; empty: none.
    launch: tuple[str, ...] = ()
    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Where it stands.


@dataclass(frozen=True, slots=True, kw_only=True)
class DeploymentSpec:
    """What is the same for all machines of a fleet."""

    #: Where its images belong, a repository prefix as in ``localhost/esslingen``.
    images: str = field(
        default="localhost/fleet",
        metadata=matching(REPOSITORY, "a repository of images, as in localhost/esslingen"),
    )
    ros: RosDistribution = RosDistribution.NONE  #: The ROS 2 distribution inside the images.
    router: RouterSoftware = RouterSoftware.SFGLAB  #: What runs in the second container.
    #: Image of another's router; empty for our own.
    router_image: str = field(default="", metadata=matching(IMAGE, "an image, as in ubuntu-ddsrouter:v3.5.0"))
    #: Agents or hosts whose clocks count.
    time_servers: tuple[str, ...] = field(
        default=(), metadata=matching(HOST, "agents' or hosts' names or addresses")
    )
    place: Place = field(default=NOWHERE, compare=False, repr=False)  #: Where it stands.


def read_deployment(section: Section, fleet: str) -> DeploymentSpec:
    """Read what is the same for all machines; without the section, everything has its default.

    Args:
        section: The section ``deployment``.
        fleet: Name of the fleet, after which its images are called when nothing else is said.

    Raises:
        DocumentError: A key is unknown, or what stands there is not allowed.
    """
    name = re.sub("[^a-z0-9]+", "-", fleet.lower()).strip("-") or "fleet"
    return section.read(DeploymentSpec, **({} if section.has("images") else {"images": f"localhost/{name}"}))

"""From a fleet file's sections ``deployment`` and ``host`` to values; refuses what no machine could take."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from sfglab.fleet.fleet_file.deployment import (
    Accelerator,
    Architecture,
    ContainerNetwork,
    DeploymentSpec,
    HostSpec,
    RosDistribution,
    RouterSoftware,
)

if TYPE_CHECKING:
    from sfglab.documents import Section


AUTO = "auto"
"""In place of an accelerator's name: found out on the machine."""
_COMPONENT = r"[a-z0-9]+(?:(?:\.|_{1,2}|-+)[a-z0-9]+)*"
_REGISTRY = r"[a-zA-Z0-9](?:[a-zA-Z0-9.-]*[a-zA-Z0-9])?(?::[0-9]{1,5})?"
REPOSITORY = re.compile(rf"(?:{_REGISTRY}/)?{_COMPONENT}(?:/{_COMPONENT})*")
"""A repository of images (OCI Distribution Specification 1.1, "Pulling manifests")."""
IMAGE = re.compile(rf"{REPOSITORY.pattern}(?::[\w][\w.-]{{0,127}})?(?:@sha256:[0-9a-f]{{64}})?", re.ASCII)
ADDRESS = re.compile(r"(?:[a-z_][a-z0-9_-]*@)?[A-Za-z0-9](?:[A-Za-z0-9.-]*[A-Za-z0-9])?")
HOST = re.compile(r"[A-Za-z0-9](?:[A-Za-z0-9.:-]*[A-Za-z0-9])?")
DEVICE = re.compile(r"/dev/[A-Za-z0-9][A-Za-z0-9._/-]*")
PACKAGE = re.compile(r"[a-z0-9][a-z0-9+.-]+")  # Debian Policy 5.6.7
FOLDER = re.compile(r"[\w][\w./ -]*", re.ASCII)


def read_deployment(section: Section, fleet: str) -> DeploymentSpec:
    """Read what is the same for all machines; without the section, everything has its default.

    Args:
        section: The section ``deployment``.
        fleet: Name of the fleet, after which its images are called when nothing else is said.

    Raises:
        DocumentError: A key is unknown, or what stands there is not allowed.
    """
    deployment = DeploymentSpec(
        images=_matching(section, "images", REPOSITORY, "a repository of images, as in localhost/esslingen")
        or f"localhost/{re.sub('[^a-z0-9]+', '-', fleet.lower()).strip('-') or 'fleet'}",
        ros=section.choice("ros", RosDistribution.NONE),
        router=section.choice("router", RouterSoftware.SFGLAB),
        router_image=_matching(section, "router_image", IMAGE, "an image, as in ubuntu-ddsrouter:v3.5.0"),
        time_servers=_all_matching(section, "time_servers", HOST, "agents' or hosts' names or addresses"),
        place=section.here,
    )
    section.close()
    return deployment


def read_host(section: Section) -> HostSpec:
    """Read the machine of one agent.

    Args:
        section: The section ``host``.

    Raises:
        DocumentError: A key is unknown, or what stands there is not allowed.
    """
    host = HostSpec(
        model=section.text("model", ""),
        address=_matching(section, "address", ADDRESS, "[user@]host, as ssh takes it"),
        architecture=section.choice("architecture", Architecture.AMD64),
        accelerator=_accelerator(section),
        network=section.choice("network", ContainerNetwork.BRIDGE),
        devices=_all_matching(section, "devices", DEVICE, "device nodes, as in /dev/video0"),
        workspace=_folder(section, "workspace"),
        packages=_all_matching(section, "packages", PACKAGE, "names of Debian packages"),
        launch=section.texts("launch"),
        place=section.here,
    )
    section.close()
    return host


def _accelerator(section: Section) -> Accelerator | None:
    choices = (AUTO, *(member.value for member in Accelerator))
    name = section.text("accelerator", AUTO, choices=choices)
    return None if name == AUTO else Accelerator(name)


def _folder(section: Section, key: str) -> str:
    folder = _matching(section, key, FOLDER, "a folder beside the fleet file")
    if ".." in folder.split("/"):
        raise section.refusal(key, folder, "a folder beside the fleet file, not above it")
    return folder


def _matching(section: Section, key: str, pattern: re.Pattern[str], allowed: str) -> str:
    text: str = section.text(key, "")
    if text and not pattern.fullmatch(text):
        raise section.refusal(key, text, allowed)
    return text


def _all_matching(section: Section, key: str, pattern: re.Pattern[str], allowed: str) -> tuple[str, ...]:
    texts = section.texts(key)
    for text in texts:
        if not pattern.fullmatch(text) or ".." in text.split("/"):
            raise section.refusal(key, text, allowed)
    return texts

"""Fleets that must not pass, each by one change of the paper's fleet file, and what the refusal must name."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.deploy.fleet_check import check_fleet
from sfglab.deploy.preparing import load_source
from sfglab.deploy.verdicts import State
from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from sfglab.deploy.deployment import Release


@dataclass(frozen=True, slots=True)
class BrokenFleet:
    """One change."""

    fault: str  #: What is wrong with it, for people.
    old: str  #: What stands in the paper's fleet file.
    new: str  #: What stands there instead.
    words: tuple[str, ...]  #: What the refusal must say: where, what is given or what is allowed.


BROKEN = (
    BrokenFleet(
        "an accelerator that is misspelled",
        "accelerator: jetson",
        "accelerator: jetsn",
        ("agents.go2.host.accelerator", "'jetsn'", "did you mean 'jetson'?"),
    ),
    BrokenFleet(
        "a Jetson with the workstation's processor",
        "architecture: arm64\n      accelerator: jetson",
        "architecture: amd64\n      accelerator: jetson",
        ("go2", "jetson", "amd64", "arm64"),
    ),
    BrokenFleet(
        "a ROS 2 distribution that no Jetson base has", "ros: humble", "ros: jazzy", ("go2", "jazzy", "humble")
    ),
    BrokenFleet(
        "an agent without a machine",
        "    host: {model: Steam Deck OLED, address: deck@steamdeck.local, accelerator: vaapi}\n",
        "",
        ("agents.steamdeck", "which machine"),
    ),
    BrokenFleet(
        "another's router without its image",
        "router: sfglab",
        "router: dds-router",
        ("deployment", "dds-router", "router_image"),
    ),
    BrokenFleet(
        "a router's image whose meaning moves",
        "router: sfglab",
        "router: dds-router\n  router_image: ubuntu-ddsrouter:latest",
        ("ubuntu-ddsrouter:latest", "no fixed tag"),
    ),
    BrokenFleet(
        "a repository that registries refuse",
        "images: localhost/esslingen",
        "images: localhost/Esslingen",
        ("deployment.images", "'localhost/Esslingen'", "a repository of images"),
    ),
    BrokenFleet("two agents that share a domain", "    domain: 12\n", "    domain: 11\n", ("pi2", "domain 11")),
    BrokenFleet(
        "an agent inside the global domain",
        "    domain: 21\n",
        "    domain: 0\n",
        ("steamdeck", "the global one"),
    ),
    BrokenFleet(
        "one machine that is two things",
        "address: sfg@pi2.local",
        "address: sfg@go2.local",
        ("pi2", "go2", "different hardware"),
    ),
    BrokenFleet(
        "no interface towards the other agents",
        "global: {domain: 0, interface: wlan0}",
        "global: {domain: 0}",
        ("which interface", "go2", "global_interface"),
    ),
    BrokenFleet(
        "a workspace that is not there",
        "      devices: [/dev/bus/usb]",
        "      workspace: go2_ws\n      devices: [/dev/bus/usb]",
        ("go2", "go2_ws/src"),
    ),
    BrokenFleet(
        "a package's name that is a command",
        "      devices: [/dev/bus/usb]",
        "      packages: ['g++; reboot']\n      devices: [/dev/bus/usb]",
        ("agents.go2.host.packages", "g++; reboot", "Debian packages"),
    ),
    BrokenFleet(
        "a device that is none",
        "[/dev/bus/usb]",
        "[/etc/passwd]",
        ("agents.go2.host.devices", "/etc/passwd", "device nodes"),
    ),
    BrokenFleet(
        "a time server that nobody can reach",
        "address: sfg@workstation.local\n      ",
        "",
        ("workstation", "time", "address"),
    ),
    BrokenFleet(
        "a policy that a DDS Router cannot express",
        "policy: table-1",
        "policy: [rt/tf, rt/tf_static, rt/global/*, rq/global/*, rr/global/*,\n"
        "  {pattern: rt/diagnostics, directions: [outward]}]",
        ("directions", "DDS Router"),
    ),
)
"""Each is one change; the last is given a DDS Router by `break_fleet` as well."""


def break_fleet(text: str, broken: BrokenFleet) -> str:
    """Return a fleet file with one fault.

    Args:
        text: The paper's fleet file.
        broken: The fault.

    Raises:
        ValueError: The paper's fleet file has changed, so that there is nothing to replace.
    """
    if text.count(broken.old) != 1:
        raise ValueError(f"{broken.fault}: {broken.old!r} stands {text.count(broken.old)} times in the file")
    text = text.replace(broken.old, broken.new)
    if "directions" in broken.new:
        image = "router: dds-router\n  router_image: ubuntu-ddsrouter:v3.5.0"
        return text.replace("router: sfglab", image)
    return text


def refused_rows(text: str, release: Release, folder: Path) -> Iterator[dict[str, Any]]:
    """Yield what is said of each broken fleet.

    Args:
        text: The paper's fleet file.
        release: What would be deployed.
        folder: For the broken files.
    """
    for number, broken in enumerate(BROKEN):
        path = folder / f"broken{number}.yaml"
        path.write_text(break_fleet(text, broken), encoding="utf-8")
        said = _refusal(path, release).replace(f"{path}", "fleet.yaml")
        refused = bool(said) and all(word in said for word in broken.words)
        yield {"fault": broken.fault, "refused": refused, "said": said}


def _refusal(path: Path, release: Release) -> str:
    """Return why a fleet is refused, or nothing."""
    try:
        verdicts = check_fleet(load_source(path), release)
    except SfglabError as error:
        return str(error)
    return "; ".join(dict.fromkeys(v.says for v in verdicts if v.state is State.FAILS))

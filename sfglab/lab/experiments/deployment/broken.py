"""Fleets that must not pass, each by one change of the paper's fleet file, and what the refusal must name."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class BrokenFleet:
    """One change."""

    fault: str  #: What is wrong with it, for people.
    old: str  #: What stands in the paper's fleet file.
    new: str  #: What stands there instead.
    words: tuple[str, ...]  #: What the refusal must say: where, what is given or what is allowed.


BROKEN = (
    BrokenFleet(
        fault="an accelerator that is misspelled",
        old="accelerator: jetson",
        new="accelerator: jetsn",
        words=("agents.go2.host.accelerator", "'jetsn'", "did you mean 'jetson'?"),
    ),
    BrokenFleet(
        fault="a Jetson with the workstation's processor",
        old="architecture: arm64\n      accelerator: jetson",
        new="architecture: amd64\n      accelerator: jetson",
        words=("go2", "jetson", "amd64", "arm64"),
    ),
    BrokenFleet(
        fault="a ROS 2 distribution that no Jetson base has",
        old="ros: humble",
        new="ros: jazzy",
        words=("go2", "jazzy", "humble"),
    ),
    BrokenFleet(
        fault="an agent without a machine",
        old="    host: {model: Steam Deck OLED, address: deck@steamdeck.local, accelerator: vaapi}\n",
        new="",
        words=("agents.steamdeck", "which machine"),
    ),
    BrokenFleet(
        fault="another's router without its image",
        old="router: sfglab",
        new="router: dds-router",
        words=("deployment", "dds-router", "router_image"),
    ),
    BrokenFleet(
        fault="a router's image whose meaning moves",
        old="router: sfglab",
        new="router: dds-router\n  router_image: ubuntu-ddsrouter:latest",
        words=("ubuntu-ddsrouter:latest", "no fixed tag"),
    ),
    BrokenFleet(
        fault="a repository that registries refuse",
        old="images: localhost/esslingen",
        new="images: localhost/Esslingen",
        words=("deployment.images", "'localhost/Esslingen'", "a repository of images"),
    ),
    BrokenFleet(
        fault="two agents that share a domain",
        old="    domain: 12\n",
        new="    domain: 11\n",
        words=("pi2", "domain 11"),
    ),
    BrokenFleet(
        fault="an agent inside the global domain",
        old="    domain: 21\n",
        new="    domain: 0\n",
        words=("steamdeck", "the global one"),
    ),
    BrokenFleet(
        fault="one machine that is two things",
        old="address: sfg@pi2.local",
        new="address: sfg@go2.local",
        words=("pi2", "go2", "different hardware"),
    ),
    BrokenFleet(
        fault="no interface towards the other agents",
        old="global: {domain: 0, interface: wlan0}",
        new="global: {domain: 0}",
        words=("which interface", "go2", "global_interface"),
    ),
    BrokenFleet(
        fault="a workspace that is not there",
        old="      devices: [/dev/bus/usb]",
        new="      workspace: go2_ws\n      devices: [/dev/bus/usb]",
        words=("go2", "go2_ws/src"),
    ),
    BrokenFleet(
        fault="a package's name that is a command",
        old="      devices: [/dev/bus/usb]",
        new="      packages: ['g++; reboot']\n      devices: [/dev/bus/usb]",
        words=("agents.go2.host.packages", "g++; reboot", "Debian packages"),
    ),
    BrokenFleet(
        fault="a device that is none",
        old="[/dev/bus/usb]",
        new="[/etc/passwd]",
        words=("agents.go2.host.devices", "/etc/passwd", "device nodes"),
    ),
    BrokenFleet(
        fault="a time server that nobody can reach",
        old="address: sfg@workstation.local\n      ",
        new="",
        words=("workstation", "time", "address"),
    ),
    BrokenFleet(
        fault="a policy that a DDS Router cannot express",
        old="policy: table-1",
        new="policy: [rt/tf, rt/tf_static, rt/global/*, rq/global/*, rr/global/*,\n"
        "  {pattern: rt/diagnostics, directions: [outward]}]",
        words=("directions", "DDS Router"),
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

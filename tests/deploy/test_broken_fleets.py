"""Fleets that cannot be deployed: the paper's fleet file with one change is refused with what is wrong."""

import pytest
from esslingen import FILE, RELEASE

from sfglab.deploy.bundle import load_source, prepare
from sfglab.deploy.checks import State, check_fleet
from sfglab.errors import SfglabError

DEVICES = "      devices: [/dev/bus/usb]"
DECK = "    host: {model: Steam Deck OLED, address: deck@steamdeck.local, accelerator: vaapi}\n"
BROKEN = {
    "accelerator misspelled": (
        ("accelerator: jetson", "accelerator: jetsn"),
        ("agents.go2.host.accelerator", "'jetsn'", "did you mean 'jetson'?"),
    ),
    "processor of another machine": (
        ("architecture: arm64\n      acc", "architecture: amd64\n      acc"),
        ("go2", "jetson", "amd64", "arm64"),
    ),
    "distribution without a base": (("ros: humble", "ros: jazzy"), ("go2", "jazzy", "humble")),
    "no machine": ((DECK, ""), ("agents.steamdeck", "the machine that steamdeck runs on")),
    "name that registries refuse": (
        ("images: localhost/esslingen", "images: localhost/Esslingen"),
        ("deployment.images", "'localhost/Esslingen'", "a repository of images"),
    ),
    "shared domain": (("    domain: 12\n", "    domain: 11\n"), ("pi2", "domain 11")),
    "global domain": (("    domain: 21\n", "    domain: 0\n"), ("steamdeck", "the global one")),
    "missing workspace": (
        (DEVICES, f"      workspace: go2_ws\n{DEVICES}"),
        ("go2_ws", "given no folder src"),
    ),
    "package that is a command": (
        (DEVICES, f"      packages: ['g++; reboot']\n{DEVICES}"),
        ("agents.go2.host.packages", "g++; reboot", "Debian packages"),
    ),
    "device that is none": (
        ("[/dev/bus/usb]", "[/etc/passwd]"),
        ("agents.go2.host.devices", "/etc/passwd", "device nodes"),
    ),
    "time server without address": (
        ("address: sfg@workstation.local\n      ", ""),
        ("workstation", "time", "address"),
    ),
}


@pytest.mark.parametrize("fault", BROKEN)
def test_a_fleet_that_cannot_be_deployed_is_refused_with_the_fault(fault, tmp_path):
    (old, new), words = BROKEN[fault]
    text = FILE.read_text()
    assert text.count(old) == 1
    path = tmp_path / "fleet.yaml"
    path.write_text(text.replace(old, new))
    said = refusal(path)
    assert [word for word in words if word not in said] == []


def refusal(path):
    """Return the reason why a fleet is refused; empty if it is deployed."""
    try:
        source = load_source(path)
        verdict = check_fleet(source.fleet)
        if verdict.state is State.PASSED:
            prepare(source, RELEASE, b"")
    except SfglabError as error:
        return str(error)
    return verdict.detail

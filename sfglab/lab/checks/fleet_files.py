"""Checks of a fleet's files: releases, layers, verdicts of checkers, and fleets that must be refused."""

from __future__ import annotations

import hashlib
import json
import re
from collections import defaultdict
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Any

import yaml

from sfglab.deploy.bases import base_of
from sfglab.deploy.bundle import MANIFEST, Bundle, bundle_of, load_source, render_bundle
from sfglab.deploy.fleet_check import check_fleet
from sfglab.deploy.verdicts import State, Verdict
from sfglab.errors import SfglabError
from sfglab.fleet.fleet_file import Accelerator
from sfglab.lab.checks.machines import Unasked, held

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from sfglab.deploy.deployment import Deployment, Release
    from sfglab.lab.checks import CheckRow

#: Layers of an image from the hardware upwards: paper A, Fig. 5.
LAYERS = ("base", "adapter", "application")

_STAGE = re.compile(r"^FROM\s+(?P<base>\S+)\s+AS\s+(?P<name>\S+)", re.MULTILINE | re.IGNORECASE)

_MEANINGS = (
    ("Dockerfile", "the image in three layers: hardware base, adapter, application"),
    (".dockerignore", "what the builder may see: the folder image and the workspace, nothing else"),
    ("image/requirements.lock", "every library of the image, with version and digests"),
    (
        "image/development.lock",
        "what development adds: a debugger for Python, a formatter for CMake",
    ),
    (
        "image/cyclonedds*.lock",
        "what building the middleware takes, which has no wheel for this processor",
    ),
    ("image/wheels/*", "wheels for machines without a way to the package index"),
    ("image/fleet.yaml", "the fleet file, as the containers read it"),
    ("image/entrypoint.sh", "starts the agent and, beside it, the user's software"),
    ("image/*.whl", "sfglab itself"),
    ("workspace/*", "the user's sources, built into the image"),
    ("compose.yaml", "the two containers, agent and router, and the bridge between them"),
    (
        "compose.dev.yaml",
        "what development changes: the workspace as a folder, a shell, a debugger",
    ),
    (
        "release.env",
        "the release that runs; the hooks make .env of it, with the machine's own numbers",
    ),
    ("router/*", "the configuration of the router that the fleet uses"),
    (
        "hooks/initialize.sh",
        "makes the machine ready: runs the hooks, then the user's own; --dry-run shows",
    ),
    ("hooks/settings.sh", "what differs from agent to agent, for the hooks"),
    ("hooks/lib.sh", "what the hooks have in common: write only what differs, say what was done"),
    ("hooks/10-time.sh", "the clock goes by the fleet's time servers"),
    ("hooks/20-firewall.sh", "loads the firewall"),
    ("hooks/firewall.nft", "the agent's own domain does not leave the machine"),
    ("hooks/30-service.sh", "installs the service, so that the agent starts with the machine"),
    ("hooks/custom.d/*", "where the user's own hooks belong"),
    ("systemd/*", "starts both containers with the machine and stops them with it"),
    (".devcontainer/*", "the same containers as a development environment in VS Code"),
    (".vscode/launch.json", "debugging of Python and C++ nodes, with their arguments"),
    (".vscode/tasks.json", "building and testing the workspace"),
    (".vscode/*", "editor settings: completion, formatting, extensions"),
    ("manifest.json", "what belongs to the release, with digests"),
)


def meaning_of(path: str) -> str:
    """Return the purpose of a file in an agent's folder; empty for a file that is in no bundle."""
    return next((meaning for pattern, meaning in _MEANINGS if fnmatchcase(path, pattern)), "")


def file_rows(pairs: Sequence[tuple[Deployment, Bundle]]) -> Iterator[dict[str, Any]]:
    """Yield a row for every file of every target host."""
    for _, bundle in pairs:
        for path, member in bundle.members.items():
            text = b"\0" not in member.data
            yield {
                "agent": bundle.agent,
                "path": path,
                "meaning": meaning_of(path),
                "size_bytes": len(member.data),
                "lines": member.data.count(b"\n") if text else 0,
                "sha256": hashlib.sha256(member.data).hexdigest(),
            }


def layer_rows(pairs: Sequence[tuple[Deployment, Bundle]]) -> Iterator[dict[str, Any]]:
    """Yield the three layers of each agent's image; a digest of all inputs distinguishes them."""
    for deployment, bundle in pairs:
        lines = bundle.members["Dockerfile"].data.decode().splitlines(keepends=True)
        text = "".join(
            line for line in lines if not line.startswith("#")
        )  # comments change no layer
        marks = [*_STAGE.finditer(text)]
        ends = [mark.start() for mark in marks[1:]] + [len(text)]
        stages = {m["name"]: text[m.start() : end] for m, end in zip(marks, ends, strict=True)}
        digest = hashlib.sha256(text[: marks[0].start()].encode())
        says = {
            "base": base_of(deployment).image.rpartition("/")[2],
            "adapter": f"ROS 2 {deployment.common.ros.value}, {deployment.host.architecture.value}",
            "application": bundle.tag,
        }
        for layer in LAYERS:
            digest.update(stages[layer].encode())
            yield {
                "agent": bundle.agent,
                "layer": layer,
                "says": says[layer],
                "digest": digest.hexdigest(),
            }


def release_checks(pairs: Sequence[tuple[Deployment, Bundle]]) -> Iterator[CheckRow]:
    """Check that a release's name identifies its contents."""
    equal, other = [], []
    for deployment, bundle in pairs:
        name, release = deployment.agent.name, deployment.release
        wheel = bundle.members[f"image/{release.wheel}"].data
        equal.append((name, render_bundle(deployment) == render_bundle(deployment)))
        equal.append((name, bundle_of(deployment, wheel) == bundle))
        changes = (
            replace(
                release, lock=re.sub(r"^numpy==", "numpy==1!", release.lock, flags=re.MULTILINE)
            ),
            replace(release, fleet_text=release.fleet_text + "\n"),
        )
        changed = (bundle_of(replace(deployment, release=change), wheel) for change in changes)
        other += [(name, one.tag != bundle.tag) for one in changed]
        other.append((f"{name}, wheel", bundle_of(deployment, wheel + b"x").tag != bundle.tag))
    yield held("equal contents are equal bytes and have one name", equal)
    yield held("any change of lock, fleet file or wheel is another release", other)
    yield held("the manifest is complete", (_complete(bundle) for _, bundle in pairs))
    yield held("a GPU, ports and the agent's name are where they belong", map(_told, pairs))


_GPU = [
    {"driver": "nvidia", "count": "all", "capabilities": ["gpu", "compute", "utility", "video"]}
]


def _told(pair: tuple[Deployment, Bundle]) -> tuple[str, bool]:
    """Check an agent's values in its files against the fleet file and RTPS 2.5, clause 9.6.2.3."""
    deployment, bundle = pair
    name, first = deployment.agent.name, 7400 + 250 * deployment.agent.domain
    agent = yaml.safe_load(bundle.members["compose.yaml"].data)["services"]["agent"]
    gpu = agent.get("deploy", {}).get("resources", {}).get("reservations", {}).get("devices", [])
    started = f'"--agent", "{name}"]'.encode() in bundle.members["Dockerfile"].data
    ports = deployment.network.local_ports == (first, first + 249)
    return name, started and ports and gpu == _GPU * (deployment.accelerator is Accelerator.CUDA)


def _complete(bundle: Bundle) -> tuple[str, bool]:
    files = json.loads(bundle.members[MANIFEST].data)["files"]
    members = {path: member for path, member in bundle.members.items() if path != MANIFEST}
    digests = {path: hashlib.sha256(member.data).hexdigest() for path, member in members.items()}
    return bundle.agent, {path: entry["sha256"] for path, entry in files.items()} == digests


def verdict_rows(
    verdicts: Iterable[Verdict], names: Mapping[str, str]
) -> Iterator[CheckRow | Unasked]:
    """Yield one row for each kind of check of the fleet and its files; paths get the names in `names`."""
    by_check: dict[str, list[Verdict]] = defaultdict(list)
    for verdict in verdicts:
        by_check[verdict.check].append(verdict)
    for check, found in by_check.items():
        skipped = [verdict for verdict in found if verdict.state is State.SKIPPED]
        if skipped:
            yield Unasked(check=check, why=skipped[0].says)
        asked = [v for v in found if v.state is not State.SKIPPED]
        if asked:
            cases = (
                (f"{names.get(v.subject, v.subject)} {v.says}".strip(), v.state is State.HOLDS)
                for v in asked
            )
            yield held(check, cases)


# Broken fleets: each one is the paper's fleet file with one change.


@dataclass(frozen=True, slots=True)
class BrokenFleet:
    """A change of the paper's fleet file that makes it invalid."""

    fault: str  #: Description of the fault.
    old: str  #: Text of the paper's fleet file that is replaced.
    new: str  #: Text that replaces it.
    #: Texts that the error must contain: the place, the given or the allowed values.
    words: tuple[str, ...]


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
        "a ROS 2 distribution that no Jetson base has",
        "ros: humble",
        "ros: jazzy",
        ("go2", "jazzy", "humble"),
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
    BrokenFleet(
        "two agents that share a domain",
        "    domain: 12\n",
        "    domain: 11\n",
        ("pi2", "domain 11"),
    ),
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
        ("the interface", "go2", "global_interface"),
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
"""Changes of the paper's fleet file; for the last one, `break_fleet` also sets a DDS Router."""


def break_fleet(text: str, broken: BrokenFleet) -> str:
    """Return the paper's fleet file with one fault; raises `ValueError` unless it has the old text once."""
    if text.count(broken.old) != 1:
        raise ValueError(
            f"{broken.fault}: {broken.old!r} stands {text.count(broken.old)} times in the file"
        )
    text = text.replace(broken.old, broken.new)
    if "directions" in broken.new:
        return text.replace(
            "router: sfglab", "router: dds-router\n  router_image: ubuntu-ddsrouter:v3.5.0"
        )
    return text


def refused_rows(text: str, release: Release, folder: Path) -> Iterator[dict[str, Any]]:
    """Yield a row with the error of each broken version of a fleet file; files go into a folder."""
    for number, broken in enumerate(BROKEN):
        path = folder / f"broken{number}.yaml"
        path.write_text(break_fleet(text, broken), encoding="utf-8")
        said = _refusal(path, release).replace(f"{path}", "fleet.yaml")
        refused = bool(said) and all(word in said for word in broken.words)
        yield {"fault": broken.fault, "refused": refused, "said": said}


def _refusal(path: Path, release: Release) -> str:
    """Return the reason why a fleet is refused; empty if it is accepted."""
    try:
        verdicts = check_fleet(load_source(path), release)
    except SfglabError as error:
        return str(error)
    return "; ".join(dict.fromkeys(v.says for v in verdicts if v.state is State.FAILS))

"""Facts about a deployment, written before a run, and the program that confirms or refutes each."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


class Outcome(Enum):
    """Result of the check of a fact by a program."""

    CONFIRMED = "confirmed"
    REFUSED = "refused"
    MISSING = "missing"  #: The program was not installed.


def accepted(check: str) -> str:
    """Return the fact that a check of `sfglab deploy check` is about."""
    return f"{check} are accepted"


@dataclass(frozen=True, slots=True)
class Fact:
    """One statement about a deployment."""

    end: str  #: Part of claim A-DEPLOY.
    name: str  #: The statement.
    program: str  #: Program of another project that confirms it, with the machine that it needs.


LAYERS = "three image layers"
DETECTION = "accelerator detection"
CONTAINERS = "two containers"
SYSTEMD = "systemd"
DEV_CONTAINER = "dev container"
HOOKS = "hooks"
_ROBOT = "on a machine of the fleet"

CODEC = "FFmpeg opens an H.264 codec of the accelerator that was found"
LOCAL_IMAGE = "an image is built from a local base and runs as its user"
DISCOVERY = "agents discover each other through their routers"
INSIDE = "an agent's own domain shows nothing outside its machine"
OUTSIDE = "the global domain shows global names only, with the heartbeats"
TRIAL = "the hooks prepare a folder like a machine, change nothing again, and run the user's own"

_NAMESPACES = "Cyclone DDS between network namespaces"
FACTS = (
    Fact(LAYERS, accepted("Dockerfiles"), "hadolint"),
    Fact(LAYERS, LOCAL_IMAGE, "buildah and debootstrap"),
    Fact(LAYERS, "images with ROS 2 and an accelerator are built", f"Docker {_ROBOT}"),
    Fact(DETECTION, CODEC, "FFmpeg on a machine with an accelerator"),
    Fact(CONTAINERS, accepted("Compose files"), "check-jsonschema"),
    Fact(CONTAINERS, accepted("Compose projects"), "docker compose"),
    Fact(CONTAINERS, DISCOVERY, _NAMESPACES),
    Fact(CONTAINERS, INSIDE, _NAMESPACES),
    Fact(CONTAINERS, OUTSIDE, _NAMESPACES),
    Fact(CONTAINERS, "Docker Compose starts both containers", f"Docker {_ROBOT}"),
    Fact(SYSTEMD, accepted("service units"), "systemd-analyze"),
    Fact(SYSTEMD, "systemd starts the unit", f"systemd {_ROBOT}"),
    Fact(DEV_CONTAINER, accepted("dev container files"), "check-jsonschema"),
    Fact(DEV_CONTAINER, "VS Code opens the dev container", "VS Code with Docker"),
    Fact(HOOKS, accepted("shell scripts"), "shellcheck"),
    Fact(HOOKS, TRIAL, "Bash"),
    Fact(HOOKS, "the hooks run as root", f"Bash {_ROBOT}"),
)
"""All facts, by the parts of the claim in the order of the ledger."""

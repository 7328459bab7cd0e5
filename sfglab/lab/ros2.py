"""Real ROS 2 on this machine, never imported here: its distributions, and command lines for programs in one."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.bus.ros.services import ros_command, sourced_python
from sfglab.errors import SfglabError
from sfglab.lab.paths import find_project
from sfglab.processes import Member

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

#: Script of a node of rclpy that follows orders.
PEER = Path(__file__).parent / "workers" / "rclpy_peer.py"
#: Distributions with which sfglab's nodes are tested; `make ros` installs them.
TESTED = ("jazzy", "kilted")


class RosMissingError(SfglabError):
    """This machine lacks ROS 2, or the distributions that are named."""

    def __init__(self, names: Iterable[str] = ()) -> None:
        super().__init__(
            f"needs ROS 2 {' and '.join(names)}".rstrip() + "; install it with make ros"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Distribution:
    """A distribution of ROS 2 on this machine."""

    name: str  #: Name, as in ``ROS_DISTRO``.
    python: Path  #: Path of its Python interpreter.
    #: Whether it is an installation of the system in our environment; otherwise `make ros` made it.
    sourced: bool = False

    def __str__(self) -> str:
        return f"{self.name} ({'sourced' if self.sourced else 'make ros'})"

    def argv(self, *arguments: str, **environment: object) -> list[str]:
        """Return the command line that runs a script, such as `PEER`, with additional environment variables."""
        return ros_command(str(self.python), *arguments, **{"ROS_DISTRO": self.name, **environment})


def distributions() -> dict[str, Distribution]:
    """Return the installed distributions by name: those of `make ros` first, then a sourced one."""
    made = sorted(path.parent for path in find_project().root.glob(".venv-*/.ready"))
    names = {venv.name.removeprefix(".venv-"): venv / "bin" / "python" for venv in made}
    found = {name: Distribution(name=name, python=python) for name, python in names.items()}
    if (python := sourced_python()) and (name := os.environ.get("ROS_DISTRO", "")):
        found.setdefault(name, Distribution(name=name, python=Path(python), sourced=True))
    return found


def distribution() -> Distribution:
    """Return the first installed distribution of `distributions`.

    Raises:
        RosMissingError: No distribution is installed.
    """
    for found in distributions().values():
        return found
    raise RosMissingError


@dataclass(frozen=True, slots=True, kw_only=True)
class RosMember(Member):
    """A `PEER` on a test host, as a process of a group; `config` contains its arguments."""

    module: str = str(PEER)
    #: Distribution in which it runs; by default the first one that is installed.
    distribution: Distribution = field(default_factory=distribution)
    #: Additional environment variables.
    environment: Mapping[str, str] = field(default_factory=dict)

    @property
    def command(self) -> tuple[str, ...]:
        """Program and arguments."""
        # Test hosts share /dev/shm, over which Fast DDS would bypass the network.
        values = {"ROS_DOMAIN_ID": "0", "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4", **self.environment}
        return tuple(self.distribution.argv(self.module, *self.config, **values))

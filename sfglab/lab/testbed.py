"""Hosts of an experiment: separate ones where the machine can run them, otherwise this host alone.

With network namespaces, every host has its own interface, and only sent frames pass between hosts.
Without them, the same processes run on this host's loopback, whose interface counts the traffic of all
processes.
"""

from __future__ import annotations

import itertools
import os
import socket
import time
from contextlib import ExitStack, closing, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Protocol, Self

from sfglab.bus.locks import LockedError, user_lock
from sfglab.errors import SfglabError
from sfglab.lab.hosts import Capability, Network
from sfglab.lab.hosts.host import InterfaceBytes, interface_bytes

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

# The ports of domains from 102 on are in Linux' range of ephemeral ports.
FIRST_DOMAIN, DOMAINS = 20, 80
LOOPBACK = "127.0.0.1"
_turns = itertools.count(os.getpid() * 13)


@contextmanager
def held_domains(count: int = 1) -> Iterator[list[int]]:
    """Hold DDS domains of this host's network. Other programs of this user get other domains at the same time.

    A domain that another user's program uses is skipped, because its first port is taken.

    Raises:
        SfglabError: Too few domains are free.
    """
    with ExitStack() as locks:
        found: list[int] = []
        for _ in range(DOMAINS):
            domain = FIRST_DOMAIN + next(_turns) % DOMAINS
            with suppress(OSError, LockedError):
                locks.enter_context(_hold(domain))
                found.append(domain)
            if len(found) == count:
                break
        else:
            allowed = f"DDS domains {FIRST_DOMAIN} to {FIRST_DOMAIN + DOMAINS - 1}"
            raise SfglabError(
                f"{allowed}: {count} are needed and {len(found)} are free; end other runs on this host"
            )
        yield found


@contextmanager
def _hold(domain: int) -> Iterator[None]:
    """Hold one domain; raises an error if it is held or its first port is taken (RTPS 2.5, clause 9.6.2.3)."""
    with user_lock(f"dds-domain-{domain}"):
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as probe:
            probe.bind(("", 7400 + 250 * domain))
        yield


@contextmanager
def _alone() -> Iterator[None]:
    """Be the only run of this user on this host; wait for another run to end."""
    with ExitStack() as held:
        while True:
            with suppress(LockedError):
                held.enter_context(user_lock("run-on-one-host"))
                break
            time.sleep(0.2)
        yield


def free_port() -> int:
    """Return a TCP port of the loopback that is free."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_STREAM)) as probe:
        probe.bind((LOOPBACK, 0))
        return int(probe.getsockname()[1])


class CountsBytes(Protocol):
    """Object with an interface whose bytes are counted."""

    def interface_bytes(self) -> InterfaceBytes:
        """Return the bytes that the interface has sent and received so far."""


class _Loopback:
    def interface_bytes(self) -> InterfaceBytes:
        return interface_bytes(Path("/proc/self/net/dev").read_text(encoding="ascii"), "lo")


class Testbed:
    """Hosts of an experiment, by name, as a context manager.

    Without separate hosts, all names stand for this host, and only one run at a time uses it; other runs wait.

    Args:
        names: Names of the hosts.
        separate: Whether the hosts are network namespaces; None: if this machine supports that.
    """

    __test__ = False  # not a test, in spite of its name

    def __init__(self, *names: str, separate: bool | None = None) -> None:
        self._names = names
        self._stack = ExitStack()
        self._network: Network | None = None
        asked_for = Capability(ok=False, how="none", reason="asked for")
        capability = asked_for if separate is False else Network.available()
        self.separate = capability.ok  #: Whether the hosts are separate.
        #: Description of the hosts in the log.
        self.description = f"one host, loopback ({capability.reason})"
        if self.separate:
            self.description = f"separate hosts: network namespaces ({capability.how})"

    def __enter__(self) -> Self:
        if self.separate:
            self._network = self._stack.enter_context(Network())
            for name in self._names:
                self._network.add_host(name)
        else:
            self._stack.enter_context(_alone())
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def argv(self, host: str, command: Sequence[str]) -> list[str]:
        """Return the command line that runs a command on a host."""
        return self._network.argv(host, command) if self._network else list(command)

    def interface(self, host: str) -> str:
        """Return the name of the interface with which a host is connected to the others."""
        return self._network.hosts[host].interface if self._network else "lo"

    def address(self, host: str) -> str:
        """Return the IP address of a host."""
        return self._network.hosts[host].address if self._network else LOOPBACK

    def meter(self, host: str) -> CountsBytes:
        """Return the counter of the bytes at a host's interface."""
        return self._network.hosts[host] if self._network else _Loopback()

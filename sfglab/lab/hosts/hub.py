"""Process that owns a network of hosts; it starts inside its own namespace, see `network`.

It answers requests on a `Channel`, relays the frames of a radio, and forks one *holder* per host, a process
whose only purpose is to keep the host's namespace alive. When the processes end, the kernel itself removes
namespaces, cables and addresses. The hub and every holder watch a pidfd of the creator; holders also watch
one of the hub. The first process that wakes up kills all processes in the hosts. A parent-death signal
(prctl(2), PR_SET_PDEATHSIG) would not suffice: it depends on the parent *thread*, reaches only direct
children, and does not survive its owner.
"""

from __future__ import annotations

import contextlib
import json
import os
import select
import signal
import socket
import sys
import traceback
from dataclasses import asdict
from typing import Any, NoReturn

from sfglab.lab.hosts.channel import answer
from sfglab.lab.hosts.enter import CLONE_NEWNET, unshare
from sfglab.lab.hosts.host import end_members
from sfglab.lab.hosts.radio_relay import Relay
from sfglab.lab.hosts.wiring import Port, Wiring
from sfglab.rtps import Medium


def _close_all_but(kept: set[int]) -> None:
    for fd in sorted(int(name) for name in os.listdir("/proc/self/fd")):  # noqa: PTH208 - names only
        if fd > 2 and fd not in kept:
            # The descriptor of this listing is closed already.
            with contextlib.suppress(OSError):
                os.close(fd)


def _hold(ready: int, guards: list[int]) -> None:
    """Keep a new network namespace alive until one of the guarded processes ends."""
    _close_all_but({ready, *guards})
    unshare(CLONE_NEWNET)
    os.write(ready, b"1")
    os.close(ready)
    poll = select.poll()
    for guard in guards:
        poll.register(guard, select.POLLIN)
    poll.poll()
    end_members({os.stat("/proc/self/ns/net").st_ino}, grace_s=0)  # noqa: PTH116 - as in `processes`


def _fork_holder(creator: int) -> int:
    """Start a holder and return its pid when its namespace exists."""
    hub = os.pidfd_open(os.getpid())
    waiting, ready = os.pipe()
    pid = os.fork()
    if pid == 0:
        # The child leaves without unwinding, because sockets and handlers belong to the parent.
        try:
            _hold(ready, [creator, hub])
        except BaseException:  # noqa: BLE001 - reported, and the child must not return into the parent's loop
            traceback.print_exc()
        finally:
            os._exit(0)
    for fd in (hub, ready):
        os.close(fd)
    with open(waiting, "rb") as pipe:  # noqa: PTH123 - a descriptor
        if not pipe.read(1):
            os.waitpid(pid, 0)
            raise OSError(
                "a network namespace for the host could not be made (see the message above)"
            )
    return pid


class _Hub:
    def __init__(self, creator: int) -> None:
        self._creator = creator
        self._wiring = Wiring()
        self._ports: dict[str, Port] = {}
        self._holders: list[int] = []
        self._relay: Relay | None = None

    def add_host(self, *, name: str) -> dict[str, Any]:
        pid = _fork_holder(self._creator)
        self._holders.append(pid)
        port = self._ports[name] = self._wiring.plug(pid)
        return {"holder": pid, "address": port.address}

    def set_connected(self, *, name: str, connected: bool) -> None:
        self._wiring.set_connected(self._ports[name], connected=connected)

    def set_radio(self, *, medium: dict[str, Any], seed: int) -> None:
        given = Medium(**medium)
        if self._relay is None:  # a relay replaces the bridge
            for port in self._ports.values():
                self._wiring.take_over(port)
            self._relay = Relay(self._ports, given)
        self._relay.set(given, seed=seed)

    def radio_counters(self) -> dict[str, Any]:
        assert self._relay is not None
        return asdict(self._relay.counters())

    def serve(self, control: socket.socket) -> None:
        while True:
            relay = self._relay
            watched: list[Any] = [self._creator, control]
            pause_s = None
            if relay:
                watched += relay.sockets
                pause_s = relay.pause_s()
            ready, _, _ = select.select(watched, (), (), pause_s)
            if self._creator in ready:
                return
            if control in ready and not answer(control, self):
                return
            if relay:
                relay.relay(ready)

    def close(self) -> None:
        """End the holders, and then all processes inside; open descriptors keep the namespaces distinct."""
        for pid in self._holders:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
        end_members({os.fstat(port.namespace).st_ino for port in self._ports.values()}, grace_s=0)


def main(control_fd: str, creator_pidfd: str, how: str) -> NoReturn:
    """Serve until the creator, given by a pidfd, closes its end of a SOCK_SEQPACKET pair or ends."""
    creator = int(creator_pidfd)
    os.set_inheritable(creator, False)
    with socket.socket(fileno=int(control_fd)) as control:
        control.set_inheritable(False)
        hub = _Hub(creator)
        try:
            control.send(json.dumps({"ok": how}).encode())
            hub.serve(control)
        except (BrokenPipeError, ConnectionResetError):
            pass  # the creator ended between two messages
        finally:
            hub.close()
    sys.exit(0)


if __name__ == "__main__":
    main(*sys.argv[1:])

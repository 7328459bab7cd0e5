"""The process that owns a network of hosts; starts inside its own namespace, see `network.Channel`.

It answers requests (JSON, one per datagram) on a socket pair and forks one *holder* per host, a process that
does nothing but keep the host's namespace alive. When the processes end, the kernel removes namespaces, cables
and addresses by itself. The hub and every holder watch a pidfd of the creator; holders also watch one of the
hub. Whichever wakes first kills all processes in the hosts. A parent-death signal (prctl(2), PR_SET_PDEATHSIG)
would do less: it is tied to the parent *thread*, hits only direct children, and does not survive its owner.
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
from typing import Any, NoReturn

from pyroute2.netlink.exceptions import NetlinkError

from sfglab.lab.hosts.enter import CLONE_NEWNET, unshare
from sfglab.lab.hosts.host import end_members
from sfglab.lab.hosts.network import Link
from sfglab.lab.hosts.radio import Relay
from sfglab.lab.hosts.wiring import Port, Shaping, Wiring
from sfglab.rtps import Medium

_MAX_REQUEST_BYTES = 65536


def _close_all_but(kept: set[int]) -> None:
    for fd in sorted(int(name) for name in os.listdir("/proc/self/fd")):  # noqa: PTH208 - names only
        if fd > 2 and fd not in kept:
            # The descriptor of the listing itself is gone already.
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
    """Start a holder and return its pid once its namespace is there."""
    hub = os.pidfd_open(os.getpid())
    waiting, ready = os.pipe()
    pid = os.fork()
    if pid == 0:
        # Leaves without unwinding: the parent's sockets and handlers are not the child's to finish.
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
        self._shaping = Shaping(self._wiring)
        self._ports: dict[str, Port] = {}
        self._holders: list[int] = []
        self._relay: Relay | None = None

    def add_host(self, *, name: str) -> dict[str, Any]:
        pid = _fork_holder(self._creator)
        self._holders.append(pid)
        port = self._ports[name] = self._wiring.plug(pid)
        return {"holder": pid, "address": port.address}

    def set_link(self, *, name: str, **link: Any) -> dict[str, Any]:
        self._shaping.set_link(self._ports[name], Link(**link))
        return {}

    def set_radio(self, *, medium: dict[str, Any], seed: int) -> dict[str, Any]:
        for port in self._ports.values():
            self._shaping.set_air(port, Medium(**medium))
        if self._relay is None:
            for port in self._ports.values():
                self._wiring.take_out(port)
            self._relay = Relay(
                [(name, port.outer, port.mac) for name, port in self._ports.items()]
            )
        return self._relay.request("set", medium=medium, seed=seed)

    def end_radio(self) -> dict[str, Any]:
        if self._relay is not None:
            self._relay.close()
            self._relay = None
            for port in self._ports.values():
                self._shaping.set_air(port, Medium())
                self._wiring.put_back(port)
        return {}

    def radio_counters(self) -> dict[str, Any]:
        assert self._relay is not None
        return self._relay.request("counters")

    def answer(self, request: dict[str, Any]) -> dict[str, Any]:
        known = (self.add_host, self.set_link, self.set_radio, self.end_radio, self.radio_counters)
        operations = {operation.__name__: operation for operation in known}
        try:
            return {"ok": operations[request.pop("op")](**request)}
        except NetlinkError as error:
            return {"refused": f"{error.args[1]} (errno {error.code})"}
        except PermissionError as error:
            return {"refused": str(error)}
        except Exception:  # noqa: BLE001 - the creator raises it; the hub must live on to clean up
            return {"failed": traceback.format_exc()}

    def serve(self, control: socket.socket) -> None:
        poll = select.poll()
        poll.register(self._creator, select.POLLIN)
        poll.register(control, select.POLLIN)
        while not any(fd == self._creator for fd, _ in poll.poll()):
            data = control.recv(_MAX_REQUEST_BYTES)
            if not data:
                return
            control.send(json.dumps(self.answer(json.loads(data))).encode())

    def close(self) -> None:
        """End the holders, then whatever is left inside: our descriptors keep the namespaces distinct."""
        if self._relay is not None:
            self._relay.close()
        for pid in self._holders:
            os.kill(pid, signal.SIGKILL)
            os.waitpid(pid, 0)
        end_members({os.fstat(port.namespace).st_ino for port in self._ports.values()}, grace_s=0)


def main(control_fd: str, creator_pidfd: str, how: str) -> NoReturn:
    """Serve until the creator, of whom a pidfd is given, closes its end of a SOCK_SEQPACKET pair or dies."""
    creator = int(creator_pidfd)
    os.set_inheritable(creator, False)
    with socket.socket(fileno=int(control_fd)) as control:
        control.set_inheritable(False)
        hub = _Hub(creator)
        try:
            control.send(json.dumps({"ok": {"how": how}}).encode())
            hub.serve(control)
        except (BrokenPipeError, ConnectionResetError):
            pass  # the creator died between two messages
        finally:
            hub.close()
    sys.exit(0)


if __name__ == "__main__":
    main(*sys.argv[1:])

"""Several hosts on one machine, joined by one Ethernet: network namespaces made through netlink.

Needs root or a user namespace, no external program, and leaves nothing behind, whatever ends it. The hub that
owns them is a process of its own, because only a process that has entered a namespace can work in it, and
because cleaning up must outlive the creator.
"""

from __future__ import annotations

import contextlib
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
from dataclasses import asdict, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import IO, TYPE_CHECKING, Any, Literal, Self

from sfglab.errors import InvalidValueError
from sfglab.fields import between, check_bounds, from_json
from sfglab.lab.hosts.host import (
    ENTER,
    Host,
    HostsError,
    HostsUnavailableError,
    LinkControlError,
    end_members,
)
from sfglab.lab.hosts.radio import RadioCounters

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from sfglab.rtps import Medium

#: A full Ethernet frame without its checksum: 1500 B and 14 B of header (IEEE 802.3, 3).
FRAME_BYTES = 1514

# The kernel's struct tc_ratespec counts bytes per second in 32 bits (linux/pkt_sched.h).
_MAX_RATE_BPS = 8 * (2**32 - 1)
_MIN_RATE_BPS = 1000
# Tokens for this long may be spent at once, so that a late timer does not lower the rate.
_BURST_S = 0.001
_MOST_OVERHEAD_BYTES = 2**16 - 1  # tc_ratespec.overhead
_DEFAULT_QUEUE_S = 0.1


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """The emulated properties of one host's link, equal in both directions."""

    rate_bps: float | None = None  #: Rate of Ethernet frames in bit/s; None is unlimited.
    #: Probability in [0, 1] with which a frame is lost, drawn anew for each frame and direction.
    loss: float = between(0.0, 0.0, 1.0)
    #: Size of the drop-tail queue before a limited rate; None is 100 ms at that rate, but at least ten full
    #: frames.
    queue_bytes: int | None = None

    def __post_init__(self) -> None:
        check_bounds(self)
        if self.rate_bps is not None and not _MIN_RATE_BPS <= self.rate_bps <= _MAX_RATE_BPS:
            allowed = f"{_MIN_RATE_BPS} to {_MAX_RATE_BPS} or None"
            raise InvalidValueError("rate_bps", self.rate_bps, allowed)
        if self.queue_bytes is not None and (
            self.rate_bps is None or self.queue_bytes < FRAME_BYTES
        ):
            allowed = f"one frame ({FRAME_BYTES}) or more, and only with rate_bps"
            raise InvalidValueError("queue_bytes", self.queue_bytes, allowed)

    @property
    def burst_bytes(self) -> int:
        """Return the size of the token bucket: 1 ms at the rate, but at least two full frames."""
        assert self.rate_bps is not None
        return max(2 * FRAME_BYTES, round(self.rate_bps / 8 * _BURST_S))

    @property
    def limit_bytes(self) -> int:
        """Return the size of the queue in bytes, given or by default."""
        assert self.rate_bps is not None
        if self.queue_bytes is not None:
            return self.queue_bytes
        return max(10 * FRAME_BYTES, round(self.rate_bps / 8 * _DEFAULT_QUEUE_S))

    @property
    def loss_per_million(self) -> int:
        """Return how many of a million frames are lost."""
        return round(self.loss * 1_000_000)


_ANSWER_TIMEOUT_S = 20.0
_END_TIMEOUT_S = 10.0
_MAX_ANSWER_BYTES = 65536


def _start(control: socket.socket, *, how: str, log: IO[bytes]) -> subprocess.Popen[bytes]:
    creator = os.pidfd_open(os.getpid())
    modules = os.pathsep.join(
        path or str(Path.cwd()) for path in sys.path
    )  # so that the hub finds the same
    try:
        numbers = (control.fileno(), creator)
        return subprocess.Popen(
            [
                *ENTER,
                "new",
                how,
                sys.executable,
                "-P",
                "-m",
                "sfglab.lab.hosts.hub",
                *map(str, numbers),
            ],
            env=os.environ | {"PYTHONPATH": modules},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=log,
            pass_fds=numbers,
            # Ctrl-C in a terminal must reach the creator first, which then ends things in order.
            start_new_session=True,
        )
    finally:
        os.close(creator)


class Channel:
    """A running hub, ``auto``, ``root`` or ``rootless``; safe to use from several threads.

    Raises:
        HostsUnavailableError: The hub could not make its namespace.
    """

    def __init__(self, how: str) -> None:
        self._lock = threading.Lock()
        self._control, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._log = tempfile.TemporaryFile()  # noqa: SIM115 - closed by `close`
        self._control.settimeout(_ANSWER_TIMEOUT_S)
        self._process: subprocess.Popen[bytes] | None = None
        try:
            with other:
                self._process = _start(other, how=how, log=self._log)
            #: How it obtained its namespaces, ``root`` or ``rootless``.
            self.how = str(self._receive()["how"])
        except HostsError as error:
            self.close()
            raise HostsUnavailableError(str(error)) from error
        except BaseException:
            self.close()
            raise

    def _said(self) -> str:
        """Return the last line that the hub wrote before it ended."""
        if self._process is not None:
            # It closes its socket a moment before it has said why.
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(1.0)
        # The offset is shared with the hub, so the file is read without moving it.
        size = os.fstat(self._log.fileno()).st_size
        lines = os.pread(self._log.fileno(), size, 0).decode(errors="replace").strip().splitlines()
        return lines[-1] if lines else "it ended without a word"

    def _receive(self) -> dict[str, Any]:
        try:
            data = self._control.recv(_MAX_ANSWER_BYTES)
        except TimeoutError:
            raise HostsError(
                f"the hub of the test hosts gave no answer for {_ANSWER_TIMEOUT_S:.0f} s"
            ) from None
        except OSError:
            data = b""
        if not data:
            raise HostsError(f"the hub of the test hosts has ended: {self._said()}")
        answer: dict[str, Any] = json.loads(data)
        if "failed" in answer:
            raise HostsError(f"the hub of the test hosts failed:\n{answer['failed']}")
        if "refused" in answer:
            raise PermissionError(answer["refused"])
        result: dict[str, Any] = answer["ok"]
        return result

    def request(self, operation: str, /, **arguments: Any) -> dict[str, Any]:
        """Ask the hub for one of its operations and wait for what it returns.

        Raises:
            HostsError: The hub is gone, late, or failed.
            PermissionError: The kernel refused.
        """
        with self._lock:
            with contextlib.suppress(OSError):  # a lost hub is reported by the answer
                self._control.send(json.dumps({"op": operation, **arguments}).encode())
            return self._receive()

    def close(self) -> None:
        """End the hub, which kills whatever is left inside the hosts; harmless when repeated."""
        # Unlike closing, this also reaches the hub when a forked child still has a copy of the socket.
        with contextlib.suppress(OSError):
            self._control.shutdown(socket.SHUT_RDWR)
        if self._process is not None:
            try:
                self._process.wait(_END_TIMEOUT_S)
            finally:
                self._process.kill()
                self._process.wait()
        self._control.close()
        self._log.close()


_HOW = {None: "auto", False: "root", True: "rootless"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Capability:
    """Whether this machine can run test hosts."""

    ok: bool  #: It can.
    #: As root, rootless in a user namespace, or not at all.
    how: Literal["root", "rootless", "none"]
    reason: str = ""  #: What stands against it; empty when nothing does.


class Network:
    """A network of test hosts, to be used as a context manager; `HostsError` says that it is closed or lost.

    Leaving it ends every process inside the hosts (TERM, a grace in seconds, KILL) and then the hosts; when the
    creating process is killed, without the grace. `rootless` uses a user namespace even as root, False insists
    on root, None takes what works.
    """

    def __init__(self, *, rootless: bool | None = None, grace_s: float = 2.0) -> None:
        self._wanted = _HOW[rootless]
        self._grace_s = grace_s
        self._running: Channel | None = None
        self._hosts: dict[str, Host] = {}
        self._on_radio = False

    @staticmethod
    def available() -> Capability:
        """Find out by trying whether test hosts work here; takes about half a second and leaves nothing."""
        try:
            with Network() as network:
                network.add_host("probe")
                return Capability(ok=True, how="root" if network.how == "root" else "rootless")
        except (HostsUnavailableError, HostsError) as error:
            return Capability(ok=False, how="none", reason=getattr(error, "reason", str(error)))

    def __enter__(self) -> Self:
        if self._running is not None:
            raise HostsError(
                "this network is in use already: make another Network for another `with` block"
            )
        self._running = Channel(self._wanted)
        return self

    def __exit__(self, *_: object) -> None:
        channel, self._running = self._channel, None
        hosts, self._hosts = self._hosts, {}
        self._on_radio = False
        try:
            end_members({host.inode for host in hosts.values()}, grace_s=self._grace_s)
        finally:
            channel.close()
            for host in hosts.values():
                host.close()

    @property
    def _channel(self) -> Channel:
        if self._running is None:
            raise HostsError("this network is closed: use it inside its `with` block")
        return self._running

    @property
    def how(self) -> str:
        """Return ``root`` or ``rootless``."""
        return self._channel.how

    @property
    def hosts(self) -> Mapping[str, Host]:
        """Return the hosts by name."""
        return MappingProxyType(self._hosts)

    def argv(self, host: str, command: Sequence[str | os.PathLike[str]]) -> list[str]:
        """Return the command line that runs a command inside a host; as `Host.argv`."""
        return self._hosts[host].argv(command)

    def add_host(self, name: str) -> Host:
        """Add a host to the network; the first one has the address 10.77.0.2, the next one 10.77.0.3.

        Raises:
            InvalidValueError: The name is empty or taken.
            HostsUnavailableError: The kernel refuses.
            HostsError: The network is closed or lost, or full (253 hosts), or a radio.
        """
        if self._on_radio:
            raise HostsError("this network is a radio now: add its hosts before `set_radio`")
        if not name or name in self._hosts:
            allowed = f"any text that is not empty nor in {sorted(self._hosts)}"
            raise InvalidValueError("host name", name, allowed)
        try:
            made = self._channel.request("add_host", name=name)
        except PermissionError as error:
            raise HostsUnavailableError(str(error)) from error
        host = Host(name, address=made["address"], holder=made["holder"], how=self.how)
        self._hosts[name] = host
        return host

    def set_link(
        self,
        name: str,
        *,
        rate_bps: float | None = None,
        loss: float | None = None,
        queue_bytes: int | None = None,
    ) -> None:
        """Replace a host's link, both ways; what is None is unlimited or lossless. `LinkControlError`: refused.

        The rate is that of Ethernet frames in bit/s; loss is the probability of each frame; the queue before
        the rate holds 100 ms at that rate where its size is not given. `InvalidValueError`: a value cannot be
        emulated.
        """
        if name not in self._hosts:
            raise InvalidValueError("host", name, f"{sorted(self._hosts)}, which this network has")
        if self._on_radio:
            raise HostsError(
                "this network is a radio now: the medium of `set_radio` is its only link"
            )
        link = Link(rate_bps=rate_bps, loss=loss or 0.0, queue_bytes=queue_bytes)
        try:
            self._channel.request("set_link", name=name, **asdict(link))
        except PermissionError as error:
            raise LinkControlError(name, str(error)) from error

    def set_radio(self, medium: Medium, *, seed: int = 0) -> None:
        """Join the hosts by a medium that they share instead of the Ethernet, or change that medium.

        A process relays every frame as the medium says; see `RadioCounters.kept_up` for whether it could. The
        queue is the relay's and hosts never wait, unless it blocks: then it is their kernel's, as long as a
        socket's buffer, whatever `queue_frames` says. Losses follow the seed, but which frame meets which
        number depends on the machine. Counters begin anew. A frame's size is its Ethernet header and payload.

        Raises:
            InvalidValueError: The queue blocks, and the medium is shared, as a host's kernel cannot know who
                else is on air, or a frame costs more than that can count.
            LinkControlError: The kernel refuses.
        """
        if not self._hosts:
            raise HostsError("a radio needs hosts: add them before `set_radio`")
        most_s = _MOST_OVERHEAD_BYTES * 8 / medium.rate_bps
        if medium.queue_rule == "block" and (medium.shared or medium.overhead_s > most_s):
            allowed = (
                f"a queue that blocks only where shared is False and overhead_s up to {most_s:g}"
            )
            raise InvalidValueError("medium", medium, allowed)
        try:
            self._channel.request("set_radio", medium=asdict(medium), seed=seed)
        except PermissionError as error:
            raise LinkControlError(", ".join(self._hosts), str(error)) from error
        self._on_radio = True

    def end_radio(self) -> None:
        """Go back to the Ethernet; harmless without a radio."""
        self._channel.request("end_radio")
        self._on_radio = False

    def radio_counters(self) -> RadioCounters:
        """Return what the radio has done since its medium was set; raises `HostsError` if there is none."""
        if not self._on_radio:
            raise HostsError("this network has no radio: call `set_radio` first")
        counters: RadioCounters = from_json(RadioCounters, self._channel.request("radio_counters"))
        return counters

"""A radio between test hosts, seen from the hub: starts the relay, sets its medium, reads what it did."""

from __future__ import annotations

import contextlib
import json
import socket
import subprocess
import sys
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

_ANSWER_TIMEOUT_S = 10.0
_END_TIMEOUT_S = 2.0
_MAX_ANSWER_BYTES = 65536


@dataclass(slots=True, kw_only=True)
class RadioHost:
    """What one host has done with the medium since it was set."""

    frames: int = 0  #: Frames that it sent.
    bytes_: int = 0  #: Their bytes: Ethernet header and payload, no checksum.
    airtime_ns: int = 0  #: How long they were on air, nanoseconds.
    queue_full: int = 0  #: Frames that found its queue full.
    lost: int = 0  #: Frames of it that a receiver did not get, each receiver counted.

    @property
    def airtime_s(self) -> float:
        """`airtime_ns` in seconds."""
        return self.airtime_ns / NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class RadioCounters:
    """What the radio has done since its medium was set, and whether it kept up."""

    hosts: dict[str, RadioHost] = field(default_factory=dict)  #: By name.
    delivered: int = 0  #: Frames that reached a receiver, each receiver counted.
    #: Of those, frames that were delivered more than `late_after_s` after they were due.
    late: int = 0
    late_after_s: float = 0.0  #: What counts as late, seconds.
    late_mean_s: float = 0.0  #: Mean delay beyond the due time, of all frames, seconds.
    late_most_s: float = 0.0  #: The longest of these delays, seconds.
    overrun: int = 0  #: Frames that the kernel dropped because the relay did not take them, or it.
    elapsed_s: float = 0.0  #: How long ago the medium was set, seconds.

    @property
    def lost(self) -> int:
        """Frames that a receiver did not get, each receiver counted."""
        return sum(host.lost for host in self.hosts.values())

    @property
    def queue_full(self) -> int:
        """Frames that found their sender's queue full."""
        return sum(host.queue_full for host in self.hosts.values())

    @property
    def kept_up(self) -> bool:
        """Whether the relay was the medium it should be: nothing overrun, at most 1 % of the frames late."""
        return self.overrun == 0 and self.late <= 0.01 * self.delivered

    def said(self) -> str:
        """Return in one line how well the relay kept up."""
        return (
            f"{self.delivered} frames delivered, {self.late} of them more than {self.late_after_s * 1e3:g} ms "
            f"late (mean {self.late_mean_s * 1e3:.2f} ms, most {self.late_most_s * 1e3:.1f} ms), "
            f"{self.overrun} overrun"
        )


class Relay:
    """The running relay; lives in the hub. Ports are name, interface and MAC address of each host.

    Raises:
        OSError: It cannot be started.
    """

    def __init__(self, ports: Sequence[tuple[str, str, str]]) -> None:
        self._control, other = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        self._control.settimeout(_ANSWER_TIMEOUT_S)
        with other:
            self._process = subprocess.Popen(
                [sys.executable, "-P", "-m", "sfglab.lab.hosts.radio_relay", str(other.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                pass_fds=(other.fileno(),),
            )
        try:
            self.request("start", ports=ports)
        except BaseException:
            self.close()
            raise

    def request(self, operation: str, **arguments: Any) -> dict[str, Any]:
        """Ask the relay to ``start``, ``set`` or tell ``counters``; `OSError` if it is gone or refuses."""
        with contextlib.suppress(BrokenPipeError):  # reported by the missing answer
            self._control.send(json.dumps({"op": operation, **arguments}).encode())
        data = self._control.recv(_MAX_ANSWER_BYTES)
        if not data:
            raise OSError("the relay of the radio has ended (see the message above)")
        answer: dict[str, Any] = json.loads(data)
        if "refused" in answer:
            raise PermissionError(answer["refused"])
        return answer

    def close(self) -> None:
        """End the relay."""
        self._control.close()
        try:
            self._process.wait(_END_TIMEOUT_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()

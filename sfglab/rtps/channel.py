"""The wireless channel: what describes it, and its rules, one plain function each.

This is the only place with these rules. `medium` compiles the functions for the model of RTPS; the radio
between test hosts (`sfglab.lab.hosts.radio_relay`) calls them as they are, without Numba, whose import takes
longer than a relay may take to start. So each function uses numbers and sequences only, and calls no other.

Hosts share a half-duplex medium, as Wi-Fi is, or each has a sender of its own, as an Ethernet port is. A
frame waits in its host's queue, is on air when its host's turn comes, and is lost or arrives. Without an
access point it is on air once, else twice. Times of the rules are nanoseconds, those of `Medium` seconds; sizes
are bytes with the Ethernet header.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal, get_args

from sfglab.errors import InvalidValueError
from sfglab.fields import between, check_bounds
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

QueueRule = Literal["tail", "head", "block"]
QUEUE_RULES: tuple[QueueRule, ...] = get_args(QueueRule)
TAIL, HEAD, BLOCK = range(len(QUEUE_RULES))

JOINS, DISPLACES, REFUSED = range(3)
"""Results of `admission`."""

# --- The rules ---------------------------------------------------------------------------------


def airtime_ns(
    size_bytes: int, contenders: int, overhead_ns: int, rate_bps: float, contention: float
) -> int:
    """Return how long a frame is on air while so many hosts have something to send.

    Each host beyond the first stretches it by the share `contention`; the rest as `Medium` has it.
    """
    stretch = 1.0 + contention * (contenders - 1)
    return int((overhead_ns + size_bytes * 8e9 / rate_bps) * stretch)


def next_sender(waiting: Sequence[Any], turn: int, passed: int) -> tuple[int, int]:
    """Return the host that sends next, -1 for none, and how many hosts contend.

    Args:
        waiting: For each host, whether it has something to send.
        turn: Host whose turn it is; the others follow in order.
        passed: Place of the chosen host among those that contend, in order from `turn`; 0 if hosts take
            turns. For a random host, as with Wi-Fi's backoff, it is a draw from [0, 1) times the number
            of contenders, rounded down; a first call returns this number.
    """
    hosts = len(waiting)
    chosen, contenders = -1, 0
    host = turn - 1
    for _ in range(hosts):
        host += 1
        if host == hosts:
            host = 0
        if waiting[host]:
            if contenders == passed:
                chosen = host
            contenders += 1
    return chosen, contenders


def admission(rule: int, waiting: int, room: int) -> int:
    """Return what becomes of a frame that comes to a queue with so many frames and so much room.

    It `JOINS` while there is room. A full queue of the rule `HEAD` drops its oldest frame
    (`DISPLACES`), any other one the frame that comes (`REFUSED`).
    """
    if waiting < room:
        return JOINS
    return DISPLACES if rule == HEAD else REFUSED


def is_blocked(blocked: bool, waiting: int, room: int) -> bool:  # noqa: FBT001 - compiled
    """Return whether a queue of the rule `BLOCK` accepts no frame.

    A queue that was full lets go once half has left (Linux, net/core/sock.c, `sock_writeable`).
    """
    return waiting >= room or (blocked and 2 * waiting > room)


def after_stall_ns(now_ns: int, every_ns: int, stall_ns: int) -> int:
    """Return when a frame can begin that is ready now: the medium stalls as each period begins."""
    if stall_ns == 0 or now_ns % every_ns >= stall_ns:
        return now_ns
    return now_ns + stall_ns - now_ns % every_ns


def is_lost(lost_before: bool, draw: float, loss: float, burst_frames: float) -> bool:  # noqa: FBT001 - compiled
    """Return whether a frame is lost.

    Args:
        lost_before: Whether the sender's frame before it was lost.
        draw: Random number from [0, 1).
        loss: Share of frames that are lost.
        burst_frames: Mean length of a burst of losses, frames; below 1 each frame is drawn by itself.

    Losses come in bursts as of E. N. Gilbert, Capacity of a Burst-Noise Channel, 1960, with every frame
    lost in the bad state.
    """
    if burst_frames < 1:
        return draw < loss
    return draw >= 1 / burst_frames if lost_before else draw < loss / ((1 - loss) * burst_frames)


# --- The description -----------------------------------------------------------------------------

_LONGEST_S = 1e9  # its nanoseconds have 63 bits


@dataclass(frozen=True, slots=True, kw_only=True)
class Medium:
    """A channel that carries the frames.

    Raises:
        InvalidValueError: A field is out of its range, or two fields contradict each other.
    """

    rate_bps: float = between(20e6, without=(0, math.inf))  #: Bits per second.
    #: Share of frames that are lost, after the medium's own retransmissions.
    loss: float = between(0.01, 0, 1, without=(1,))
    #: One half-duplex medium for all hosts (Wi-Fi); else each host sends independently.
    shared: bool = True
    #: Airtime overhead per frame, seconds: preamble, gaps, acknowledgement.
    overhead_s: float = between(300e-6, 0, _LONGEST_S)
    #: Share by which each further host that has something to send stretches a frame.
    contention: float = between(0.15, without=(math.inf,))
    #: Time from the end of sending to arrival, seconds.
    latency_s: float = between(0.0, 0, _LONGEST_S)
    queue_frames: int = between(500, 1)  #: Frames that a host's queue holds.
    #: Rule of a full queue. ``tail`` drops the frame that comes last, as a driver or an access point does.
    #: ``head`` drops the oldest frame, as CoDel does, Ubuntu's default. ``block`` makes the sender wait, as
    #: Linux does where the socket's buffer is smaller than the queue. The radio of test hosts offers this
    #: only with ``shared=False``, because its relay cannot make a sender wait for another host's frame.
    queue_rule: QueueRule = "tail"
    #: Whether frames pass an access point, one more host that contends: they are on air twice.
    access_point: bool = False
    #: Whether chance decides which of the contending hosts sends next, as Wi-Fi's backoff does; else hosts
    #: take turns. Behind an access point turns starve hosts: the same one always takes the free place of a
    #: full queue.
    random_turns: bool = False
    #: Mean length of a burst of losses, frames; below 1: each frame is lost by itself.
    burst_frames: float = between(0.0, without=(math.inf,))
    #: Period of channel stalls, seconds: scans, power saving, neighbours.
    stall_every_s: float = between(0.0, 0, _LONGEST_S)
    #: Length of a stall, seconds: no frame begins in it.
    stall_s: float = between(0.0, 0, _LONGEST_S)

    def __post_init__(self) -> None:
        check_bounds(self, "medium: ")
        if self.burst_frames >= 1 and self.loss > self.burst_frames / (1 + self.burst_frames):
            given = self.loss, self.burst_frames
            allowed = "loss <= burst_frames / (1 + burst_frames), or a single frame arrives between bursts"
            raise InvalidValueError("medium: loss, burst_frames", given, allowed)
        if self.queue_rule not in QUEUE_RULES:
            raise InvalidValueError("medium: queue_rule", self.queue_rule, ", ".join(QUEUE_RULES))
        if self.access_point and not self.shared:
            raise InvalidValueError("medium: access_point", True, "only on a shared medium")
        if self.stall_s and self.stall_s >= self.stall_every_s:
            given = self.stall_s, self.stall_every_s
            allowed = "stall_s < stall_every_s"
            raise InvalidValueError("medium: stall_s, stall_every_s", given, allowed)

    @property
    def rule(self) -> int:
        """Index of `queue_rule` in `QUEUE_RULES`."""
        return QUEUE_RULES.index(self.queue_rule)

    @property
    def overhead_ns(self) -> int:
        """`overhead_s` in nanoseconds."""
        return round(self.overhead_s * NS_PER_S)

    @property
    def latency_ns(self) -> int:
        """`latency_s` in nanoseconds."""
        return round(self.latency_s * NS_PER_S)

    @property
    def stall_every_ns(self) -> int:
        """`stall_every_s` in nanoseconds."""
        return round(self.stall_every_s * NS_PER_S)

    @property
    def stall_ns(self) -> int:
        """`stall_s` in nanoseconds."""
        return round(self.stall_s * NS_PER_S)

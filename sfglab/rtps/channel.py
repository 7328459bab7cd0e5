"""The module `channel` has the wireless channel: its description, and its rules as one plain function each.

No other module has these rules. The module `medium` compiles the functions for the RTPS model. The radio
between test hosts (`sfglab.lab.hosts.radio_relay`) calls the functions without Numba, because the import of Numba
takes longer than the start of a relay may take. Therefore each function uses only numbers and sequences, and calls
no other function.

Hosts share a half-duplex medium, as with Wi-Fi, or each host has its own sender, as with an Ethernet port. A
frame waits in its host's queue, is on air when its host's turn comes, and is lost or arrives. Without an
access point a frame is on air once, otherwise twice. Times of the rules are nanoseconds, times of `Medium` are
seconds. Sizes are bytes with the Ethernet header.
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
    """Return how long a frame is on air, ns, while a number of hosts contend.

    Args:
        size_bytes: Size of the frame with the Ethernet header, bytes.
        contenders: Number of hosts that have a frame to send; each host beyond the first one lengthens the frame.
        overhead_ns: Airtime overhead per frame, ns.
        rate_bps: Bit rate, bits per second.
        contention: Share by which each further host lengthens the frame.
    """
    stretch = 1.0 + contention * (contenders - 1)
    return int((overhead_ns + size_bytes * 8e9 / rate_bps) * stretch)


def next_sender(waiting: Sequence[Any], turn: int, passed: int) -> tuple[int, int]:
    """Return the host that sends next, -1 if no host has a frame, and the number of hosts that contend.

    Args:
        waiting: Whether each host has a frame to send.
        turn: Host whose turn is next; the other hosts follow in order.
        passed: Place of the chosen host among the hosts that contend, in order from `turn`; 0 if hosts take
            turns. A random host, as with Wi-Fi's backoff, has a random number from [0, 1) times the number of
            contenders, rounded down, as its place; a first call returns the number of contenders.
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
    """Return what happens to a frame that comes to a queue with a number of waiting frames and with some room.

    The frame joins a queue that has room (`JOINS`). A full queue of the rule `HEAD` drops its oldest frame
    (`DISPLACES`); any other full queue drops the new frame (`REFUSED`).
    """
    if waiting < room:
        return JOINS
    return DISPLACES if rule == HEAD else REFUSED


def is_blocked(blocked: bool, waiting: int, room: int) -> bool:  # noqa: FBT001 - compiled
    """Return whether a queue of the rule `BLOCK` accepts no frame.

    A queue that was full accepts frames again when half of its frames have left (Linux, net/core/sock.c,
    `sock_writeable`).
    """
    return waiting >= room or (blocked and 2 * waiting > room)


def after_stall_ns(now_ns: int, every_ns: int, stall_ns: int) -> int:
    """Return the time, ns, at which a frame that is ready now can begin.

    The medium stalls for `stall_ns` at the beginning of each period `every_ns`.
    """
    if stall_ns == 0 or now_ns % every_ns >= stall_ns:
        return now_ns
    return now_ns + stall_ns - now_ns % every_ns


def is_lost(lost_before: bool, draw: float, loss: float, burst_frames: float) -> bool:  # noqa: FBT001 - compiled
    """Return whether a frame is lost.

    Args:
        lost_before: Whether the medium lost the frame that the sender sent before.
        draw: Random number from [0, 1).
        loss: Share of frames that the medium loses.
        burst_frames: Mean length of a burst of losses, frames; below 1 each loss is independent.

    Losses come in bursts as in the model of E. N. Gilbert, Capacity of a Burst-Noise Channel, 1960, with every frame
    lost in the bad state.
    """
    if burst_frames < 1:
        return draw < loss
    return draw >= 1 / burst_frames if lost_before else draw < loss / ((1 - loss) * burst_frames)


# --- The description -----------------------------------------------------------------------------

_LONGEST_S = 1e9  # The nanoseconds of this time fit into 63 bits.


@dataclass(frozen=True, slots=True, kw_only=True)
class Medium:
    """A `Medium` is a channel that carries the frames.

    Raises:
        InvalidValueError: A field is out of its range, or two fields contradict each other.
    """

    rate_bps: float = between(20e6, without=(0, math.inf))  #: Bit rate, bits per second.
    #: Share of frames that the medium loses in spite of its own retransmissions.
    loss: float = between(0.01, 0, 1, without=(1,))
    #: Whether all hosts share one half-duplex medium (Wi-Fi); otherwise each host sends independently.
    shared: bool = True
    #: Airtime overhead per frame, seconds: preamble, gaps, acknowledgement.
    overhead_s: float = between(300e-6, 0, _LONGEST_S)
    #: Share by which each further host that contends lengthens a frame.
    contention: float = between(0.15, without=(math.inf,))
    #: Time from the end of sending to the arrival of a frame, seconds.
    latency_s: float = between(0.0, 0, _LONGEST_S)
    queue_frames: int = between(500, 1)  #: Number of frames that a host's queue holds.
    #: Rule of a full queue. ``tail`` drops the newest frame, as a driver or an access point does.
    #: ``head`` drops the oldest frame, as CoDel does, Ubuntu's default. ``block`` makes the sender wait, as
    #: Linux does if the socket's buffer is smaller than the queue. The radio of test hosts cannot make a
    #: sender wait, and has no ``block``.
    queue_rule: QueueRule = "tail"
    #: Whether frames pass an access point, a further host that contends; each frame is then on air twice.
    access_point: bool = False
    #: Whether a random host of the contending hosts sends next, as with Wi-Fi's backoff; otherwise hosts
    #: take turns. Behind an access point turns starve hosts: the same host always takes the free place of a
    #: full queue.
    random_turns: bool = False
    #: Mean length of a burst of losses, frames; below 1 each loss is independent.
    burst_frames: float = between(0.0, without=(math.inf,))
    #: Period of channel stalls (scans, power saving, neighbours), seconds.
    stall_every_s: float = between(0.0, 0, _LONGEST_S)
    #: Length of a channel stall, seconds; no frame begins during a stall.
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

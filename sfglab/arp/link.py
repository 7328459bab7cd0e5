"""The module `link` computes what topics cost on a link, and how long retransmissions delay topics, in closed form.

The link is a half-duplex medium that all hosts share, as with Wi-Fi. A plan needs the airtime of samples and
acknowledgements, the mean wait in the queue, and the mean delay because of retransmissions (`repairs`). For samples
that fit into one frame, the frames, delays and heartbeats are those of the simulation in `sfglab.rtps`. A larger
sample takes several IP fragments here, and one long frame in the simulation. Cyclone DDS divides samples from about
1.3 kB into RTPS fragments instead, which neither model includes.

Given the depths, every formula is convex in the rates. Each formula is written once, for numbers and for CVXPY's
expressions. The formulas are of first order in the losses. They leave out GAPs and heartbeats that travel alone, which
are rare if heartbeats travel with samples. Arrays have one entry per topic, shape (n,).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.repairs import alone_held, riding_held
from sfglab.errors import InvalidValueError
from sfglab.qos import Durability
from sfglab.rtps.frames import ACKNACK_BYTES, IP_BYTES, IP_PAYLOAD_BYTES, data_bytes

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from sfglab.arp.topics import Topic, TopicFile
    from sfglab.rtps import Medium

    Floats = NDArray[np.float64]

_LEAST = 1e-9
_LOSS_MOST = 0.99  # with a higher loss no reasonable number of retransmissions helps


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """A `Link` has the topics on a medium as arrays."""

    #: Airtime that one sample costs with all hosts contending, with repeats, seconds, shape (n,).
    data_s: Floats
    #: Airtime that the acknowledgements of one sample cost, also with repeats, seconds, shape (n,).
    acknack_s: Floats
    acknack_share: Floats  #: Number of acknowledgements per sample, shape (n,).
    #: Largest number of acknowledgements per second, because one acknowledges all heartbeats within the reader's
    #: delay; shape (n,).
    acknack_most_hz: Floats
    #: Changes per second of a topic's value if a local cache passes only changes, otherwise infinite, shape (n,).
    change_most_hz: Floats
    frame_s: float  #: Mean airtime of one frame without contention, seconds.
    contention: float  #: Share by which all hosts together stretch a frame.
    #: Time from being sent to arrival without queue and contention, seconds, shape (n,).
    way_s: Floats
    #: Time from the heartbeat that shows a gap to the arrival of the retransmission, seconds, shape (n,).
    round_s: Floats
    #: Additional time that a reader waits before it requests the same samples again, seconds.
    again_s: float
    period_s: float  #: Period of heartbeats that travel without a sample, seconds.
    #: Time between two samples below which the heartbeat of the later sample requests no response, seconds.
    final_within_s: float
    nack_most: int  #: Largest number of samples that one request can name.
    #: Share of a topic's samples that lose a frame on the medium, shape (n,).
    loss: Floats
    reliable: NDArray[np.bool_]  #: Whether a topic's losses are retransmitted, shape (n,).
    batching: NDArray[np.bool_]  #: Whether heartbeats come once in `depth` samples, shape (n,).
    #: `repairs.Held` of each topic, shape (3, n); zeros for best-effort topics, whose samples wait for no other.
    held: Floats

    @property
    def arriving(self) -> Floats:
        """Share of samples that arrive: 1 for a reliable topic, 1 - loss for a best-effort topic, shape (n,)."""
        return np.where(self.reliable, 1.0, 1 - self.loss)

    @property
    def cached(self) -> NDArray[np.bool_]:
        """Whether a local cache passes only changes of a topic's value, shape (n,)."""
        return np.isfinite(self.change_most_hz)

    def utilisation(self, rates_hz: Floats) -> float:
        """Return the channel utilisation for rates, Hz, shape (n,): the share of the medium's time that they take."""
        sent_hz = self.sent_hz(rates_hz)
        return float(self.data_s @ sent_hz + self.acknack_s @ self.acknacks_hz(sent_hz))

    def acknacks_hz(self, sent_hz: Floats) -> Floats:
        """Return the acknowledgements per second of each topic, given its travelling samples per second, shape (n,)."""
        return np.minimum(self.acknack_share * sent_hz, self.acknack_most_hz)

    def sent_hz(self, rates_hz: Floats) -> Floats:
        """Return the samples per second that travel, given the readings per second, shape (n,) each.

        Without a local cache all samples travel. With a local cache r (1 - exp(-1 / (r t))) samples travel: the
        readings with a new value, at r readings per second and a mean time t between changes.
        """
        cached = self.cached
        new = -np.expm1(-np.where(cached, self.change_most_hz, 1.0) / rates_hz)
        return np.where(cached, rates_hz * new, rates_hz)


def link_of(given: TopicFile) -> Link:
    """Return the costs of topics on their link, with their vendor's timing, for histories of one sample.

    `at_depths` returns the costs for other depths. Each further host that contends lengthens every frame
    (`Medium.contention`). The airtimes assume that all hosts contend, as on a nearly full medium, because only there
    does the capacity limit a plan.

    Raises:
        InvalidValueError: The medium loses more than 99 % of a topic's samples.
    """
    topics = given.topics
    medium = given.medium
    vendor = given.vendor
    hosts: set[str] = set()
    for topic in topics:
        hosts.add(topic.source)
        if topic.reliable:  # receivers acknowledge
            hosts.update(topic.targets)
    contention = medium.contention * (len(hosts) - 1)
    data_s, acknack_s = _frames_s(topics, medium)
    way_s = data_s + medium.latency_s
    acknack_way_s = _air_s(medium, ACKNACK_BYTES) + medium.latency_s
    reliable = np.array([topic.reliable for topic in topics])
    volatile = np.array([topic.durability is Durability.VOLATILE for topic in topics])
    change_most_hz = np.array([1 / t.change_s if t.cached else np.inf for t in topics])
    loss = np.array([loss_of(topic, medium) for topic in topics])
    bundled_s = 0.0 if vendor.prompt else vendor.ack_delay_ns / 1e9
    # A retransmission takes this time besides its transmission; a prompt reader waits only before its second request.
    answer_ns = (0 if vendor.prompt else vendor.nack_delay_ns) + vendor.nack_response_ns
    frames_s = np.concatenate([data_s, acknack_s])
    link = Link(
        data_s=data_s * (1 + contention) * np.where(reliable, 1 / (1 - loss), 1.0),
        acknack_s=acknack_s * (1 + contention),
        acknack_share=np.ones(len(topics)),
        acknack_most_hz=np.full(len(topics), 1 / max(bundled_s, _LEAST)),
        change_most_hz=change_most_hz,
        frame_s=float(frames_s.sum() / np.count_nonzero(frames_s)),
        contention=contention,
        way_s=way_s,
        round_s=answer_ns / 1e9 + acknack_way_s + way_s,
        again_s=vendor.nack_delay_ns / 1e9 if vendor.prompt else 0.0,
        period_s=vendor.heartbeat_ns / 1e9,
        final_within_s=vendor.final_within_ns / 1e9,
        nack_most=vendor.nack_most,
        loss=loss,
        reliable=reliable,
        batching=reliable & volatile & (not vendor.shows_each),
        held=np.zeros((3, len(topics))),
    )
    rates_hz = np.array([topic.rate_max_hz for topic in topics])
    return at_depths(link, np.ones(len(topics), np.int64), rates_hz)


def loss_of(topic: Topic, medium: Medium) -> float:
    """Return the share of a topic's samples that lose at least one of their frames.

    Raises:
        InvalidValueError: The share is above 99 %.
    """
    frames = frames_of(topic)
    loss = medium.loss if frames == 1 else float(1 - (1 - medium.loss) ** frames)
    if loss > _LOSS_MOST:
        given = f"{topic.size_bytes} bytes in {frames} frames, of which the link loses {medium.loss:.2%}"
        allowed = f"sizes and links with which at most {_LOSS_MOST:.0%} of the samples lose a frame"
        raise InvalidValueError(f"topic {topic.name!r}", given, allowed)
    return loss


def at_depths(link: Link, depths: NDArray[np.int64], rates_hz: Floats) -> Link:
    """Return a link with the acknowledgements and delays for given depths.

    If heartbeats come in batches, a history of d samples that fills within the period causes one acknowledgement per
    d samples; a history that does not fill causes one acknowledgement per period. If heartbeats soon after a sample
    request no response, only heartbeats after a pause cause an acknowledgement. Each lost sample also causes a request.
    The rates, shape (n,) like the depths, decide only which heartbeats follow soon, and which histories fill in time.
    """
    sent_hz, cached = link.sent_hz(rates_hz), link.cached
    share = np.ones_like(sent_hz)
    most_hz = link.acknack_most_hz.copy()
    held = np.zeros((3, len(sent_hz)))
    for i in np.flatnonzero(link.reliable).tolist():
        sent, loss, round_s = float(sent_hz[i]), float(link.loss[i]), float(link.round_s[i])
        batch = int(depths[i]) if link.batching[i] else 1
        # A heartbeat is alone if its period ends before a sample can carry it.
        is_alone = batch > sent * link.period_s
        if is_alone:
            held[:, i] = alone_held(sent, link.period_s, round_s, loss)
        else:
            held[:, i] = riding_held(batch, round_s, link.again_s, loss)
        if is_alone and batch > 1:
            most_hz[i] = 1 / link.period_s
        else:
            # This is the share of samples that follow so soon that their heartbeat requests no response.
            within = sent * link.final_within_s
            unasked = -math.expm1(-within) if cached[i] else float(within > 1)
            share[i] = min(1.0, (1 - unasked) / batch + max(loss, _LEAST))
    return replace(link, acknack_share=share, acknack_most_hz=most_hz, held=held)


def wait_s(link: Link, rates_hz: Floats) -> float:
    """Return the mean wait of a frame for contention and queue, seconds; infinite on an overloaded medium.

    The argument `rates_hz` has the topics' rates, shape (n,).
    """
    utilisation = link.utilisation(rates_hz)
    if utilisation >= 1:
        return math.inf
    return float(queue_wait_s(utilisation, link, inverse=np.reciprocal))


def queue_wait_s(utilisation: Any, link: Link, *, inverse: Callable[[Any], Any]) -> Any:
    """Return the mean time, seconds, that contention and the queue add to each frame.

    Frames of one length at random times wait s u / (2 (1 - u)) (M/D/1) at a utilisation u below 1.
    Contention lengthens frames on a busy medium: s = f (1 + k u). Wait and lengthening together are
    f [(1 + k) (1 / (1 - u) - 1) + k u] / 2; f is the time of a frame without contention.
    The argument `inverse` is the function 1 / x for positive x, of the kind of `utilisation`.
    """
    k = link.contention
    return 0.5 * link.frame_s * ((1 + k) * (inverse(1 - utilisation) - 1) + k * utilisation)


def repair_delay_s(link: Link, sent_hz: Any, *, inverse: Callable[[Any], Any]) -> Any:
    """Return the mean delay of each topic's samples because of losses, seconds, shape (n,), convex in the rates.

    A lost sample delays all following samples until its retransmission arrives, T later: p (T / 2 + r T^2 / 2) per
    sample, and p T if no other sample follows within T. The module `repairs` has the parts of T; T + r T^2 is
    a / r + b + c r. The link is that of the topics' depths. The argument `sent_hz` has r, the samples per second that
    travel, shape (n,). The argument `inverse` is the function 1 / x for positive x, of the kind of `sent_hz`.
    """
    spread, fixed, growing = 0.5 * link.loss * link.held
    return _times(spread, inverse(sent_hz)) + fixed + _times(growing, sent_hz)


def _times(factor: NDArray[Any], value: Any) -> Any:
    # CVXPY's `multiply` is the product by elements; the operator `*` would be a product of matrices.
    if isinstance(value, np.ndarray):
        return factor * value
    from cvxpy.atoms.affine.binary_operators import multiply

    return multiply(factor, value)


def _frames_s(topics: Sequence[Topic], medium: Medium) -> tuple[Floats, Floats]:
    """Return the airtime of one sample and of its acknowledgements of each topic, shape (n,) each."""
    data_s, acknack_s = np.zeros((2, len(topics)))
    for i, topic in enumerate(topics):
        receivers = len(topic.targets)
        more = frames_of(topic) - 1
        size_bytes = data_bytes(topic.size_bytes, with_heartbeat=topic.reliable) + more * IP_BYTES
        data_s[i] = receivers * (_air_s(medium, size_bytes) + more * medium.overhead_s)
        if topic.reliable:
            acknack_s[i] = receivers * _air_s(medium, ACKNACK_BYTES)
    return data_s, acknack_s


def frames_of(topic: Topic) -> int:
    """Return the number of frames into which IP fragments a sample; the loss of one frame loses the sample."""
    packet_bytes = data_bytes(topic.size_bytes, with_heartbeat=topic.reliable) - IP_BYTES
    return -(-packet_bytes // IP_PAYLOAD_BYTES)


def _air_s(medium: Medium, size_bytes: int) -> float:
    return medium.overhead_s + size_bytes * 8 / medium.rate_bps

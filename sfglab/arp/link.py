"""Link under topics: what they cost on it and how long repairs hold them up, the arithmetic of the planned QoS.

The same frames, delays and heartbeats as the simulation in `sfglab.rtps`, in closed form: airtime of samples
and acknowledgements, mean wait in the queue, mean delay by repairs (`repairs`). Given the depths, every formula
is convex in the rates; it is written once, for numbers and for CVXPY's expressions. First-order in losses;
heartbeats that travel alone and GAPs are left out, which are rare where heartbeats ride with samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.repairs import alone_held, batch_held, steady_held
from sfglab.qos import Durability
from sfglab.rtps.model import ACKNACK_BYTES, data_bytes

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from sfglab.arp.topics import Topic
    from sfglab.rtps import Medium, Vendor

_LEAST = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """Topics on a medium, as arrays; S senders take turns or are independent, n topics."""

    #: Who sends at one time: the medium where it is shared, else each host.
    senders: tuple[str, ...]
    sender: NDArray[np.intp]  #: Which of them carries a topic's samples, shape (n,).
    #: Time of a sender that one sample costs with all hosts contending, with repeats, shape (S, n).
    data_s: NDArray[np.float64]
    #: Time of a sender that one acknowledgement costs alike, shape (S, n).
    acknack_s: NDArray[np.float64]
    acknack_share: NDArray[np.float64]  #: Acknowledgements for each sample, shape (n,).
    #: Acknowledgements at most, as the reader's delay bundles heartbeats, shape (n,).
    acknack_most_hz: NDArray[np.float64]
    #: Changes of a topic's value where a local cache lets only those pass, else infinite, shape (n,).
    change_most_hz: NDArray[np.float64]
    #: Mean time on the air of one frame without contention, shape (S,).
    frame_s: NDArray[np.float64]
    contention: float  #: By which share all hosts together stretch a frame.
    #: From being sent to arrival without queue and contention, shape (n,).
    way_s: NDArray[np.float64]
    #: From the heartbeat that shows a gap to the repair's arrival, shape (n,).
    round_s: NDArray[np.float64]
    again_s: float  #: What a reader waits besides before it asks for the same again.
    period_s: float  #: Between heartbeats that travel alone.
    final_within_s: float  #: A heartbeat that follows a sample sooner than this asks for no answer.
    nack_most: int  #: Samples that one request can ask for.
    #: Share of a topic's samples of which the medium loses a frame, shape (n,).
    loss: NDArray[np.float64]
    reliable: NDArray[np.bool_]  #: Whether a topic is repaired, shape (n,).
    batching: NDArray[np.bool_]  #: Whether heartbeats come once in `depth` samples, shape (n,).
    #: `repairs.Held` of each topic, zeros of those not repaired, shape (3, n).
    held: NDArray[np.float64]

    @property
    def arriving(self) -> NDArray[np.float64]:
        """Share of samples that arrive at all: what the medium loses of a best-effort topic does not."""
        return np.where(self.reliable, 1.0, 1 - self.loss)

    def unasked(self, sent_hz: float, *, at_random: bool) -> float:
        """Return the share of samples that follow too soon for their heartbeat to ask for an answer."""
        if at_random:
            return -math.expm1(-sent_hz * self.final_within_s)
        return float(sent_hz * self.final_within_s > 1)

    def utilisation(self, rates_hz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the share of each sender's time that rates take, shape (S,)."""
        return self.load(self.sent_hz(rates_hz))

    def load(self, sent_hz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the share of each sender's time that samples take, of which so many are sent, shape (S,)."""
        acknacks = np.minimum(self.acknack_share * sent_hz, self.acknack_most_hz)
        return np.asarray(self.data_s @ sent_hz + self.acknack_s @ acknacks)

    def sent_hz(self, rates_hz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how many samples a second travel, shape (n,).

        All, or where a cache lets only changes pass, r (1 - exp(-1 / (r t))): readings that find a new value.
        """
        cached = np.isfinite(self.change_most_hz)
        new = -np.expm1(-np.where(cached, self.change_most_hz, 1.0) / rates_hz)
        return np.where(cached, rates_hz * new, rates_hz)


def link_of(topics: Sequence[Topic], medium: Medium, vendor: Vendor) -> Link:
    """Return what topics cost on a medium with a vendor's timing, with histories of one sample (`at_depths`).

    On a shared medium every further host that contends stretches each frame (`Medium.contention`). Capacity is
    reckoned with all hosts contending, as they do when the medium is nearly full, which is when it decides.
    """
    hosts = sorted(
        {host for t in topics for host in (t.source, *(t.targets if t.reliable else ()))}
    )
    senders = ("the medium",) if medium.shared else tuple(hosts)
    contention = medium.contention * (len(hosts) - 1) if medium.shared else 0.0
    data_s, acknack_s = _frames_s(topics, medium, senders)
    way_s = data_s.sum(axis=0) + medium.latency_s
    acknack_way_s = _air_s(medium, ACKNACK_BYTES) + medium.latency_s
    reliable = np.array([t.reliable for t in topics])
    change_most_hz = np.array([1 / t.change_s if t.cached else np.inf for t in topics])
    frames = np.array([frames_of(t) for t in topics])
    loss = np.where(frames == 1, medium.loss, 1 - (1 - medium.loss) ** frames)
    spacing_s = 0.0 if vendor.prompt or vendor.piggyback_when_full else vendor.heartbeat_ns / 1e9
    bundled_s = 0.0 if vendor.prompt else max(vendor.ack_delay_ns / 1e9, spacing_s)
    # What a repair costs beside its way: a prompt reader waits only before it asks a second time.
    answer_ns = (0 if vendor.prompt else vendor.nack_delay_ns) + vendor.nack_response_ns
    frames_s = np.concatenate([data_s, acknack_s], axis=1)
    volatile = np.array([t.durability is Durability.VOLATILE for t in topics])
    link = Link(
        senders=senders,
        sender=data_s.argmax(axis=0),
        data_s=data_s * (1 + contention) * np.where(reliable, 1 / (1 - loss), 1.0),
        acknack_s=acknack_s * (1 + contention),
        acknack_share=np.ones(len(topics)),
        acknack_most_hz=np.full(len(topics), 1 / max(bundled_s, _LEAST)),
        change_most_hz=change_most_hz,
        frame_s=frames_s.sum(axis=1) / np.maximum((frames_s > 0).sum(axis=1), 1),
        contention=contention,
        way_s=way_s,
        round_s=answer_ns / 1e9 + spacing_s + acknack_way_s + way_s,
        again_s=vendor.nack_delay_ns / 1e9 if vendor.prompt else 0.0,
        period_s=vendor.heartbeat_ns / 1e9,
        final_within_s=vendor.final_within_ns / 1e9,
        nack_most=vendor.nack_most,
        loss=loss,
        reliable=reliable,
        batching=reliable & volatile & (vendor.piggyback_when_full and not vendor.shows_each),
        held=np.zeros((3, len(topics))),
    )
    return at_depths(
        link, np.ones(len(topics), np.int64), np.array([t.rate_max_hz for t in topics])
    )


def at_depths(link: Link, depths: NDArray[np.int64], rates_hz: NDArray[np.float64]) -> Link:
    """Return a link with the acknowledgements and delays that depths bring.

    Where heartbeats come in batches, a history of d samples that fills within the period costs an
    acknowledgement for every d samples; one that does not, one for each period. Where heartbeats that follow
    soon ask for no answer, only those after a pause cost one. A request for each lost sample comes on top.
    Rates, shape (n,) as depths, decide only what follows soon, and whether histories fill within a period.
    """
    sent_hz = link.sent_hz(rates_hz)
    share, most_hz, held = (
        np.ones_like(sent_hz),
        link.acknack_most_hz.copy(),
        np.zeros_like(link.held),
    )
    for i in np.flatnonzero(link.reliable):
        sent, round_s, loss = float(sent_hz[i]), float(link.round_s[i]), float(link.loss[i])
        batch = int(depths[i]) if link.batching[i] else 1
        alone = batch > sent * link.period_s
        if alone:
            held[:, i] = alone_held(sent, link.period_s, round_s, loss)
        elif link.batching[i]:
            held[:, i] = batch_held(batch, round_s, loss)
        else:
            held[:, i] = steady_held(round_s, link.again_s, loss)
        if alone and batch > 1:
            most_hz[i] = 1 / link.period_s
        else:
            unasked = link.unasked(sent, at_random=bool(np.isfinite(link.change_most_hz[i])))
            share[i] = min(1.0, (1 - unasked) / batch + max(loss, _LEAST))
    return replace(link, acknack_share=share, acknack_most_hz=most_hz, held=held)


def waits_s(link: Link, rates_hz: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how long each topic's samples wait, infinite where the sender is overloaded, shape (n,)."""
    utilisation = link.utilisation(rates_hz)
    # Up to 1 the formula holds; beyond, there is no mean.
    waits = queue_wait_s(np.minimum(utilisation, 1 - 1e-9), link, inverse=np.reciprocal)
    return np.where(utilisation < 1, waits, math.inf)[link.sender]


def queue_wait_s(utilisation: Any, link: Link, *, inverse: Callable[[Any], Any]) -> Any:
    """Return the mean time that contention and the queue add to each frame, of every sender, shape (S,).

    Frames of one length at random times wait s u / (2 (1 - u)) (M/D/1), u being the utilisation, below 1.
    Contention makes them longer the busier the medium is, s = f (1 + k u), and so the frame itself:
    f [(1 + k) (1 / (1 - u) - 1) + k u] / 2 in all; f is the time of a frame that nobody contends with.
    `inverse` is 1 / x for positive x, of the kind of `utilisation`.
    """
    k = link.contention
    return _times(0.5 * link.frame_s, (1 + k) * (inverse(1 - utilisation) - 1) + k * utilisation)


def repair_delay_s(link: Link, sent_hz: Any, *, inverse: Callable[[Any], Any]) -> Any:
    """Return by how much losses hold up a topic's samples on average, shape (n,); convex in the rates.

    A lost sample holds up all that follow it until it is repaired, T later: p (T / 2 + r T^2 / 2) a sample. Of
    what T consists stands in `repairs`; T + r T^2 is a / r + b + c r. The link is that of the topics' depths,
    r the samples a second that travel, shape (n,), and `inverse` 1 / x for positive x, of the kind of r.
    """
    spread, fixed, growing = 0.5 * link.loss * link.held
    return _times(spread, inverse(sent_hz)) + fixed + _times(growing, sent_hz)


def _times(factor: NDArray[Any], value: Any) -> Any:
    # CVXPY's product by elements; `*` means another one for its matrices.
    if isinstance(value, np.ndarray):
        return factor * value
    from cvxpy.atoms.affine.binary_operators import multiply

    return multiply(factor, value)


def _frames_s(
    topics: Sequence[Topic], medium: Medium, senders: tuple[str, ...]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return what one sample and one acknowledgement of each topic take of whose time, shape (S, n) each."""
    data_s, acknack_s = np.zeros((2, len(senders), len(topics)))
    for i, topic in enumerate(topics):
        there = 0 if medium.shared else senders.index(topic.source)
        more = frames_of(topic) - 1
        size_bytes = (
            data_bytes(topic.size_bytes, with_heartbeat=topic.reliable) + more * _AGAIN_BYTES
        )
        data_s[there, i] = len(topic.targets) * (
            _air_s(medium, size_bytes) + more * medium.overhead_s
        )
        for target in topic.targets if topic.reliable else ():
            acknack_s[0 if medium.shared else senders.index(target), i] += _air_s(
                medium, ACKNACK_BYTES
            )
    return data_s, acknack_s


_PAYLOAD_BYTES, _AGAIN_BYTES = 1480, 34
"""What a frame carries of an IP packet (RFC 894, RFC 791), and the headers that each further one has."""


def frames_of(topic: Topic) -> int:
    """Return into how many frames IP cuts a sample; it is lost with any of them."""
    return -(
        -(data_bytes(topic.size_bytes, with_heartbeat=topic.reliable) - _AGAIN_BYTES)
        // _PAYLOAD_BYTES
    )


def _air_s(medium: Medium, size_bytes: int) -> float:
    return medium.overhead_s + size_bytes * 8 / medium.rate_bps

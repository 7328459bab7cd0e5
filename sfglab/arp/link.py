"""What topics cost on a link, and how long repairs hold them up: the arithmetic behind the planned QoS.

The same frames, delays and heartbeats as the simulation in `sfglab.rtps`, in closed form: airtime of each
sample and of its acknowledgement, mean wait in the queue, mean delay by repairs. Every formula is convex in
the rates and is written once, for numbers and for CVXPY's expressions alike. Refuses to know what is optimal.

First-order in losses: gaps that overlap are counted one by one. The airtime of heartbeats that travel alone
and of GAPs is left out; they are rare where heartbeats ride with samples.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.rtps.sizes import ACKNACK_BYTES, data_bytes

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from sfglab.arp.topics import Topic
    from sfglab.rtps import Medium, Vendor

__all__ = ["Link", "link_of", "queue_wait_s", "repair_delay_s", "rounds_needed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """Topics on a medium, as arrays; S senders take turns or are independent, n topics.

    Attributes:
        senders: Who sends at one time: the medium where it is shared, else each host.
        sender: Which of them carries a topic's samples, shape (n,).
        data_s: Time of a sender that one sample costs with all hosts contending, with repeats, shape (S, n).
        acknack_s: Time of a sender that one acknowledgement costs alike, shape (S, n).
        acknack_most_hz: Acknowledgements of one topic, at most: the reader's delay bundles heartbeats.
        change_most_hz: Changes of a topic's value where a local cache lets only those pass, else infinite,
            shape (n,).
        frame_s: Mean time on the air of one frame without contention, shape (S,).
        contention: By which share all hosts together stretch a frame.
        way_s: From being sent to arrival without queue and contention, shape (n,).
        round_s: From the heartbeat that shows a gap to the repair's arrival, shape (n,).
        rides: 1 where heartbeats ride with samples, 0 where they come alone: where the vendor lets none ride,
            or where the topic is never faster than the periodic ones, shape (n,).
        heartbeat_s: Least time between heartbeats that ride, or the period of those that do not, shape (n,).
        loss: Share of frames that the medium loses.
        reliable: Whether a topic is repaired, shape (n,).
    """

    senders: tuple[str, ...]
    sender: NDArray[np.intp]
    data_s: NDArray[np.float64]
    acknack_s: NDArray[np.float64]
    acknack_most_hz: float
    change_most_hz: NDArray[np.float64]
    frame_s: NDArray[np.float64]
    contention: float
    way_s: NDArray[np.float64]
    round_s: NDArray[np.float64]
    rides: NDArray[np.float64]
    heartbeat_s: NDArray[np.float64]
    loss: float
    reliable: NDArray[np.bool_]

    @property
    def arriving(self) -> NDArray[np.float64]:
        """Share of samples that arrive at all: what the medium loses of a best-effort topic does not."""
        return np.where(self.reliable, 1.0, 1 - self.loss)

    @property
    def round_failure(self) -> float:
        """Probability that a repair fails: its request or the repeated sample is lost."""
        return 1 - (1 - self.loss) ** 2

    def utilisation(self, rates_hz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the share of each sender's time that rates take, shape (S,)."""
        return self.load(self.sent_hz(rates_hz))

    def load(self, sent_hz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the share of each sender's time that samples take, of which so many are sent, shape (S,)."""
        acknacks = np.minimum(sent_hz, self.acknack_most_hz)
        return np.asarray(self.data_s @ sent_hz + self.acknack_s @ acknacks)

    def sent_hz(self, rates_hz: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return how many samples a second travel, shape (n,).

        All, or where a cache lets only changes pass, r (1 - exp(-1 / (r t))): readings that find a new value.
        """
        cached = np.isfinite(self.change_most_hz)
        new = -np.expm1(-np.where(cached, self.change_most_hz, 1.0) / rates_hz)
        return np.where(cached, rates_hz * new, rates_hz)


def link_of(topics: Sequence[Topic], medium: Medium, vendor: Vendor) -> Link:
    """Return what topics cost on a medium with a vendor's timing.

    On a shared medium every further host that contends stretches each frame (`Medium.contention`). Capacity is
    reckoned with all hosts contending, as they do when the medium is nearly full, which is when it decides.

    Args:
        topics: The topics.
        medium: What carries them.
        vendor: Timing of the reliability protocol.
    """
    hosts = sorted({t.source for t in topics} | {t.target for t in topics if t.reliable})
    senders = ("the medium",) if medium.shared else tuple(hosts)
    contention = medium.contention * (len(hosts) - 1) if medium.shared else 0.0
    data_s, acknack_s = _frames_s(topics, medium, senders)
    way_s = data_s.sum(axis=0) + medium.latency_s
    acknack_way_s = _air_s(medium, ACKNACK_BYTES) + medium.latency_s
    reliable = np.array([t.reliable for t in topics])
    change_most_hz = np.array([1 / t.change_s if t.cached else np.inf for t in topics])
    most_hz = np.minimum([t.rate_max_hz for t in topics], change_most_hz)
    period_s, spacing_s = vendor.heartbeat_ns / 1e9, _spacing_s(vendor)
    rides = ((spacing_s < period_s) & (most_hz * period_s > 1)).astype(float)
    return Link(
        senders=senders,
        sender=data_s.argmax(axis=0),
        data_s=data_s * (1 + contention) * np.where(reliable, 1 / (1 - medium.loss), 1.0),
        acknack_s=acknack_s * (1 + contention),
        acknack_most_hz=_acknack_most_hz(vendor, spacing_s),
        change_most_hz=change_most_hz,
        frame_s=_mean_frame_s(data_s, acknack_s),
        contention=contention,
        way_s=way_s,
        round_s=_answer_s(vendor) + acknack_way_s + way_s,
        rides=rides,
        heartbeat_s=np.where(rides > 0, spacing_s, period_s),
        loss=medium.loss,
        reliable=reliable,
    )


def queue_wait_s(utilisation: Any, link: Link, *, inverse: Callable[[Any], Any]) -> Any:
    """Return the mean time that contention and the queue add to each frame, of every sender, shape (S,).

    Frames of one length at random times wait s u / (2 (1 - u)) (M/D/1). Contention makes them longer the busier
    the medium is, s = f (1 + k u), and so the frame itself: f [(1 + k) (1 / (1 - u) - 1) + k u] / 2 in all.

    Args:
        utilisation: Share of each sender's time, u, below 1.
        link: Gives f, the time of a frame that nobody contends with, and k.
        inverse: 1 / x for positive x, of the kind of `utilisation`.
    """
    k = link.contention
    shares = (1 + k) * (inverse(1 - utilisation) - 1) + k * utilisation
    return _times(0.5 * link.frame_s, shares)


def repair_delay_s(
    link: Link, sent_hz: Any, *, inverse: Callable[[Any], Any], larger: Callable[[Any, Any], Any]
) -> Any:
    """Return by how much losses hold up a topic's samples on average, shape (n,); convex in the rates.

    A lost sample holds up all that follow it until it is repaired, T later: p (T / 2 + r T^2 / 2) a sample. One
    round takes w + c, where w = max(1 / r, h) is the wait for the heartbeat that rides with a later sample
    (w = h where heartbeats come alone) and c the reader's and writer's delays; a round fails with probability
    f, so T is geometric in rounds.

    Args:
        link: The link.
        sent_hz: Samples a second that travel, r, shape (n,).
        inverse: 1 / x for positive x, of the kind of `sent_hz`.
        larger: The larger of two, of the same kind.
    """
    h, c, q = link.heartbeat_s, link.round_s, 1 - link.round_failure
    period = _times(link.rides, inverse(sent_hz))
    wait = larger(period, h)
    # r (w + c)^2, written out so that each term is seen to be convex: r w^2 = max(1 / r, h^2 r).
    r_squares = larger(period, _times(h**2, sent_hz)) + _times(2 * c, larger(link.rides, _times(h, sent_hz)))
    r_squares = r_squares + _times(c**2, sent_hz)
    share = link.loss * link.reliable
    return _times(share / (2 * q), wait + c) + _times(share * (2 - q) / (2 * q**2), r_squares)


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
        data_s[there, i] = _air_s(medium, data_bytes(topic.size_bytes, with_heartbeat=topic.reliable))
        if topic.reliable:
            back = 0 if medium.shared else senders.index(topic.target)
            acknack_s[back, i] = _air_s(medium, ACKNACK_BYTES)
    return data_s, acknack_s


def _air_s(medium: Medium, size_bytes: int) -> float:
    return medium.overhead_s + size_bytes * 8 / medium.rate_bps


def _acknack_most_hz(vendor: Vendor, spacing_s: float) -> float:
    if vendor.prompt:
        return 1e9 / vendor.final_within_ns  # more often, nothing is asked for but what was lost
    return 1 / max(vendor.ack_delay_ns / 1e9, spacing_s, 1e-9)


def _answer_s(vendor: Vendor) -> float:
    """Return what a repair costs beside its way: a prompt reader waits only before it asks a second time."""
    delay_ns = 0 if vendor.prompt else vendor.nack_delay_ns
    return (delay_ns + vendor.nack_response_ns) / 1e9


def _spacing_s(vendor: Vendor) -> float:
    if vendor.prompt:
        return 0.0
    if vendor.piggyback_when_full:
        return 0.0  # the planned depth is small, so the history is full after a moment
    return (vendor.piggyback_after_ns if vendor.piggyback_after_ns >= 0 else vendor.heartbeat_ns) / 1e9


def _mean_frame_s(data_s: NDArray[np.float64], acknack_s: NDArray[np.float64]) -> NDArray[np.float64]:
    frames = np.concatenate([data_s, acknack_s], axis=1)
    return np.asarray(frames.sum(axis=1) / np.maximum((frames > 0).sum(axis=1), 1))


def rounds_needed(link: Link, residual_loss: float) -> int:
    """Return how many repairs a sample must be able to wait for: p f^k <= residual loss, at least one."""
    if link.loss <= residual_loss:
        return 1
    return max(1, math.ceil(math.log(residual_loss / link.loss) / math.log(link.round_failure)))

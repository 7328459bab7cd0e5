"""The module `session` runs a scenario at once, or in steps beside nodes that set values and receive deliveries.

A run is a *simulation* with a virtual clock and a seed; the engine (`engine`) is compiled. Flows have names and values
have numbers. Equal numbers are equal values to the local cache and to cache control. A trace contains every frame that
was on air. The name of a frame does not depend on the losses of other frames. A caller may wish that a frame is lost
or passes.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import InvalidValueError
from sfglab.rtps.model import (
    Flow,
    Scenario,
    compile_scenario,
    end_ns,
)
from sfglab.rtps.state import BITMAP, SET, Count, Fate, Frame
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from numpy.typing import NDArray

    from sfglab.rtps.state import State

_TRACE_FRAMES = 1024


@dataclass(frozen=True, slots=True, kw_only=True)
class FlowOutcome:
    """A `FlowOutcome` has one flow's samples, in the order of their sequence numbers."""

    published_ns: NDArray[np.int64]  #: Time of each sample's publication, ns, shape (n,).
    #: Time when the application had processed a sample, ns, 0 for other samples, shape (n,).
    received_ns: NDArray[np.int64]
    value: NDArray[np.int32]  #: Number of the value that a sample carries, shape (n,).
    fate: NDArray[np.int8]  #: Delivery outcome of each sample, a `Fate`, shape (n,).

    @property
    def delivered(self) -> NDArray[np.bool_]:
        """Whether the application received each sample, shape (n,)."""
        return np.equal(self.fate, Fate.DELIVERED)

    @property
    def loss(self) -> float:
        """Share of samples that the application never received; NaN without samples."""
        return float(1 - self.delivered.mean()) if len(self.fate) else float("nan")

    @property
    def latency_ns(self) -> NDArray[np.int64]:
        """Time from publication to the application for the delivered samples, ns, shape (delivered,)."""
        return (self.received_ns - self.published_ns)[self.delivered]


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """An `Outcome` is the outcome of a whole run."""

    flows: dict[str, FlowOutcome]  #: Outcome of each flow, by the flow's name.
    #: Counters of the protocol and the medium, by the names of `Count` in lower case.
    counts: dict[str, int]


def outcome_of(flows: Sequence[Flow], state: State) -> Outcome:
    """Return the outcome of a run from the flows and the state of the engine."""
    results = {}
    for i, flow in enumerate(flows):
        samples = slice(1, int(state.writer[i].last) + 1)
        results[flow.name] = FlowOutcome(
            published_ns=state.published_ns[i, samples],
            received_ns=state.received_ns[i, samples],
            value=state.value[i, samples],
            fate=state.fate[i, samples],
        )
    return Outcome(flows=results, counts={c.name.lower(): int(state.counts[c]) for c in Count})


def run(scenario: Scenario, *, seed: int) -> Outcome:
    """Simulate a scenario to its end and return the outcome.

    The same seed gives the same losses, values and outcome to the bit.
    """
    return outcome_of(scenario.flows, _state_at_end(scenario, seed, 0, {}))


def _state_at_end(scenario: Scenario, seed: int, room: int, wishes: Mapping[int, bool]) -> State:
    """Return the state after a run with room for a number of traced frames; some frames have a wish."""
    from sfglab.rtps.engine import advance
    from sfglab.rtps.world import World

    params, state = compile_scenario(scenario, seed=seed, trace=room)
    for number, is_lost in wishes.items():
        state.trace["wish"][number] = 1 if is_lost else 2
    advance(World(params, state), end_ns(scenario))
    return state


# --- In steps ----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Delivery:
    """A `Delivery` is a sample that the application receives."""

    flow: str  #: Name of the flow.
    value: int  #: Number of the sample's value.


class Session:
    """A `Session` is a run in steps.

    Args:
        scenario: Scenario with flows whose values only the caller changes.
        seed: Seed of losses; the same seed and the same calls give the same run to the bit.
    """

    def __init__(self, scenario: Scenario, *, seed: int) -> None:
        from sfglab.rtps.world import World

        self._flows = scenario.flows
        self._numbers = {flow.name: number for number, flow in enumerate(scenario.flows)}
        params, self._state = compile_scenario(scenario, seed=seed)
        followed = {flow.then for flow in scenario.flows}
        for name, number in self._numbers.items():
            if name not in followed:
                params.flows["change_ns"][number] = SET
        self._state.delivery["watched"] = 1
        self._world = World(params, self._state)
        self.now_ns = 0  #: Time that the run has reached, ns.

    def set_value(self, flow: str, value: int) -> None:
        """Set the number of the value, from 0, that a flow with a rate publishes from now on."""
        self._state.writer["value"][self._numbers[flow]] = value

    def advance(self, until_ns: int) -> Delivery | None:
        """Run to the next delivery of a new value and return the delivery; `now_ns` is then its time.

        A value is new if it differs from that of the flow's delivery before. Without such a delivery the run
        reaches `until_ns`, in nanoseconds, and the method returns None.
        """
        from sfglab.rtps.engine import advance

        reached_ns = int(advance(self._world, until_ns))
        if reached_ns < 0:
            self.now_ns = until_ns
            return None
        self.now_ns = reached_ns
        flow, sample = self._state.delivery["flow"], self._state.delivery["sample"]
        value = int(self._state.value[flow, sample])
        return Delivery(flow=self._flows[flow].name, value=value)

    def outcome(self) -> Outcome:
        """Return the present outcome of every sample."""
        return outcome_of(self._flows, self._state)


# --- With a trace ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class AirFrame:
    """An `AirFrame` is one frame on air."""

    #: Flow, kind and number, such as ``a/HEARTBEAT/2``. The number of DATA is the sample, followed by the number of
    #: the retransmission: ``a/DATA/7.1``.
    name: str
    kind: Frame  #: Kind of the frame.
    began_ns: int  #: Time when the frame went on air, ns.
    ended_ns: int  #: Time when the frame left the air, ns.
    lost: bool  #: Whether the medium lost the frame when it left the air.
    #: Samples that the frame carries, requests or declares to be gone, counted from 1.
    samples: tuple[int, ...]
    #: Newest sample that the heartbeat announces or the ACKNACK acknowledges; 0 for other frames.
    newest: int
    repairs: bool  #: Whether the frame's samples were on air before.


def trace(
    scenario: Scenario, *, seed: int, lost: Mapping[str, bool] | None = None
) -> tuple[Outcome, tuple[AirFrame, ...]]:
    """Simulate as `run` does, with chosen losses, and return the outcome and every frame that left the air.

    Args:
        scenario: Flows, medium, vendor and times.
        seed: Seed of all losses that are not chosen.
        lost: Whether a frame is lost, by the frame's name (`AirFrame.name`). Losses determine which frames occur;
            names of frames that do not occur have no effect.

    Raises:
        InvalidValueError: A name has another form, or names another flow or kind.
    """
    wanted = lost or {}
    kinds = [f"{flow.name}/{kind.name}" for flow in scenario.flows for kind in Frame]
    for name in wanted:
        if name.rpartition("/")[0] not in kinds:
            allowed = f"a number after one of {'/, '.join(kinds)}/"
            raise InvalidValueError("trace: lost", name, allowed)
    wishes: dict[int, bool] = {}
    # A wish changes all later frames, so the code grants one wish after the other, the earliest frame first.
    while True:
        state = _traced_state(scenario, seed, wishes)
        frames = tuple(_frames(state, [flow.name for flow in scenario.flows]))
        ungranted = [i for i, f in enumerate(frames) if wanted.get(f.name, f.lost) != f.lost]
        if not ungranted:
            return outcome_of(scenario.flows, state), frames
        wishes[ungranted[0]] = not frames[ungranted[0]].lost


def _traced_state(scenario: Scenario, seed: int, wishes: Mapping[int, bool]) -> State:
    """Return the state after a run with a trace of all frames."""
    room = _TRACE_FRAMES
    while True:
        state = _state_at_end(scenario, seed, room, wishes)
        if state.trace_end[0] < room:
            return state
        room *= 8


def _frames(state: State, flows: Sequence[str]) -> Iterator[AirFrame]:
    before: Counter[str] = Counter()
    for number in range(state.trace_end[0]):
        row, frame = state.trace[number], state.traced[number]
        kind = Frame(frame.kind)
        name = f"{flows[frame.flow]}/{kind.name}"
        if kind is Frame.DATA:
            name = f"{name}/{frame.sample}"
        earlier = before[name]
        before[name] += 1
        if kind is not Frame.DATA:
            full_name = f"{name}/{earlier + 1}"
        else:
            full_name = f"{name}.{earlier}" if earlier else name
        yield AirFrame(
            name=full_name,
            kind=kind,
            began_ns=int(row.began_ns),
            ended_ns=int(row.ended_ns),
            lost=bool(row.lost),
            samples=_samples(kind, frame),
            newest=_newest(kind, frame),
            repairs=kind is Frame.BURST or (kind is Frame.DATA and earlier > 0),
        )


def _samples(kind: Frame, frame: Any) -> tuple[int, ...]:
    first = int(frame.sample)
    if kind is Frame.FRAGMENT:
        return ()
    if kind in {Frame.ACKNACK, Frame.BURST}:
        words = frame.bits.tolist()
        places = [i for i in range(BITMAP) if words[i // 64] >> i % 64 & 1]
        return tuple(first + i for i in places)
    return tuple(range(first, first + int(frame.samples)))


def _newest(kind: Frame, frame: Any) -> int:
    if kind is Frame.ACKNACK:
        return int(frame.sample) - 1
    return int(frame.newest) if frame.heartbeats else 0


# --- Age of information ------------------------------------------------------------------------


def age_ms(outcome: FlowOutcome, *, duration_s: float) -> float:
    """Return the age of information at a reader, as the mean over the time of publishing, milliseconds.

    The age is the time since the publication of the newest sample that the reader has. Before the first sample the age
    is the time since the start (S. Kaul, R. Yates and M. Gruteser, Real-time status: How often should one update?,
    INFOCOM 2012).
    """
    received_s = outcome.received_ns[outcome.delivered] / NS_PER_S
    published_s = outcome.published_ns[outcome.delivered] / NS_PER_S
    order = np.argsort(received_s, kind="stable")
    newest_s = np.maximum.accumulate(published_s[order])
    times = np.concatenate(([0.0], np.minimum(received_s[order], duration_s), [duration_s]))
    since = np.concatenate(([0.0], newest_s))
    area = ((times[1:] - since) ** 2 - (times[:-1] - since) ** 2).sum() / 2
    return float(1e3 * area / duration_s)

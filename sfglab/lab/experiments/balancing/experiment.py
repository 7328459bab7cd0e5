"""The caches on the readings of all seven sensors, and what a lost change does.

The caches are those of live nodes, and exact. A lost change is simulated: each change is sent once, over a link
with losses, best effort and reliable, with several longest silences.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from sfglab.arp.cache import CacheControl, Decision, LocalCache
from sfglab.arp.robots import RATES_HZ, SENSORS, Rate, Sensor, cdr_bytes, object_bytes
from sfglab.fields import Bounds, between
from sfglab.lab.checks import Case, CheckRow, check_row
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled, seeded
from sfglab.qos import QoSProfile, Reliability
from sfglab.rtps import FAST_DDS, Flow, FlowOutcome, Medium, Scenario, Session, run
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from numpy.typing import NDArray

    from sfglab.lab.bench import Bench


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    #: How long each sensor is read, seconds.
    readings_s: float = between(60.0, 1.0, 3600.0, log=True)
    rates_hz: tuple[Rate, ...] = RATES_HZ  #: At which rates it is read.
    #: How long each link with losses is simulated, seconds.
    stale_s: float = between(600.0, 1.0, 3600.0)
    stale_seeds: int = 20  #: With how many seeds.
    #: Longest silences of the local cache, seconds; 0: none, as in the paper.
    silences_s: tuple[float, ...] = (0.0, 5.0, 2.0, 1.0, 0.5, 0.2, 0.1)
    loss: float = between(0.2, 0.0, 0.9)  #: Share of frames that these links lose.
    #: Values of T_avg, as topics of one agent, for which Eq. 6 is solved.
    topics: tuple[tuple[int, ...], ...] = (
        (6, 5, 5),
        (7, 6, 6),
        (8, 5, 5),
        (8, 6, 6),
        (9, 9, 9),
        (10,),
    )
    #: Values of Rmin for which it is solved; the paper states none.
    rates_min_hz: tuple[Annotated[float, Bounds(0.1, 100.0, log=True)], ...] = (0.5, 1.0, 10.0)
    #: Values of Dmin for which it is solved; nor of this.
    depths_min: tuple[float, ...] = (1.0, 10.0, 100.0)
    #: Topics that our own problem is solved for, in the data folder.
    topic_file: str = "qos/paper_b.yaml"
    weights: int = between(25, 2, 100)  #: Points of the Pareto front of our own problem.
    seed: int = 0  #: Seed of everything that is drawn.


exp = Experiment(
    "balancing",
    Config,
    where="B 2.2 to 2.4",
    smoke={
        "readings_s": 2.0,
        "rates_hz": (100, 1000),
        "stale_s": 20.0,
        "stale_seeds": 2,
        "silences_s": (0.0, 0.5),
        "topics": ((7, 6, 6), (10,)),
        "weights": 5,
    },
    paper={"readings_s": 600.0, "stale_s": 3600.0, "stale_seeds": 50},
    actors=(
        Actor("sensor", host="robot", does="one of Table 1's seven, simulated"),
        Actor(
            "local cache",
            host="robot",
            does="lets changes pass, and after the longest silence a repeat",
        ),
        Actor("cache control", host="station", does="lets planning have changes only"),
        Actor("planning", host="station", does="works with the last value"),
    ),
    links=(
        Link("sensor", "local cache", "every reading", over="a call"),
        Link(
            "local cache",
            "cache control",
            "changes",
            over="the RTPS model",
            boundary="a lossy link",
        ),
        Link("cache control", "planning", "changes", over="a call"),
    ),
)
exp.table("check")(CheckRow)


# --- Table 1 --------------------------------------------------------------------------------------------------


@exp.table("table_one")
class TableOneRow:
    """One sensor of Table 1 beside the message that every run sends for it."""

    sensor: str  #: Its name.
    type: str  #: ROS type of its message.
    table_bytes: int  #: Size in the paper.
    object_bytes: int  #: Size of the value as a Python object.
    cdr_bytes: int  #: Size of the message on the wire.
    change_s: float  #: Mean time between changes of its value, seconds.


@exp.part("Table 1", timed=False)
def compare_sizes(bench: Bench[Config]) -> None:
    """Write Table 1 beside what is sent."""
    for sensor in SENSORS.values():
        declared = {name: getattr(sensor, name) for name in ("type", "table_bytes", "change_s")}
        sizes = {"object_bytes": object_bytes(sensor), "cdr_bytes": cdr_bytes(sensor)}
        bench.write("table_one", {"sensor": sensor.name, **declared, **sizes})


# --- What sensors say -----------------------------------------------------------------------------------------

_STATES: dict[str, tuple[Any, Any]] = {
    "flame": (False, True),
    "pir": ("not detect", "detect"),
    "light": ("light", "dark"),
}
_GRAIN = {"lidar": 0.001, "dht11": 1.0, "imu": 1 / 16384, "ultrasonic": 0.003}
"""Smallest steps, in metres, degrees and g: data sheets of A2M8, DHT11, MPU-6050 (16384 a g) and HC-SR04."""


def readings(
    sensor: Sensor, *, rate_hz: float, duration_s: float, rng: np.random.Generator
) -> list[Any]:
    """Return what reading a sensor at a rate gives in a time, in order, while objects move around it.

    The times between changes are exponential with Table 1's mean; what a value changes to is in the sensor's
    own grain, as a DHT11 gives whole degrees.
    """
    count = int(rate_hz * duration_s)
    changes = np.cumsum(
        rng.exponential(sensor.change_s, int(3 * duration_s / sensor.change_s) + 10)
    )
    number = np.searchsorted(changes, np.arange(count) / rate_hz, side="right")
    if sensor.name in _STATES:
        return [_STATES[sensor.name][n % 2] for n in number]
    steps = np.cumsum(rng.integers(1, 4, len(changes) + 1) * rng.choice((-1, 1), len(changes) + 1))
    return [float(np.float32(sensor.example + steps[n] * _GRAIN[sensor.name])) for n in number]


RECORDED = tuple(replace(SENSORS[n], name=f"recorded {n}", change_s=0.0) for n in ("lidar", "pir"))
"""Sensors that say what was recorded, in place of what is drawn, in messages of Table 1."""


def recorded(sensor: Sensor) -> list[Any]:
    """Return recorded readings: ``membrane.dat``, an electrode's 12,000 samples that come with matplotlib.

    Two in five repeat the one before: its converter has few steps. Texts say whether it is above the mean.
    """
    from matplotlib.cbook import get_sample_data

    samples = np.fromfile(get_sample_data("membrane.dat", asfileobj=False), np.float32)
    if isinstance(sensor.example, str):
        return [_STATES["pir"][int(high)] for high in samples > samples.mean()]
    return [float(sample) for sample in samples]


# --- The caches -----------------------------------------------------------------------------------------------

SILENCE_S = 1.0


@exp.table("cache", "recorded")
@dataclass(frozen=True, slots=True, kw_only=True)
class CacheRow:
    """What local cache and cache control did with one sensor's readings, drawn (``cache``) or recorded."""

    sensor: str  #: The sensor.
    rate_hz: int  #: At which it was read.
    silence_s: float  #: Longest silence of the local cache, seconds; 0: none.
    offered: int  #: Readings.
    sent: int  #: Readings that the local cache let pass.
    refreshed: int  #: Those among them that passed because of the silence.
    held_bytes: int  #: Bytes on the wire that were not sent.
    #: Of all readings, sent without a local cache, those that cache control let through to planning.
    planned: int
    planned_after: int  #: The same with a local cache before it.
    #: Mean time that somebody who joins at any time waits for the first value, seconds.
    join_wait_s: float


@dataclass(slots=True, kw_only=True)
class Passage:
    """What became of a sensor's readings."""

    values: list[Any]  #: The readings.
    size_bytes: int  #: Size of one message.
    #: For each, whether the local cache let it pass.
    sent: list[bool] = field(default_factory=list)
    #: For each, whether cache control let it pass, all readings being sent.
    planned: list[bool] = field(default_factory=list)
    planned_after: list[bool] = field(default_factory=list)  #: For each, whether it passed both.
    #: What planning works with after each reading, both caches in use.
    known: list[Any] = field(default_factory=list)
    refreshed: int = 0  #: How many passed because of the silence.
    held_bytes: int = 0  #: What the local cache says it saved.


@exp.part("caches", total=len(SENSORS) + len(RECORDED), timed=False)
def run_caches(bench: Bench[Config]) -> None:
    """Run every sensor at every rate, without and with a longest silence, and check on the way."""
    bench.write_all("check", cache_checks(bench.config, bench.write, bench.advance))


def cache_checks(
    config: Config,
    write: Callable[[str, Any], None] = lambda *_: None,
    advance: Callable[[str], None] = lambda _: None,
) -> Iterator[CheckRow]:
    """Yield how often each property of the caches held; rows of what passed are written on the way."""
    cases: dict[str, list[Case]] = {}
    least_hz = min(config.rates_hz)
    for table, sensor, rate_hz, values in _what_is_read(config):
        checked: list[tuple[str, object]] = []
        for silence_s in (0.0, SILENCE_S):
            passage = pass_through(sensor, values, rate_hz=rate_hz, silence_s=silence_s)
            write(table, _cache_row(sensor, passage, rate_hz, silence_s))
            checked += _checks(passage, rate_hz, silence_s)
        checked.append(_check_compiled(passage, rate_hz))
        if rate_hz == least_hz:
            checked += _check_lossy(values, rate_hz, config.loss)
            advance(sensor.name)
        for check, held in checked:
            cases.setdefault(check, []).append((f"{sensor.name} at {rate_hz} Hz", bool(held)))
    yield from (check_row(check, tried) for check, tried in cases.items())


def _what_is_read(config: Config) -> Iterator[tuple[str, Sensor, int, list[Any]]]:
    """Yield table, sensor, rate and readings: each sensor at every rate, the recorded ones at the lowest."""
    rng = np.random.default_rng(config.seed)
    for sensor in SENSORS.values():
        for rate_hz in config.rates_hz:
            values = readings(sensor, rate_hz=rate_hz, duration_s=config.readings_s, rng=rng)
            yield "cache", sensor, rate_hz, values
    rate_hz = min(config.rates_hz)
    for sensor in RECORDED:
        yield "recorded", sensor, rate_hz, recorded(sensor)[: int(rate_hz * config.readings_s)]


def pass_through(sensor: Sensor, values: list[Any], *, rate_hz: float, silence_s: float) -> Passage:
    """Offer readings to the caches, and note what passes; a longest silence of 0: none."""
    silence_ns = round(silence_s * NS_PER_S) or None
    local, control, after = LocalCache(max_silence_ns=silence_ns), CacheControl(), CacheControl()
    passage = Passage(values=values, size_bytes=cdr_bytes(sensor))
    for number, value in enumerate(values):
        now_ns = round(number / rate_hz * NS_PER_S)
        sent = local.offer(sensor.name, value, now_ns=now_ns, size_bytes=passage.size_bytes).passes
        passage.sent.append(sent)
        passage.planned.append(control.offer(sensor.name, value, now_ns=now_ns).passes)
        is_new = sent and after.offer(sensor.name, value, now_ns=now_ns) is Decision.CHANGED
        passage.planned_after.append(is_new)
        passage.known.append(after.current(sensor.name))
    passage.refreshed, passage.held_bytes = local.counters.refreshed, local.counters.held_bytes
    return passage


def _checks(passage: Passage, rate_hz: float, silence_s: float) -> Iterator[tuple[str, object]]:
    """Yield properties and whether the passage has them."""
    values = passage.values
    changed = [True, *(b != a for a, b in pairwise(values))]
    if silence_s == 0:
        yield (
            "LC: what passes is the first value and every change, nothing else",
            passage.sent == changed,
        )
    else:
        # A reading later than the silence at most.
        gaps = np.diff([*np.flatnonzero(passage.sent), len(values)])
        yield (
            "LC: no silence is longer than allowed",
            gaps.max() <= np.ceil(silence_s * rate_hz) + 1,
        )
        at_once = all(s for s, c in zip(passage.sent, changed, strict=True) if c)
        yield "LC: with a longest silence every change still passes at once", at_once
    held_bytes = passage.sent.count(False) * passage.size_bytes
    yield "LC: the station always knows the sensor's value", passage.known == values
    yield "LC: the counters say what was held", passage.held_bytes == held_bytes
    yield (
        "CC: planning gets the first value and every change, nothing else",
        passage.planned == changed,
    )
    yield "CC: after a local cache planning gets the same", passage.planned_after == changed


def _check_compiled(passage: Passage, rate_hz: float) -> tuple[str, bool]:
    """Give the same readings to the model's compiled local cache, on a link without losses."""
    found = _played(passage.values, rate_hz, loss=0.0, cached=True, silence_s=SILENCE_S)
    # When the model published, as numbers of readings.
    passed = np.rint(found.published_ns * rate_hz / NS_PER_S).astype(int)
    same = passed.tolist() == np.flatnonzero(passage.sent).tolist()
    return "LC: the model's compiled cache lets the same readings pass", same


def _check_lossy(values: list[Any], rate_hz: float, loss: float) -> Iterator[tuple[str, bool]]:
    """Yield properties of the caches on a link that loses messages and repairs what is still in its history."""
    numbered = [value for i, value in enumerate(values) if i == 0 or value != values[i - 1]]
    for cache, cached in (("LC", True), ("CC", False)):
        found = _played(values, rate_hz, loss=loss, cached=cached)
        arrived = [numbered[n - 1] for n in found.value[found.delivered]]
        control = CacheControl()
        planned = [control.offer("a", value, now_ns=0).passes for value in arrived]
        changed = [i == 0 or value != arrived[i - 1] for i, value in enumerate(arrived)]
        said = f"{cache}: of what comes through losses planning gets the first and every change"
        yield said, planned == changed
        yield (
            f"{cache}: after losses planning ends with the sensor's value",
            control.current("a") == values[-1],
        )


def _played(
    values: list[Any], rate_hz: float, *, loss: float, cached: bool, silence_s: float | None = None
) -> FlowOutcome:
    """Return what the model's reliable link makes of readings; its values are numbers of changes, from 1."""
    caching: dict[str, Any] = {"cached": cached, "max_silence_s": silence_s}
    flow = Flow(name="a", source="robot", target="station", rate_hz=rate_hz, **caching)
    scenario = Scenario(flows=(flow,), medium=Medium(loss=loss), duration_s=len(values) / rate_hz)
    session = Session(scenario, seed=0, watched=())
    number, last = 0, object()
    period_ns = round(NS_PER_S / rate_hz)
    for i, value in enumerate(values):
        number, last = number + (value != last), value
        session.set_value("a", number)
        session.advance((i + 1) * period_ns)
    session.advance((len(values) + 1) * period_ns + (10 * NS_PER_S if loss else 0))
    return session.outcome().flows["a"]


def _cache_row(sensor: Sensor, passage: Passage, rate_hz: int, silence_s: float) -> CacheRow:
    gaps = np.diff([*np.flatnonzero(passage.sent), len(passage.sent)]) / rate_hz
    return CacheRow(
        sensor=sensor.name,
        rate_hz=rate_hz,
        silence_s=silence_s,
        offered=len(passage.values),
        sent=sum(passage.sent),
        refreshed=passage.refreshed,
        held_bytes=passage.held_bytes,
        planned=sum(passage.planned),
        planned_after=sum(passage.planned_after),
        # The end counts as a value that passes, so this is a lower bound.
        join_wait_s=float((gaps**2).sum() / (2 * gaps.sum())),
    )


# --- A lost change --------------------------------------------------------------------------------------------

STALE_SENSOR = "pir"
STALE_RATE_HZ = 100.0
QOS = {
    "best effort": QoSProfile(reliability=Reliability.BEST_EFFORT, depth=1),
    "reliable": QoSProfile(depth=1),
}
_SHOWN_S = 40.0


@exp.table("stale")
class StaleRow:
    """How long the station worked with a value that was no longer true, over a link with losses, simulated."""

    qos: str  #: ``best effort`` or ``reliable``.
    silence_s: float  #: Longest silence of the local cache, seconds; 0: none.
    seed: int  #: The seed.
    messages_hz: float  #: Messages a second.
    stale_share: float  #: Share of the time that the station's value was not the sensor's.
    longest_s: float  #: The longest such time, seconds.


@exp.table("shown")
class ShownRow:
    """A change of the sensor's value, or of the value that the station works with, in one example."""

    qos: str  #: As in `StaleRow`.
    silence_s: float  #: As in `StaleRow`.
    where: str  #: ``sensor`` or ``station``.
    t_s: float  #: When, seconds.
    value: int  #: Number of the value from then on.


@exp.part("lost changes", timed=False)
def lose_changes(bench: Bench[Config]) -> None:
    """Simulate every QoS with every longest silence; keep the courses of the examples with the first seed."""
    config = bench.config
    for qos in QOS:
        for silence_s in config.silences_s:
            for seed in seeded(config, config.stale_seeds):
                case = {"qos": qos, "silence_s": silence_s}
                flow = _simulate(qos, silence_s, config, seed)
                bench.write("stale", {**case, "seed": seed, **staleness_of(flow, config.stale_s)})
                if seed == config.seed and (qos, silence_s) in shown_of(config):
                    bench.write_all("shown", ({**case, **step} for step in _course(flow)))


def shown_of(config: Config) -> tuple[tuple[str, float], ...]:
    """Return the examples whose course is kept: QoS and longest silence, seconds."""
    some_s = 0.5 if 0.5 in config.silences_s else max(config.silences_s, default=0.0)
    return ("best effort", 0.0), ("reliable", 0.0), ("best effort", some_s)


def _simulate(qos: str, silence_s: float, config: Config, seed: int) -> FlowOutcome:
    flow = Flow(
        name=STALE_SENSOR,
        source="robot",
        target="station",
        size_bytes=SENSORS[STALE_SENSOR].table_bytes,
        rate_hz=STALE_RATE_HZ,
        qos=QOS[qos],
        change_s=SENSORS[STALE_SENSOR].change_s,
        cached=True,
        max_silence_s=silence_s or None,
    )
    medium = Medium(loss=config.loss)
    scenario = Scenario(
        flows=(flow,), medium=medium, vendor=FAST_DDS, duration_s=config.stale_s, drain_s=0.0
    )
    return run(scenario, seed=seed).flows[STALE_SENSOR]


def _steps(flow: FlowOutcome) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return times of all steps, and from each on the sensor's value and the station's; -1 before the first."""
    times = np.unique(np.concatenate([flow.published_ns, flow.received_ns[flow.delivered]]))
    true = flow.value[np.searchsorted(flow.published_ns, times, side="right") - 1]
    order = np.searchsorted(flow.received_ns[flow.delivered], times, side="right") - 1
    known = np.where(order >= 0, flow.value[flow.delivered][order], -1)
    return times, true.astype(np.int64), known.astype(np.int64)


def staleness_of(flow: FlowOutcome, duration_s: float) -> dict[str, float]:
    """Return how long the station's value was not the sensor's, as columns of `StaleRow`."""
    times, true, known = _steps(flow)
    lasts_s = np.diff([*times, duration_s * NS_PER_S]) / NS_PER_S
    stale = true != known
    # A stretch goes on over steps; it ends where the station knows again.
    starts = np.flatnonzero(stale & ~np.concatenate([[False], stale[:-1]]))
    lengths = np.add.reduceat(lasts_s * stale, starts) if len(starts) else np.zeros(1)
    return {
        "messages_hz": len(flow.fate) / duration_s,
        "stale_share": float(lasts_s[stale].sum() / duration_s),
        "longest_s": float(lengths.max()),
    }


def _course(flow: FlowOutcome) -> Iterator[dict[str, Any]]:
    """Yield the changes on both sides, as columns of `ShownRow`."""
    times, true, known = _steps(flow)
    for where, values in (("sensor", true), ("station", known)):
        for i in np.flatnonzero(np.diff(values, prepend=-2)):
            if times[i] < _SHOWN_S * NS_PER_S:
                yield {"where": where, "t_s": times[i] / NS_PER_S, "value": int(values[i])}

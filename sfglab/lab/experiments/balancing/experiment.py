"""The module `balancing.experiment` has configuration, tables and parts of the experiment on caches and balanced QoS.

The experiment tests the caches of the live nodes. The caches get random readings of Table 1's sensors, whose values
stay for as long as the values of such sensors do, and recorded readings. The experiment checks each property on every
reading, and on a simulated link that loses frames. The experiment solves the problem of Eq. 6 with CVXPY and with the
closed form.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise, product
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np

from sfglab.arp.balancing import (
    Balance,
    BalanceInput,
    InfeasibleBalanceError,
    average_topics,
    balance,
    balance_closed_form,
)
from sfglab.arp.cache import CacheControl, Decision, LocalCache
from sfglab.arp.robots import RATES_HZ, SENSORS, Rate, Sensor, cdr_bytes, object_bytes
from sfglab.fields import Bounds, between
from sfglab.lab.bench import TableRow
from sfglab.lab.checks import CheckRow
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.rtps import Flow, FlowOutcome, Medium, Scenario, Session
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.lab.bench import Bench

    Held = tuple[str, bool]  # The tuple has a property, and whether the property holds.


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The `Config` has the settings of a run."""

    #: Time for which each sensor is read, s.
    readings_s: float = between(60.0, 1.0, 3600.0)
    rates_hz: tuple[Rate, ...] = RATES_HZ  #: Rates at which each sensor is read, Hz.
    loss: float = between(0.2, 0.0, 0.9)  #: Share of frames that the simulated link loses.
    #: Numbers of topics per agent for which Eq. 6 is solved.
    topics: tuple[tuple[int, ...], ...] = (
        (6, 5, 5),
        (7, 6, 6),
        (8, 5, 5),
        (8, 6, 6),
        (9, 9, 9),
        (10,),
    )
    #: Values of Rmin for which Eq. 6 is solved, Hz. The paper states no value of Rmin.
    rates_min_hz: tuple[Annotated[float, Bounds(0.1, 100.0)], ...] = (0.5, 1.0, 10.0)
    #: Values of Dmin for which Eq. 6 is solved. The paper states no value of Dmin.
    depths_min: tuple[float, ...] = (1.0, 10.0, 100.0)
    #: File in the data folder with the topics and the channel for the rates of Eq. 6.
    topic_file: str = "qos/paper_b.yaml"
    seed: int = 0  #: Seed of the readings.


exp = Experiment(
    "balancing",
    Config,
    where="B 2.2 to 2.4",
    smoke={
        "readings_s": 2.0,
        "rates_hz": (100, 1000),
        "topics": ((7, 6, 6), (10,)),
    },
    paper={"readings_s": 600.0},
    actors=(
        Actor("sensor", "robot", "is read at a rate of up to Rmax"),
        Actor("local cache (LC)", "robot", "suppresses a value equal to the last one it sent"),
        Actor(
            "DataWriter",
            "robot",
            "keeps the last DEPTH samples; balanced QoS (OPT) sets DEPTH and rate",
        ),
        Actor("cache control (CC)", "station", "discards a value equal to the last one"),
        Actor("planning", "station", "works with the last value"),
    ),
    links=(
        Link("sensor", "local cache (LC)", "every reading", "a call"),
        Link("local cache (LC)", "DataWriter", "changes", "a call"),
        Link("DataWriter", "cache control (CC)", "samples", "RTPS", "wireless channel"),
        Link("cache control (CC)", "planning", "changes", "a call"),
    ),
)
exp.table("check")(CheckRow)


# --- Table 1 ----------------------------------------------------------------------------------


@exp.table("table_one")
class TableOneRow(TableRow):
    """A `TableOneRow` is a sensor of Table 1 with the message that every run sends for the sensor."""

    sensor: str  #: Name of the sensor.
    type: str  #: ROS type of the sensor's message.
    table_bytes: int  #: Size of the message in the paper, bytes.
    object_bytes: int  #: Size of the value as a Python object, bytes.
    cdr_bytes: int  #: Size of the message on the wire, bytes.
    change_s: float  #: Mean time between changes of the sensor's value, s.


@exp.part("Table 1", timed=False)
def compare_sizes(bench: Bench[Config]) -> None:
    """Write the rows of Table 1 with the sizes of the sent values and messages."""
    for sensor in SENSORS.values():
        row = TableOneRow(
            sensor=sensor.name,
            type=sensor.type,
            table_bytes=sensor.table_bytes,
            object_bytes=object_bytes(sensor),
            cdr_bytes=cdr_bytes(sensor),
            change_s=sensor.change_s,
        )
        bench.write(row)


# --- Readings ---------------------------------------------------------------------------------

_STATES: dict[str, tuple[Any, Any]] = {
    "flame": (False, True),
    "pir": ("not detect", "detect"),
    "light": ("light", "dark"),
}
_STEPS = {"lidar": 0.001, "dht11": 1.0, "imu": 1 / 16384, "ultrasonic": 0.003}
"""Resolutions in m, degrees and g, from the data sheets of A2M8, DHT11, MPU-6050 (16384 per g) and
HC-SR04."""

ELECTRODE = {"lidar": "electrode (as Float32)", "pir": "electrode (as String)"}
"""Names of the recordings, by the sensor of Table 1 whose message type the recording has."""
RECORDED = tuple(
    replace(SENSORS[sensor], name=name, change_s=0.0) for sensor, name in ELECTRODE.items()
)


def readings(
    sensor: Sensor, *, rate_hz: float, duration_s: float, rng: np.random.Generator
) -> list[Any]:
    """Return random readings of a sensor in order of time.

    Times between changes are exponential with the sensor's mean time. A new value differs from the value before by a
    few steps of the sensor's resolution.
    """
    count = int(rate_hz * duration_s)
    number_of_changes = int(3 * duration_s / sensor.change_s) + 10
    change_times_s = np.cumsum(rng.exponential(sensor.change_s, number_of_changes))
    changes = np.searchsorted(change_times_s, np.arange(count) / rate_hz, side="right")
    if sensor.name in _STATES:
        states = _STATES[sensor.name]
        return [states[n % 2] for n in changes]
    sizes = rng.integers(1, 4, number_of_changes + 1)
    signs = rng.choice((-1, 1), number_of_changes + 1)
    steps = np.cumsum(sizes * signs)
    resolution = _STEPS[sensor.name]
    return [float(np.float32(sensor.example + steps[n] * resolution)) for n in changes]


def recorded_readings(sensor: Sensor) -> list[Any]:
    """Return recorded readings: an electrode's 12,000 samples from matplotlib's ``membrane.dat``.

    Two in five samples equal the sample before, because the converter has few steps. A text says whether a sample is
    above the mean.
    """
    from matplotlib.cbook import get_sample_data

    samples = np.fromfile(get_sample_data("membrane.dat", asfileobj=False), np.float32)
    if isinstance(sensor.example, str):
        states = _STATES["pir"]
        return [states[int(is_high)] for is_high in samples > samples.mean()]
    return [float(sample) for sample in samples]


# --- Caches -----------------------------------------------------------------------------------

SILENCE_S = 1.0  #: Maximum silence of a local cache that has a maximum silence, s.


@exp.table("cache", "recorded")
class CacheRow(TableRow):
    """A `CacheRow` is a sensor's readings that the caches passed: random readings (``cache``) or recorded readings."""

    sensor: str  #: Name of the sensor.
    rate_hz: int  #: Rate at which the sensor was read, Hz.
    #: Maximum silence, after which the local cache sends an equal value, s; 0: no maximum silence.
    silence_s: float
    offered: int  #: Number of readings that the cache got.
    sent: int  #: Number of readings that the local cache passed.
    held_bytes: int  #: Number of bytes that the local cache suppressed, as CDR.
    #: Number of readings that cache control passed to planning if the robot sends all readings.
    planned: int


@dataclass(slots=True, kw_only=True)
class Passage:
    """A `Passage` is a sensor's readings with the decisions of the caches."""

    values: list[Any]  #: Readings in order of time.
    size_bytes: int  #: Size of one message, bytes.
    sent: list[bool] = field(default_factory=list)  #: Whether the local cache passed each reading.
    #: Whether cache control passed each reading without a local cache.
    planned: list[bool] = field(default_factory=list)
    #: Whether each reading passed both caches.
    planned_after: list[bool] = field(default_factory=list)
    #: Value that planning has after each reading, with both caches.
    known: list[Any] = field(default_factory=list)
    held_bytes: int = 0  #: Bytes that the local cache counted as suppressed.


@exp.part("caches", total=len(SENSORS) + len(RECORDED), timed=False)
def run_caches(bench: Bench[Config]) -> None:
    """Pass all readings through the caches, without and with a maximum silence, and check the caches."""
    config = bench.config
    rng = np.random.default_rng(config.seed)
    for sensor in SENSORS.values():
        for rate_hz in config.rates_hz:
            values = readings(sensor, rate_hz=rate_hz, duration_s=config.readings_s, rng=rng)
            _run_cell(bench, "cache", sensor, rate_hz, values)
        bench.advance(sensor.name)
    rate_hz = min(config.rates_hz)
    for sensor in RECORDED:
        values = recorded_readings(sensor)[: int(rate_hz * config.readings_s)]
        _run_cell(bench, "recorded", sensor, rate_hz, values)
        bench.advance(sensor.name)


def _run_cell(
    bench: Bench[Config], table: str, sensor: Sensor, rate_hz: int, values: list[Any]
) -> None:
    """Write the rows of a sensor at one rate, and collect the checks of the rows."""
    checks: list[Held] = []
    for silence_s in (0.0, SILENCE_S):
        passage = pass_through(sensor, values, rate_hz=rate_hz, silence_s=silence_s)
        row = CacheRow(
            sensor=sensor.name,
            rate_hz=rate_hz,
            silence_s=silence_s,
            offered=len(values),
            sent=sum(passage.sent),
            held_bytes=passage.held_bytes,
            planned=sum(passage.planned),
        )
        bench.write(table, row)
        checks += cache_checks(passage, rate_hz, silence_s)
    if rate_hz == min(bench.config.rates_hz):
        checks += _lossy_checks(values, rate_hz, bench.config.loss)
    for check, holds in checks:
        bench.cases[check].append((f"{sensor.name} at {rate_hz} Hz", bool(holds)))


def pass_through(sensor: Sensor, values: list[Any], *, rate_hz: float, silence_s: float) -> Passage:
    """Offer readings to the caches and return the caches' decisions; 0 s means no maximum silence."""
    local = LocalCache(max_silence_ns=round(silence_s * NS_PER_S) or None)
    alone, behind = CacheControl(), CacheControl()
    size_bytes = cdr_bytes(sensor)
    passage = Passage(values=values, size_bytes=size_bytes)
    for number, value in enumerate(values):
        now_ns = round(number / rate_hz * NS_PER_S)
        sent = local.offer(sensor.name, value, now_ns=now_ns, size_bytes=size_bytes).passes
        passage.sent.append(sent)
        passage.planned.append(alone.offer(sensor.name, value, now_ns=now_ns).passes)
        is_new = sent and behind.offer(sensor.name, value, now_ns=now_ns) is Decision.CHANGED
        passage.planned_after.append(is_new)
        passage.known.append(behind.current(sensor.name))
    passage.held_bytes = local.held_bytes
    return passage


def changes_of(values: list[Any]) -> list[bool]:
    """Return for each value whether the value is the first or differs from the value before."""
    return [True, *(after != before for before, after in pairwise(values))]


def cache_checks(passage: Passage, rate_hz: float, silence_s: float) -> Iterator[Held]:
    """Yield the properties of the caches, and whether each property holds for these readings."""
    changed = changes_of(passage.values)
    if silence_s == 0:
        text = "LC: what passes is the first value and every change, nothing else"
        yield text, passage.sent == changed
    else:
        gaps = np.diff([*np.flatnonzero(passage.sent), len(passage.sent)])
        # A silence ends with the first reading after the limit of the silence.
        within = gaps.max() <= np.ceil(silence_s * rate_hz) + 1
        yield "LC: no silence is longer than allowed", bool(within)
        sent_changes = np.array(passage.sent)[changed]
        text = "LC: with a longest silence every change still passes at once"
        yield text, bool(sent_changes.all())
    yield "LC: the station always knows the sensor's value", passage.known == passage.values
    held_bytes = passage.sent.count(False) * passage.size_bytes
    yield "LC: the counters say what was held", passage.held_bytes == held_bytes
    text = "CC: planning gets the first value and every change, nothing else"
    yield text, passage.planned == changed
    yield "CC: after a local cache planning gets the same", passage.planned_after == changed


def _lossy_checks(values: list[Any], rate_hz: float, loss: float) -> Iterator[Held]:
    """Yield the properties of the caches on a reliable link that loses frames."""
    changes = np.flatnonzero(changes_of(values))
    for cache, cached in (("LC", True), ("CC", False)):
        found = _simulated(values, rate_hz, loss=loss, cached=cached)
        arrived = [values[changes[n - 1]] for n in found.value[found.delivered]]
        control = CacheControl()
        planned = [control.offer("a", value, now_ns=0).passes for value in arrived]
        text = f"{cache}: of what comes through losses planning gets the first and every change"
        yield text, planned == changes_of(arrived)
        text = f"{cache}: after losses planning ends with the sensor's value"
        yield text, control.current("a") == values[-1]


_REPAIRS_NS = 10 * NS_PER_S  # The last retransmissions have this time.


def _simulated(values: list[Any], rate_hz: float, *, loss: float, cached: bool) -> FlowOutcome:
    """Return the outcome of readings on the model's reliable link; values are numbers of changes."""
    flow = Flow(name="a", source="robot", target="station", rate_hz=rate_hz, cached=cached)
    duration_s = len(values) / rate_hz
    scenario = Scenario(flows=(flow,), medium=Medium(loss=loss), duration_s=duration_s)
    session = Session(scenario, seed=0)
    period_ns = round(NS_PER_S / rate_hz)
    for place, number in enumerate(np.cumsum(changes_of(values)), 1):
        session.set_value("a", int(number))
        _advance(session, place * period_ns)
    _advance(session, (len(values) + 1) * period_ns + _REPAIRS_NS)
    return session.outcome().flows["a"]


def _advance(session: Session, until_ns: int) -> None:
    """Run to a time, past all deliveries."""
    while session.advance(until_ns) is not None:
        pass


# --- Eq. 6 ------------------------------------------------------------------------------------

WEIGHTS = (0.05, 0.5, 0.95)  #: Weights of R in the objective of Eq. 6.
# The tolerance is relative to the value; the solver stops at 1e-8 of the objective.
_TOLERANCE = 1e-5
_PAPER_DEPTH_MAX = 5000
_NAN = float("nan")


@exp.table("balance")
class BalanceRow(TableRow):
    """A `BalanceRow` is a case of Eq. 6, solved with CVXPY and with the closed form."""

    topics: str  #: Numbers of topics per agent, joined by ``+``.
    rate_max_hz: int  #: Rmax, Hz.
    rate_min_hz: float  #: Rmin, Hz.
    depth_min: float  #: Dmin.
    weight: float  #: Weight of R in the objective.
    solvable: bool  #: Whether CVXPY found an optimum.
    solvable_closed: bool  #: Whether the closed form has an optimum.
    rate_hz: float  #: R by CVXPY, Hz; NaN if CVXPY found no optimum.
    depth: float  #: D by CVXPY; NaN if CVXPY found no optimum.
    rate_closed_hz: float  #: R by the closed form, Hz.
    depth_closed: float  #: D by the closed form.


@exp.part("Eq. 6", timed=False)
def solve_published(bench: Bench[Config]) -> None:
    """Solve each combination of topics, Rmax, Rmin, Dmin and weight with both methods, and compare the results."""
    config = bench.config
    limits = product(config.topics, config.rates_hz, config.rates_min_hz, config.depths_min)
    for (topics, rate_max_hz, rate_min_hz, depth_min), weight in product(limits, WEIGHTS):
        given = BalanceInput(
            topics=topics, rate_max_hz=rate_max_hz, rate_min_hz=rate_min_hz, depth_min=depth_min
        )
        row = balance_row(given, weight)
        bench.write(row)
        for check, holds in balance_checks(row):
            bench.cases[check].append((str(row), holds))


def balance_row(given: BalanceInput, weight: float) -> BalanceRow:
    """Return the row of a solved case of Eq. 6."""
    solved = closed = None
    with suppress(InfeasibleBalanceError):
        closed = balance_closed_form(given)
    with suppress(InfeasibleBalanceError):
        solved = balance(given, weight=weight)
    none = Balance(rate_hz=_NAN, depth=_NAN)
    return BalanceRow(
        topics="+".join(map(str, given.topics)),
        rate_max_hz=int(given.rate_max_hz),
        rate_min_hz=given.rate_min_hz,
        depth_min=given.depth_min,
        weight=weight,
        solvable=solved is not None,
        solvable_closed=closed is not None,
        rate_hz=(solved or none).rate_hz,
        depth=(solved or none).depth,
        rate_closed_hz=(closed or none).rate_hz,
        depth_closed=(closed or none).depth,
    )


def balance_checks(row: BalanceRow) -> Iterator[Held]:
    """Yield the properties of Eq. 1 to 6, and whether each property holds for a case.

    The function checks Eq. 4 and 5 with the paper's numbers, without our functions for Eq. 1 to 6.
    """
    text = "OPT: CVXPY finds an optimum where the closed form does, and nowhere else"
    yield text, row.solvable == row.solvable_closed
    if not row.solvable:
        return
    yield "OPT: R is the closed form's", _is_close(row.rate_hz, row.rate_closed_hz)
    yield "OPT: D is the closed form's", _is_close(row.depth, row.depth_closed)
    within = _in_order(row.rate_min_hz, row.rate_hz, row.rate_max_hz)
    most_hz = row.rate_max_hz / mean_topics(row.topics)
    holds = within and _in_order(row.rate_hz + row.rate_min_hz, most_hz)
    yield "OPT: Eq. 4 holds, and Rmin <= R <= Rmax", holds
    within = _in_order(row.depth_min, row.depth, _PAPER_DEPTH_MAX)
    depth = _PAPER_DEPTH_MAX * row.rate_hz / row.rate_max_hz - row.depth_min
    holds = within and _is_close(depth, row.depth)
    yield "OPT: Eq. 5 holds with nothing to spare, and Dmin <= D <= Dmax", holds


def mean_topics(topics: str) -> float:
    """Return T_avg of Eq. 2 for the topics of a row."""
    return average_topics([int(count) for count in topics.split("+")])


def _is_close(one: float, other: float) -> bool:
    return abs(one - other) <= _TOLERANCE * abs(other)


def _in_order(*values: float) -> bool:
    """Return whether each value is at most the next value, within the solver's tolerance."""
    return all(low <= high + _TOLERANCE * abs(high) for low, high in pairwise(values))

"""The module `phases.experiment` has configuration, conditions and sweeps of the map of paper B's conclusions.

The experiment simulates each condition with all methods and rates that the criteria of B-LAT, B-LOSS and B-COOP
compare (``data/claims.yaml``). The seeds of a cell run together, because the criteria ask for the median
over the "Hello"s of all seeds.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from itertools import product
from typing import TYPE_CHECKING, Any, cast

import numpy as np

from sfglab.arp.hallway.simulation import LAP_DEPTHS, OPTIMUM, LapSettings, SimulatedLap
from sfglab.arp.hello import HELLO_UP, OPT_DEPTH, GridCell, hello_times_ms, scenario_of
from sfglab.arp.robots import BEST, DEPTHS, RATES_HZ
from sfglab.fields import between
from sfglab.lab.claims import Criterion, load_claims
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled, seeded
from sfglab.lab.paths import find_project
from sfglab.lab.sweep import Workers
from sfglab.rtps import Medium, run
from sfglab.rtps.session import age_ms

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.rtps.channel import QueueRule

MODES = ("fast_dds_sync", "fast_dds_async", "fast_dds_foxy", "cyclone_dds")
QUEUE_FRAMES = 277
"""Number of small frames in Linux's default socket buffer, 212,992 B: each frame takes 768 B (an skb)."""
STALL_EVERY_S = 1.0
"""Time between channel stalls in conditions with stalls, s. Assumed; the criterion gives the length of a stall."""
CELLS = (
    *((method, str(depth)) for method in ("none", "CC") for depth in DEPTHS),
    ("OPT+CC", OPT_DEPTH),
    (BEST, OPT_DEPTH),
)
"""Methods and depths that the criteria of B-LAT and B-LOSS compare."""
LAPS = (*(("none", depth) for depth in LAP_DEPTHS), (BEST, OPTIMUM))
"""Methods and depths that the criterion of B-COOP compares."""


# --- Conditions -------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """A `Place` is a place on the map."""

    preset: str  #: Mode of publication, a name in `sfglab.rtps.PRESETS`.
    #: Share of frames lost on each of the two wireless hops to and from the access point.
    loss: float
    frame_us: float  #: Airtime of a frame on each hop in addition to its bits, us.
    queue_rule: str = "block"  #: Rule of a host's full queue.
    stall_ms: float = 0.0  #: Length of a channel stall, which occurs once in `STALL_EVERY_S`, ms.
    rate_max_hz: int  #: Rmax, the highest rate of a topic, Hz.


PLACE = [one.name for one in fields(Place)]


@dataclass(frozen=True, slots=True, kw_only=True)
class Condition(Place):
    """A `Condition` is a place that the experiment simulates."""

    duration_s: float = 10.0  #: Simulated time of publication, s.
    seeds: int = 1  #: Number of seeds of each cell.

    def medium(self) -> Medium:
        """Return the wireless channel."""
        return Medium(
            loss=self.loss,
            overhead_s=self.frame_us / 1e6,
            queue_frames=QUEUE_FRAMES,
            queue_rule=cast("QueueRule", self.queue_rule),
            access_point=True,
            random_turns=True,
            stall_every_s=STALL_EVERY_S,
            stall_s=self.stall_ms / 1e3,
        )


def criterion() -> Criterion:
    """Return the criterion of B-LAT; the criteria of B-LOSS and B-COOP have the same modes and region."""
    [claim] = (claim for claim in load_claims(find_project().claims) if claim.id == "B-LAT")
    assert claim.criterion is not None, "it has one"
    return claim.criterion


def plausible() -> list[tuple[Any, ...]]:
    """Return the places of the criteria in the order of `PLACE`: 27 places per mode and Rmax."""
    asked = criterion()
    axes = []
    for name in ("loss", "frame_us", "stall_ms"):
        low, high = asked.region[name]
        axes.append((low, round(middle(low, high), 6), high))
    places = []
    for preset, loss, frame_us, stall_ms, rate_hz in product(asked.modes, *axes, RATES_HZ):
        places.append((preset, loss, frame_us, "block", stall_ms, rate_hz))
    return places


def middle(low: float, high: float) -> float:
    """Return the geometric mean of two values, or half of the higher value if the lower value is 0."""
    return math.sqrt(low * high) if low else high / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The `Config` has the settings of a run."""

    presets: tuple[str, ...] = MODES  #: Modes of publication.
    losses: tuple[float, ...] = (0.0001, 0.0017, 0.03)  #: Shares of frames lost on each hop.
    frames_us: tuple[float, ...] = (50.0, 250.0, 1200.0)  #: Airtimes of a frame on each hop, us.
    queue_rules: tuple[str, ...] = ("block",)  #: Rules of full queues.
    rates_hz: tuple[int, ...] = (500,)  #: Values of Rmax, Hz.
    #: Whether the run simulates all conditions of the criteria, at every Rmax of Table 2.
    criterion: bool = True
    duration_s: float = between(10.0, 0.5, 60.0)  #: Simulated time of a cell, s.
    seeds: int = 6  #: Number of seeds of each cell.
    course_seeds: int = 2  #: Number of laps per method and depth.
    seed: int = 0  #: First seed.


exp = Experiment(
    "phases",
    Config,
    where="B 3",
    smoke={
        "presets": ("fast_dds_async",),
        "losses": (0.0017,),
        "frames_us": (50.0, 1200.0),
        "queue_rules": ("block",),
        "criterion": False,
        "duration_s": 1.0,
        "seeds": 1,
        "course_seeds": 1,
    },
    paper={
        "losses": (0.0001, 0.0003, 0.001, 0.003, 0.01, 0.03),
        "frames_us": (50.0, 100.0, 200.0, 350.0, 600.0, 1200.0),
        "queue_rules": ("block", "tail", "head"),
        "rates_hz": RATES_HZ,
        "course_seeds": 6,
    },
    actors=(
        Actor("robot1", "robot1", "sensing and actuation; robot2 and robot3 alike", count="3"),
        Actor("wireless channel", "access point", "loses frames, stalls, queues"),
        Actor("station", "station", "localisation and planning"),
    ),
    links=(
        Link("robot1", "wireless channel", "sensors' values", boundary="first hop"),
        Link("wireless channel", "station", "the same", boundary="second hop"),
    ),
)


def conditions(config: Config) -> list[Condition]:
    """Return the conditions of the map and, if `Config.criterion` is set, the conditions of the criteria."""
    axes = (config.presets, config.losses, config.frames_us, config.queue_rules)
    places = [*product(*axes, (0.0,), config.rates_hz)]
    if config.criterion:
        places += plausible()
    chosen = []
    for place in dict.fromkeys(places):
        values: dict[str, Any] = dict(zip(PLACE, place, strict=True))
        chosen.append(Condition(**values, duration_s=config.duration_s, seeds=config.seeds))
    return chosen


# --- Sweeps -----------------------------------------------------------------------------------


@exp.table("cell")
class MethodRow(Place):
    """A `MethodRow` is a method at a depth in one condition with one seed, simulated."""

    method: str  #: Name of the method.
    depth: str  #: DEPTH as in Table 2.
    seed: int  #: Number of the seed.
    published: int  #: Number of "Hello"s that were published.
    arrived: int  #: Number of "Hello"s that reached actuation.
    p50_ms: float  #: Median time to actuation, ms; a "Hello" that never arrived has infinite time.
    pooled_ms: float  #: Median over the "Hello"s of all seeds together, ms.
    age_ms: float  #: Mean age of the newest "Hello" at the station, ms.


@exp.sweep(
    "cell", over=conditions, seeds=lambda config: [config.seed], workers=Workers(threads=True)
)
def simulate(condition: Condition, seed: int) -> tuple[dict[str, Any], ...]:
    """Simulate the methods that the criteria compare in a condition, with all of its seeds from this one on."""
    rows = []
    for method, depth in CELLS:
        rows += _cell_rows(condition, method, depth, range(seed, seed + condition.seeds))
    return tuple(rows)


def _cell_rows(condition: Condition, method: str, depth: str, seeds: range) -> list[dict[str, Any]]:
    cell = GridCell(
        rate_max_hz=condition.rate_max_hz,
        depth=depth,
        method=method,
        duration_s=condition.duration_s,
        vendor=condition.preset,
        hop=True,
    )
    medium = condition.medium()
    outcomes = [run(scenario_of(cell, seed=seed, medium=medium), seed=seed) for seed in seeds]
    times_ms = [hello_times_ms(outcome) for outcome in outcomes]
    pooled_ms = _median(np.concatenate(times_ms))
    rows = []
    for seed, outcome, times in zip(seeds, outcomes, times_ms, strict=True):
        row = {
            "method": method,
            "depth": depth,
            "seed": seed,
            "published": len(times),
            "arrived": int(np.isfinite(times).sum()),
            "p50_ms": _median(times),
            "pooled_ms": pooled_ms,
            "age_ms": age_ms(outcome.flows[HELLO_UP], duration_s=condition.duration_s),
        }
        rows.append(row)
    return rows


def _median(times_ms: NDArray[np.float64]) -> float:
    return float(np.quantile(times_ms, 0.5, method="lower"))


@exp.table("course")
class LapRow(Place):
    """A `LapRow` is a lap of the hallway in one condition with one seed, simulated."""

    method: str  #: Name of the method.
    depth: int  #: DEPTH; 0 for the depth of Eq. 6.
    seed: int  #: Number of the seed.
    end: str  #: End of the lap, an `End`.
    robot: str  #: Robot that met an obstacle; empty if no robot or several robots met one.


@exp.sweep("course", over=conditions, seeds=lambda config: seeded(config, config.course_seeds))
def drive(condition: Condition, seed: int) -> tuple[dict[str, Any], ...]:
    """Drive a lap in a condition without a method, at three depths, and with OPT+LC."""
    rows = []
    for method, depth in LAPS:
        settings = LapSettings(
            method=method,
            depth=depth,
            vendor=condition.preset,
            medium=condition.medium(),
            rate_max_hz=condition.rate_max_hz,
        )
        lap = SimulatedLap(settings, seed).run()
        end = {"end": lap.end.value, "robot": lap.robot}
        rows.append({"method": method, "depth": depth, **end})
    return tuple(rows)

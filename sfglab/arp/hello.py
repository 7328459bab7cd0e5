"""Paper B, section 3.1: the flows of Fig. 9 with "Hello", and the cells of Table 2's grid. Pure.

Robot 1's sensing node publishes "Hello" to its localisation in the station; when that and robot 3's
localisation have had it, the station publishes it to robot 1's actuation node. A topic's rate is Rmax, or R of
Eq. 6; the topics of an agent are those flows that begin or end there (Eq. 1).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from sfglab.arp.balancing import Balance, BalanceInput, balance_closed_form
from sfglab.arp.robots import METHODS, PLAN_S, ROBOTS, SENSORS, TAKE_S, topic_qos
from sfglab.errors import InvalidValueError
from sfglab.rtps import PRESETS, Flow, Medium, Outcome, Scenario, Vendor

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.qos import QoSProfile

OPT_DEPTH = "opt"  #: DEPTH as Eq. 6 gives it, beside the numbers of Table 2.
SMALL_DEPTH = 10  #: A DEPTH up to this is small: the lower half of Table 2.
TIE = 0.05  #: Latencies that differ by less than this share count as equal.

STATION = "station"  #: The host of localisation and planning.
HELLO_UP = "robot1/hello"  #: "Hello" from robot 1 to the station.
HELLO_HOP = "robot3/localisation"  #: "Hello" from the station to robot 3, where it goes that way.
HELLO_DOWN = "robot1/move"  #: "Hello" to robot 1's actuation.
#: Size of "Hello" in CDR: header, length, text and its final zero (RTPS 2.5, clause 10).
HELLO_BYTES = len("Hello") + 1 + 4 + 4


@dataclass(frozen=True, slots=True, kw_only=True)
class GridCell:
    """One cell of Table 2's grid, over one channel.

    Raises:
        InvalidValueError: There is no such depth.
    """

    rate_max_hz: int  #: Rmax.
    depth: str  #: DEPTH: a number as text, or `OPT_DEPTH`.
    method: str  #: One of `METHODS`.
    duration_s: float  #: Duration of publishing, s.
    loss: float = Medium().loss  #: Share of frames that the air loses.
    vendor: str = "fast_dds"  #: One of `PRESETS`.
    #: Whether robot 3's localisation, over which "Hello" goes, runs on robot 3 (Fig. 9), not in the station.
    hop: bool = False

    def __post_init__(self) -> None:
        if self.depth != OPT_DEPTH and not (self.depth.isdecimal() and int(self.depth) > 0):
            raise InvalidValueError("depth", self.depth, f"whole numbers from 1 and {OPT_DEPTH!r}")


def balance_of(rate_max_hz: float) -> Balance:
    """Return R, in Hz, and D of Eq. 6; T_a of Eq. 1 are the topics that begin or end at each robot.

    Two of "Hello"'s flows begin or end at robot 1. The two more at robot 3 with `GridCell.hop` are left out, so that
    both ways have one rate.
    """
    hello = {"robot1": 2}
    topics = tuple(len(sensors) + hello.get(robot, 0) for robot, sensors in ROBOTS.items())
    return balance_closed_form(BalanceInput(topics=topics, rate_max_hz=rate_max_hz))


def rate_and_depth(cell: GridCell) -> tuple[float, int]:
    """Return the publishing rate (Hz) and the history depth (samples) of a cell of the grid."""
    optimum = balance_of(cell.rate_max_hz)
    rate_hz = optimum.rate_hz if METHODS[cell.method].optimised else float(cell.rate_max_hz)
    return rate_hz, int(optimum.depth) if cell.depth == OPT_DEPTH else int(cell.depth)


def scenario_of(
    cell: GridCell, *, seed: int = 0, medium: Medium | None = None, vendor: Vendor | None = None
) -> Scenario:
    """Return a cell as what the model runs; by default over an air with the cell's loss, by its vendor.

    The seed is that of the phases, as nodes do not start together.
    """
    rate_hz, depth = rate_and_depth(cell)
    qos = topic_qos(rate_hz, depth)
    phases = np.random.default_rng(seed).uniform(0, 1 / rate_hz, sum(map(len, ROBOTS.values())) + 1)
    flows = _sensor_flows(cell, rate_hz, qos, phases)
    return Scenario(
        flows=(*flows, *_hello_flows(cell, rate_hz, qos, float(phases[-1]))),
        medium=medium or Medium(loss=cell.loss),
        vendor=vendor or PRESETS[cell.vendor],
        duration_s=cell.duration_s,
    )


def _sensor_flows(
    cell: GridCell, rate_hz: float, qos: QoSProfile, phases: NDArray[np.float64]
) -> list[Flow]:
    method = METHODS[cell.method]
    pairs = [(robot, sensor) for robot, sensors in ROBOTS.items() for sensor in sensors]
    return [
        Flow(
            name=f"{robot}/{sensor}",
            source=robot,
            target=STATION,
            size_bytes=SENSORS[sensor].table_bytes,
            rate_hz=rate_hz,
            phase_s=float(phase),
            qos=qos,
            executor=f"{robot} planning",
            service_s=TAKE_S + PLAN_S,
            compare_s=TAKE_S if method.cache_control else None,
            change_s=SENSORS[sensor].change_s,
            cached=method.local_cache,
        )
        for (robot, sensor), phase in zip(pairs, phases, strict=False)
    ]


def _hello_flows(
    cell: GridCell, rate_hz: float, qos: QoSProfile, phase_s: float
) -> tuple[Flow, ...]:
    """Return the ways of "Hello". Each one is counted, so none repeats another, and caches pass them all."""
    # Robot 1's localisation, and robot 3's if that is in the station.
    plans = 1 if cell.hop else 2
    up = Flow(
        name=HELLO_UP,
        source="robot1",
        target=STATION,
        size_bytes=HELLO_BYTES,
        rate_hz=rate_hz,
        phase_s=phase_s,
        qos=qos,
        executor="robot1 planning",
        service_s=TAKE_S + plans * PLAN_S,
        then=HELLO_HOP if cell.hop else HELLO_DOWN,
    )
    down = replace(
        up,
        name=HELLO_DOWN,
        source="robot3" if cell.hop else STATION,
        target="robot1",
        rate_hz=0.0,
        phase_s=0.0,
        executor=None,
        service_s=TAKE_S,
        then=None,
    )
    if not cell.hop:
        return up, down
    to_robot3 = replace(down, name=HELLO_HOP, source=STATION, target="robot3", then=HELLO_DOWN)
    return up, replace(to_robot3, service_s=TAKE_S + PLAN_S), down


def hello_latency_ms(outcome: Outcome) -> NDArray[np.float64]:
    """Return the time of each "Hello" from publication to actuation, ms, shape (arrived,)."""
    up, down = outcome.flows[HELLO_UP], outcome.flows[HELLO_DOWN]
    place = np.searchsorted(up.value, down.value[down.delivered])
    return (down.received_ns[down.delivered] - up.published_ns[place]) / 1e6


def hello_times_ms(outcome: Outcome) -> NDArray[np.float64]:
    """Return latencies of all "Hello"s, ms, shape (published,): first those that arrived, then infinity for others.

    The order is not that of publication.
    """
    arrived = hello_latency_ms(outcome)
    return np.append(arrived, [np.inf] * (len(outcome.flows[HELLO_UP].fate) - len(arrived)))

"""The module `hello` has the flows of paper B's Fig. 9 with "Hello", and the cells of Table 2's grid (section 3.1).

Robot 1's sensing node publishes "Hello" to its localisation in the station. After robot 1's localisation and robot
3's localisation have received "Hello", the station publishes "Hello" to robot 1's actuation node. The rate of a
topic is Rmax, or R of Eq. 6. The topics of an agent are the flows that begin or end at the agent (Eq. 1). The module
works without I/O.
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

OPT_DEPTH = "opt"  #: DEPTH by Eq. 6, an alternative to the numbers of Table 2.
SMALL_DEPTH = 10  #: Largest DEPTH that counts as small: the lower half of Table 2.
TIE = 0.05  #: Share below which a difference of two latencies counts as none.

STATION = "station"  #: Name of the host of localisation and planning.
HELLO_UP = "robot1/hello"  #: Flow of "Hello" from robot 1 to the station.
#: Flow of "Hello" from the station to robot 3, for cells with `GridCell.hop`.
HELLO_HOP = "robot3/localisation"
HELLO_DOWN = "robot1/move"  #: Flow of "Hello" from the station to robot 1's actuation.
#: Size of "Hello" in CDR: header, length, text and the text's final zero (RTPS 2.5, clause 10).
HELLO_BYTES = len("Hello") + 1 + 4 + 4


@dataclass(frozen=True, slots=True, kw_only=True)
class GridCell:
    """A `GridCell` is one cell of Table 2's grid, over one channel.

    Raises:
        InvalidValueError: The depth is neither a whole number from 1 nor `OPT_DEPTH`.
    """

    rate_max_hz: int  #: Rmax, the highest rate of a topic, Hz.
    depth: str  #: DEPTH: a number as text, or `OPT_DEPTH`.
    method: str  #: Name of the method, one of `METHODS`.
    duration_s: float  #: Duration of publishing, s.
    loss: float = Medium().loss  #: Share of frames that the wireless channel loses.
    vendor: str = "fast_dds"  #: Name of the timing preset, one of `PRESETS`.
    #: Whether robot 3's localisation, which forwards "Hello", runs on robot 3 (Fig. 9) or in the station.
    hop: bool = False

    def __post_init__(self) -> None:
        if self.depth != OPT_DEPTH and not (self.depth.isdecimal() and int(self.depth) > 0):
            raise InvalidValueError("depth", self.depth, f"whole numbers from 1 and {OPT_DEPTH!r}")


def balance_of(rate_max_hz: float) -> Balance:
    """Return R, in Hz, and D of Eq. 6; T_a of Eq. 1 counts the topics that begin or end at each robot.

    Two flows of "Hello" begin or end at robot 1. With `GridCell.hop` two more flows begin or end at robot 3. The
    function leaves out the two flows at robot 3, so that "Hello" has the same rate with and without `hop`.
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
    """Return the scenario of a cell; by default the channel has the cell's loss, and the timing is the cell's preset.

    The seed selects the phases of the flows, because real nodes do not start together.
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
    """Return the flows of "Hello"; each "Hello" has a new number, so that caches pass every "Hello"."""
    # The executor runs robot 1's localisation, and robot 3's localisation if `hop` is False.
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
    """Return the latencies of all "Hello"s, ms, shape (published,); a "Hello" that never arrived has infinite latency.

    The latencies of arrived "Hello"s come first, so the order is not that of publication.
    """
    arrived = hello_latency_ms(outcome)
    return np.append(arrived, [np.inf] * (len(outcome.flows[HELLO_UP].fate) - len(arrived)))

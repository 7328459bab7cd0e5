"""From a cell of the grid to the flows of Fig. 9: sixteen sensors to the station, "Hello" there and back.

Robot 1's sensing node publishes "Hello" to its localisation in the station; when that and robot 3's
localisation have had it, the station publishes it to robot 1's actuation node. A topic's rate is Rmax, or R of
Eq. 6, and so is what its local cache looks at; the topics of an agent are those flows that begin or end there
(Eq. 1).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sfglab.arp.balancing import Balance, BalanceInput, balance_closed_form
from sfglab.arp.robots import METHODS, PLAN_S, ROBOTS, SENSORS, TAKE_S, Method
from sfglab.lab.experiments.transmission.config import OPT_DEPTH, Point
from sfglab.qos import QoSProfile
from sfglab.rtps import FAST_DDS, Flow, Medium, Scenario

if TYPE_CHECKING:
    from sfglab.rtps import Vendor


STATION = "station"
HELLO_UP, HELLO_DOWN = "robot1/hello", "robot1/move"
HELLO_BYTES = len("Hello") + 1 + 4 + 4
"""CDR: header, length, text and its final zero (RTPS 2.5, clause 10)."""


def topics_of_agents() -> tuple[int, ...]:
    """Return T_a of Eq. 1: topics that begin or end at each robot."""
    hello = {"robot1": 2}
    return tuple(len(sensors) + hello.get(robot, 0) for robot, sensors in ROBOTS.items())


def balance_of(rate_max_hz: float) -> Balance:
    """Return R and D of Eq. 6 for the topics of this experiment."""
    return balance_closed_form(BalanceInput(topics=topics_of_agents(), rate_max_hz=rate_max_hz))


def rate_and_depth(point: Point) -> tuple[float, int]:
    """Return a cell's publishing rate, Hz, and history depth."""
    optimum = balance_of(point.rate_max_hz)
    rate_hz = optimum.rate_hz if METHODS[point.method].optimised else float(point.rate_max_hz)
    return rate_hz, int(optimum.depth) if point.depth == OPT_DEPTH else int(point.depth)


def scenario_of(
    point: Point, *, seed: int = 0, medium: Medium | None = None, vendor: Vendor = FAST_DDS
) -> Scenario:
    """Return a cell as a scenario.

    Args:
        point: The cell.
        seed: Of the phases: nodes do not start together.
        medium: The air; None: `Medium`'s defaults with the cell's loss.
        vendor: Timing; the paper used Fast DDS.
    """
    rate_hz, depth = rate_and_depth(point)
    qos = QoSProfile(depth=depth, deadline_ns=round(1e9 / rate_hz))
    phases = np.random.default_rng(seed).uniform(0, 1 / rate_hz, sum(map(len, ROBOTS.values())) + 1)
    method = METHODS[point.method]
    flows = _sensor_flows(method, rate_hz, qos, phases)
    return Scenario(
        flows=(*flows, *_hello_flows(rate_hz, qos, float(phases[-1]))),
        medium=medium or Medium(loss=point.loss),
        vendor=vendor,
        duration_s=point.duration_s,
    )


def _sensor_flows(method: Method, rate_hz: float, qos: QoSProfile, phases: np.ndarray) -> list[Flow]:
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


def _hello_flows(rate_hz: float, qos: QoSProfile, phase_s: float) -> tuple[Flow, Flow]:
    """Every "Hello" is counted, so none repeats another and no cache holds it back."""
    up = Flow(
        name=HELLO_UP,
        source="robot1",
        target=STATION,
        size_bytes=HELLO_BYTES,
        rate_hz=rate_hz,
        phase_s=phase_s,
        qos=qos,
        executor="robot1 planning",
        service_s=TAKE_S + 2 * PLAN_S,  # robot 1's localisation, and robot 3's
        then=HELLO_DOWN,
    )
    down = Flow(
        name=HELLO_DOWN, source=STATION, target="robot1", size_bytes=HELLO_BYTES, qos=qos, service_s=TAKE_S
    )
    return up, down

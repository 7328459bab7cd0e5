"""The one message that carried a change is lost: how long the station believes what is not true. Simulated.

The sensor's value changes at random; the local cache sends each change once. Over a link with losses, best
effort and reliable, and with several longest silences.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sfglab.arp.robots import SENSORS
from sfglab.lab.experiments.balancing.rows import ShownRow, StaleRow
from sfglab.qos import QoSProfile, Reliability
from sfglab.rtps import FAST_DDS, Flow, Medium, Scenario, run

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from sfglab.lab.experiments.balancing.config import Config
    from sfglab.rtps import FlowOutcome


SENSOR = "pir"
RATE_HZ = 100.0
QOS = {
    "best effort": QoSProfile(reliability=Reliability.BEST_EFFORT, depth=1),
    "reliable": QoSProfile(depth=1),
}
SHOWN = (("best effort", 0.0), ("reliable", 0.0), ("best effort", 0.5))
"""The examples whose course is kept: QoS and longest silence, seconds."""

_SHOWN_S = 40.0


def stale_rows(config: Config) -> tuple[list[StaleRow], list[ShownRow]]:
    """Simulate every QoS with every longest silence.

    Args:
        config: Losses, silences, seeds and how long.

    Returns:
        One row a run, and the courses of the examples with the first seed.
    """
    rows, shown = [], []
    for qos in QOS:
        for silence_s in config.silences_s:
            for seed in range(config.seed, config.seed + config.stale_seeds):
                flow = _simulate(qos, silence_s, config, seed)
                rows.append(_row(qos, silence_s, seed, flow, config.stale_s))
                if seed == config.seed and (qos, silence_s) in SHOWN:
                    shown += _course(qos, silence_s, flow)
    return rows, shown


def _simulate(qos: str, silence_s: float, config: Config, seed: int) -> FlowOutcome:
    flow = Flow(
        name=SENSOR,
        source="robot",
        target="station",
        size_bytes=SENSORS[SENSOR].table_bytes,
        rate_hz=RATE_HZ,
        qos=QOS[qos],
        change_s=SENSORS[SENSOR].change_s,
        cached=True,
        max_silence_s=silence_s or None,
    )
    scenario = Scenario(
        flows=(flow,), medium=Medium(loss=config.loss), vendor=FAST_DDS, duration_s=config.stale_s, drain_s=0.0
    )
    return run(scenario, seed=seed).flows[SENSOR]


def _steps(flow: FlowOutcome) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return times of all steps, and from each on the sensor's value and the station's; -1 before the first."""
    times = np.unique(np.concatenate([flow.published_ns, flow.received_ns[flow.delivered]]))
    true = flow.value[np.searchsorted(flow.published_ns, times, side="right") - 1]
    order = np.searchsorted(flow.received_ns[flow.delivered], times, side="right") - 1
    known = np.where(order >= 0, flow.value[flow.delivered][order], -1)
    return times, true.astype(np.int64), known.astype(np.int64)


def _row(qos: str, silence_s: float, seed: int, flow: FlowOutcome, duration_s: float) -> StaleRow:
    times, true, known = _steps(flow)
    lasts_s = np.diff([*times, duration_s * 1e9]) / 1e9
    stale = true != known
    # A stretch goes on over steps; it ends where the station knows again.
    starts = np.flatnonzero(stale & ~np.concatenate([[False], stale[:-1]]))
    lengths = np.add.reduceat(lasts_s * stale, starts) if len(starts) else np.zeros(1)
    return StaleRow(
        qos=qos,
        silence_s=silence_s,
        seed=seed,
        messages_hz=len(flow.fate) / duration_s,
        stale_share=float(lasts_s[stale].sum() / duration_s),
        longest_s=float(lengths.max()),
    )


def _course(qos: str, silence_s: float, flow: FlowOutcome) -> list[ShownRow]:
    times, true, known = _steps(flow)
    rows = []
    for where, values in (("sensor", true), ("station", known)):
        changes = np.flatnonzero(np.diff(values, prepend=-2))
        rows += [
            ShownRow(qos=qos, silence_s=silence_s, where=where, t_s=times[i] / 1e9, value=int(values[i]))
            for i in changes
            if times[i] < _SHOWN_S * 1e9
        ]
    return rows

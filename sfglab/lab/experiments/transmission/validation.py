"""Validation of the presets of RTPS: one topic between two hosts, live and in the model, in cells of a seed.

The cells are committed, ``data/qos/validation.csv``, and were before the first was played: a third offers more
than the air carries, a third loses three percent of the frames or more, each with every depth.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import pandas as pd

from sfglab.lab.experiments.transmission.stage import compared, live_hosts
from sfglab.qos import QoSProfile
from sfglab.rtps import PRESETS, Flow, Medium, Scenario, run

if TYPE_CHECKING:
    from collections.abc import Mapping

    from sfglab.lab.experiments.transmission.stage import RosMode

MODEL_SEEDS = 6
READER_DEPTH = 5000
"""Of every reader, so that a node of Python that looks late loses nothing: the writer's history is asked."""
MODES: dict[str, RosMode | None] = {
    "fast_dds_sync": "SYNCHRONOUS",
    "fast_dds_async": "ASYNCHRONOUS",
    "cyclone_dds": None,
}
"""What is validated, by preset: a real ROS 2 node's mode of publication; None: Cyclone DDS, by ourselves."""

MEDIUM = ("loss", "queue_frames", "queue_rule", "burst_frames", "access_point")
"""Columns of a cell that are `Medium`'s; others are ``preset``, ``kind``, ``overhead_us`` and the topic's."""


def scenario_of_cell(cell: Mapping[str, Any], *, duration_s: float, drain_s: float = 7.0) -> Scenario:
    """Return a cell as what is played and simulated; by default two heartbeats of Fast DDS come afterwards."""
    flow = Flow(
        name="topic",
        source="robot",
        target="station",
        rate_hz=cell["rate_hz"],
        size_bytes=cell["size_bytes"],
        qos=QoSProfile(depth=cell["depth"]),
        reader_depth=READER_DEPTH,
    )
    medium = Medium(overhead_s=cell["overhead_us"] / 1e6, **{name: cell[name] for name in MEDIUM})
    vendor = PRESETS[cell["preset"]]
    return Scenario(flows=(flow,), medium=medium, vendor=vendor, duration_s=duration_s, drain_s=drain_s)


async def validate(cells: pd.DataFrame, *, duration_s: float, seed: int = 0) -> pd.DataFrame:
    """Play cells of one preset live, one after the other, beside the model, and return what they gave.

    Columns are those of the cells and of `compared`, and ``kept_up``.

    Raises:
        HostsUnavailableError: This machine has no test hosts.
        RosMissingError: This machine has no ROS 2.
    """
    records: list[Any] = cells.to_dict("records")
    rows = []
    async with live_hosts("robot", "station", ros=MODES[cells["preset"].iloc[0]]) as hosts:
        for cell in records:
            played = await hosts.play(scenario_of_cell(cell, duration_s=duration_s), seed=seed)
            models = [run(played.scenario, seed=seed + k) for k in range(MODEL_SEEDS)]
            rows.append({**cell, **compared(played, models, "sensors"), "kept_up": played.kept_up})
    return pd.DataFrame(rows)

"""Validation of the presets of RTPS: one topic between two hosts, live and in the model, in cells of a seed.

The cells are committed, ``data/qos/validation.csv``, and were before the first was played: a third offers more
than the air carries, a third loses three percent of the frames or more, each with every depth. Knows cells and
what is compared; how hosts play stands in `stage`.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.experiments.transmission.stage import LATENCY_WITHIN, LOSS_WITHIN, live_hosts
from sfglab.qos import QoSProfile
from sfglab.rtps import PRESETS, Flow, Medium, Scenario, run

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from sfglab.lab.experiments.transmission.stage import RosMode
    from sfglab.rtps import FlowOutcome

MODEL_SEEDS = 6
MODES: dict[str, RosMode | None] = {
    "fast_dds_sync": "SYNCHRONOUS",
    "fast_dds_async": "ASYNCHRONOUS",
    "cyclone_dds": None,
}
"""What is validated, by preset: a real ROS 2 node's mode of publication; None: Cyclone DDS, by ourselves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """One topic over one medium."""

    preset: str  #: One of `MODES`.
    kind: str  #: ``saturated``, ``lossy`` or ``calm``.
    rate_hz: float  #: How often is published.
    depth: int  #: Of both histories.
    size_bytes: int  #: CDR size.
    loss: float  #: Share of frames lost.
    overhead_us: int  #: Airtime of a frame beside its bits.
    queue_frames: int  #: Of a host's queue.
    queue_rule: str  #: What a full one drops: its ``tail`` or its ``head``.
    burst_frames: int  #: Mean length of a burst of losses; 0: each by itself.
    access_point: bool  #: Whether frames are on air twice.

    def scenario(self, *, duration_s: float, drain_s: float = 7.0) -> Scenario:
        """Return it as what is played and simulated; by default two heartbeats of Fast DDS come afterwards."""
        qos = QoSProfile(depth=self.depth)
        flow = Flow(name="topic", source="robot", target="station", rate_hz=self.rate_hz, qos=qos)
        alike = ("loss", "queue_frames", "queue_rule", "burst_frames", "access_point")
        medium = Medium(overhead_s=self.overhead_us / 1e6, **{name: getattr(self, name) for name in alike})
        return Scenario(
            flows=(replace(flow, size_bytes=self.size_bytes),),
            medium=medium,
            vendor=PRESETS[self.preset],
            duration_s=duration_s,
            drain_s=drain_s,
        )


def load_cells(path: Path) -> list[Cell]:
    """Read committed cells."""
    rows: list[Any] = pd.read_csv(path).to_dict("records")
    return [Cell(**row) for row in rows]


async def validate(cells: Iterable[Cell], *, duration_s: float, seed: int = 0) -> pd.DataFrame:
    """Play cells of one preset live, one after the other, beside the model; return a line a cell.

    Beside the cell's own columns: ``loss`` and ``p50_ms`` of both, each ``_live`` and ``_model``, whether they
    agree (`stage`), and ``kept_up``. A median in which most samples are lost is infinite.

    Raises:
        HostsUnavailableError: This machine has no test hosts.
        RosMissingError: This machine has no ROS 2.
    """
    cells = list(cells)
    rows = []
    async with live_hosts("robot", "station", ros=MODES[cells[0].preset]) as hosts:
        for cell in cells:
            played = await hosts.play(cell.scenario(duration_s=duration_s), seed=seed)
            models = [run(played.scenario, seed=seed + k).flows["topic"] for k in range(MODEL_SEEDS)]
            found = compare_flows([played.outcome.flows["topic"]], models)
            rows.append({**asdict(cell), **found, "kept_up": played.kept_up})
    return pd.DataFrame(rows)


def compare_flows(live: list[FlowOutcome], models: list[FlowOutcome]) -> dict[str, Any]:
    """Return losses and medians, of lost samples infinite, and whether they agree."""
    found: dict[str, Any] = {}
    for name, flows in (("live", live), ("model", models)):
        times = np.concatenate([np.where(f.delivered, f.received_ns - f.published_ns, np.inf) for f in flows])
        found |= {
            f"loss_{name}": float(np.isinf(times).mean()),
            f"p50_{name}_ms": float(np.median(times)) / 1e6,
        }
    ratio = found["p50_model_ms"] / found["p50_live_ms"] if np.isfinite(found["p50_live_ms"]) else np.nan
    both_lost = np.isinf(found["p50_live_ms"]) and np.isinf(found["p50_model_ms"])
    return {
        **found,
        "loss_agrees": abs(found["loss_live"] - found["loss_model"]) <= LOSS_WITHIN,
        "latency_agrees": bool(both_lost or abs(ratio - 1) <= LATENCY_WITHIN),
    }

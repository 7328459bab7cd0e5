"""The cells that validate the presets of RTPS are a seed's; criteria name presets and conditions that exist."""

from pathlib import Path

import numpy as np
import pandas as pd

from sfglab.arp.robots import DEPTHS
from sfglab.lab.claims import load_claims
from sfglab.lab.experiments.transmission.validation import MODES, scenario_of_cell
from sfglab.rtps import PRESETS, Medium
from sfglab.rtps.model import data_bytes

DATA = Path(__file__).parents[2] / "data"
SEED, COUNT = 18, 40


def drawn(rng, preset, number):
    kind = ("saturated", "lossy", "calm")[number % 3]
    rate_hz, size_bytes = float(rng.choice([20, 50, 100, 200, 400])), int(rng.choice([24, 60, 400, 1000]))
    low, high = (1.1, 2.0) if kind == "saturated" else (0.02, 0.4)
    bits_s = data_bytes(size_bytes, with_heartbeat=False) * 8 / Medium().rate_bps
    loss = rng.uniform(0.03, 0.1) if kind == "lossy" else rng.uniform(0.0, 0.02)
    return {
        "preset": preset,
        "kind": kind,
        "rate_hz": rate_hz,
        "depth": DEPTHS[number // 3 % len(DEPTHS)],
        "size_bytes": size_bytes,
        "loss": round(float(loss), 4),
        "overhead_us": max(100, round(1e6 * (rng.uniform(low, high) / rate_hz - bits_s))),
        "queue_frames": int(rng.choice([20, 100, 500])),
        "queue_rule": str(rng.choice(["tail", "head"])),
        "burst_frames": int(rng.choice([0, 0, 3])),
        "access_point": bool(rng.random() < 0.25),
    }


def test_the_committed_cells_are_those_of_the_seed():
    rng = np.random.default_rng(SEED)
    cells = pd.read_csv(DATA / "qos" / "validation.csv").to_dict("records")
    assert cells == [drawn(rng, preset, number) for preset in MODES for number in range(COUNT)]
    assert all(scenario_of_cell(cell, duration_s=8.0).flows for cell in cells)


def test_what_judges_on_the_papers_own_middleware_is_written_down():
    criteria = {claim.id: claim.criterion for claim in load_claims(DATA / "claims.yaml") if claim.criterion}
    assert set(criteria) == {"B-LAT", "B-LOSS", "B-COOP"}
    for criterion in criteria.values():
        assert set(criterion.modes) <= set(PRESETS)
        assert set(criterion.region) == {"loss", "frame_us", "stall_ms"}

"""Real Fast DDS over the lossy radio between hosts, in both modes of publication, beside the model."""

import numpy as np
import pytest

from sfglab.lab.experiments.transmission.stage import live_hosts
from sfglab.lab.experiments.transmission.validation import MODES, scenario_of_cell
from sfglab.rtps import run

pytestmark = [pytest.mark.live, pytest.mark.ros, pytest.mark.netns]

CELL = {"kind": "lossy", "rate_hz": 100.0, "depth": 800, "size_bytes": 24, "loss": 0.08, "overhead_us": 300}
RADIO = {"queue_frames": 500, "queue_rule": "tail", "burst_frames": 0, "access_point": False}


@pytest.mark.parametrize(("preset", "stalls"), [("fast_dds_sync", True), ("fast_dds_async", False)])
async def test_a_deep_history_stalls_in_the_mode_in_which_the_model_says_so(preset, stalls):
    scenario = scenario_of_cell({**CELL, **RADIO, "preset": preset}, duration_s=2.0, drain_s=2.0)
    async with live_hosts("robot", "station", ros=MODES[preset]) as hosts:
        played = await hosts.play(scenario, seed=5)
    flows = [outcome.flows["topic"] for outcome in (played.outcome, run(played.scenario, seed=5))]
    soon = [np.sum(flow.latency_ns < 500_000_000) / len(flow.fate) for flow in flows]
    assert played.radio.lost > 10
    assert [share < 0.5 for share in soon] == [stalls, stalls], soon

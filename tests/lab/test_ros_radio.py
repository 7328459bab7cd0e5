"""Real Fast DDS over the lossy radio between hosts, in both modes of publication, beside the model."""

from __future__ import annotations

from dataclasses import replace

import pytest

from sfglab.lab.experiments.transmission.stage import live_hosts
from sfglab.lab.experiments.transmission.validation import MODES, Cell, compare_flows
from sfglab.rtps import run

pytestmark = [pytest.mark.live, pytest.mark.ros, pytest.mark.netns]

CELL = Cell(
    preset="", kind="lossy", rate_hz=100.0, depth=800, size_bytes=24, loss=0.08, overhead_us=300,
    queue_frames=500, queue_rule="tail", burst_frames=0, access_point=False,
)  # fmt: skip


@pytest.mark.parametrize(("preset", "stalls"), [("fast_dds_sync", True), ("fast_dds_async", False)])
async def test_a_deep_history_stalls_in_the_mode_in_which_the_model_says_so(preset, stalls):
    scenario = replace(CELL, preset=preset).scenario(duration_s=2.0, drain_s=2.0)
    async with live_hosts("robot", "station", ros=MODES[preset]) as hosts:
        played = await hosts.play(scenario, seed=5)
    live, model = played.outcome.flows["topic"], run(played.scenario, seed=5).flows["topic"]
    found = compare_flows([live], [model])
    assert played.radio.lost > 10
    assert (found["p50_live_ms"] > 500, found["p50_model_ms"] > 500) == (stalls, stalls)

"""The cells that validate the presets of RTPS are a seed's; criteria name presets and conditions that exist."""

import asyncio
import re
from contextlib import ExitStack, nullcontext
from dataclasses import asdict, replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest
from made_logs import CLAIMS, DATA, made_run

from sfglab.arp.robots import DEPTHS
from sfglab.lab import live_flows
from sfglab.lab.experiments import transmission
from sfglab.lab.experiments.transmission import validation
from sfglab.processes import ProcessFailedError
from sfglab.rtps import PRESETS, Medium
from sfglab.rtps.model import data_bytes

SEED, COUNT = 18, 40


def drawn(rng, preset, number):
    kind = ("saturated", "lossy", "calm")[number % 3]
    rate_hz, size_bytes = (
        float(rng.choice([20, 50, 100, 200, 400])),
        int(rng.choice([24, 60, 400, 1000])),
    )
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
    assert cells == [
        drawn(rng, preset, number) for preset in live_flows.MODES for number in range(COUNT)
    ]
    assert all(validation.scenario_of_cell(cell, duration_s=8.0).flows for cell in cells)


def test_what_judges_on_the_papers_own_middleware_is_written_down():
    criteria = {claim.id: claim.criterion for claim in CLAIMS.values() if claim.criterion}
    assert set(criteria) == {"B-LAT", "B-LOSS", "B-COOP"}
    for criterion in criteria.values():
        assert set(criterion.modes) <= set(PRESETS)
        assert set(criterion.region) == {"loss", "frame_us", "stall_ms"}


MADE = [  # number of the cell, loss live and in the model, medians live and in the model, kept
    (0, 0.30, 0.31, 10.0, 12.0, True),
    (0, 0.34, 0.31, 14.0, 12.0, True),
    (0, 0.90, 0.31, 99.0, 12.0, False),
    (1, 0.10, 0.14, 10.0, 13.5, True),
    (2, 0.10, 0.10, 10.0, 10.0, False),
]


def test_shares_are_those_of_the_cells_that_kept_their_schedule(tmp_path):
    names = ("loss_live", "loss_model", "p50_live_ms", "p50_model_ms", "kept_up")
    cells = validation.committed_cells()
    rows = [
        asdict(cells[number]) | dict(zip(names, values, strict=True)) for number, *values in MADE
    ]
    run = made_run(transmission.exp, tmp_path / "made.mcap", {validation.TABLE: rows})
    lines = validation.validated(run).set_index("preset").fillna(-1)
    shown = ["cells", "kept", "enough", "loss_within", "latency_within"]
    assert lines.loc["fast_dds_sync", shown].to_list() == [3, 2, False, 0.5, 0.5]
    assert lines.loc["cyclone_dds", shown].to_list() == [0, 0, False, -1, -1]
    assert lines.loc["fast_dds_foxy", "note"] == "read in its sources, not measured"
    first = validation.by_cell(run).iloc[0]
    assert first[["loss_live", "loss_live_low", "loss_live_high"]].to_list() == pytest.approx(
        [0.32, 0.3, 0.34]
    )
    figure, _ = transmission.exp.draw("transmission_validation", run)
    assert (
        "2 of 3 cells kept their schedule: too few\nwithin 3 points: 50%"
        in figure.axes[0].get_title()
    )
    assert re.match("2 cells.*asynchronous: read", figure.get_supxlabel())


def test_a_cell_is_played_as_often_as_its_own_scatter_asks():
    calm, bistable = (validation.committed_cells()[number] for number in (2, 10))
    assert [validation.repeats_of(cell, 8.0, 5) for cell in (calm, bistable)] == [1, 5]
    assert validation.repeats_of(bistable, 8.0, 1) == 1


def test_a_run_that_is_broken_off_goes_on_and_a_cell_that_fails_is_left_out(tmp_path, monkeypatch):
    found, played = validation.committed_cells()[38:42], []
    cells = {cell: validation.scenario_of_cell(asdict(cell), duration_s=1.0) for cell in found}

    async def rows(_hosts, cell, repeat):
        played.append((number := found.index(cell), repeat))
        if number == 1:
            raise ProcessFailedError("it ended")
        if (number, repeat) == (2, 1) and played.count((2, 1)) == 1:
            raise KeyboardInterrupt
        return {"number": number, "repeat": repeat}

    monkeypatch.setattr(live_flows, "live_hosts", lambda *_, **__: nullcontext())
    log = SimpleNamespace(path=tmp_path / "a.mcap")
    bench = Mock(experiment="transmission", config=transmission.exp.config(), log=log)

    def play():
        with ExitStack() as bench.stack:
            asyncio.run(
                live_flows.play_missing(
                    bench, validation.TABLE, cells, dict.fromkeys(cells, 2), rows
                )
            )

    with pytest.raises(KeyboardInterrupt):
        play()
    assert not bench.write_all.called
    before = len(played)
    play()
    written = [row for call in bench.write_all.call_args_list for row in call.args[1]]
    assert written == [{"number": n, "repeat": r} for r in (0, 1) for n in (0, 2, 3)]
    assert len(bench.metadata.call_args.args[1]["failed"]) == 2
    assert len(played) - before == 2 + 2 + 1 + 1, (
        "what failed twice again, what was broken off, what is left"
    )
    assert not list(tmp_path.iterdir()), "a finished run leaves no journal"


def test_cells_on_real_fast_dds_are_few_in_quick_and_slowed_where_python_is_too_slow(tmp_path):
    quick, paper = (
        validation.ros_cells(transmission.exp.config(profile)) for profile in ("quick", "paper")
    )
    assert len(quick) <= 12
    assert {cell.preset for cell in quick} == {"fast_dds_sync", "fast_dds_async"}
    slowed = {(100, 2), (100, 4), (200, 4), (500, 10), (1000, 20)}
    assert {(c.point.rate_max_hz, c.slowed) for c in paper} == slowed
    cell = next(cell for cell in paper if cell.slowed == 20)
    fast, slow = replace(cell, slowed=1.0).scenario(0), cell.scenario(0)
    assert [flow.rate_hz for flow in slow.flows] == pytest.approx(
        [flow.rate_hz / 20 for flow in fast.flows]
    )
    assert slow.medium.airtime_ns(100, 1) == pytest.approx(
        20 * fast.medium.airtime_ns(100, 1), rel=1e-6
    )
    row = {
        "group": "hello",
        "preset": cell.preset,
        "slowed": 10.0,
        "p50_live_ms": 30.0,
        "p50_model_ms": 20.0,
    }
    played = (True, 0.2), (True, 0.3), (False, 0.9)
    rows = [row | {"kept_up": kept, "loss_live": loss} for kept, loss in played]
    run = made_run(transmission.exp, tmp_path / "made.mcap", {"ros2": rows})
    [line] = transmission.on_ros2(run).to_dict("records")
    assert (line["played"], line["kept"], line["loss_live"]) == (3, 2, pytest.approx(0.25))
    assert (line["p50_live_ms"], line["p50_model_ms"]) == (3.0, 2.0)

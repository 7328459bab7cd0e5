"""The cells that validate the presets of RTPS are a seed's; criteria name presets and conditions that exist."""

import asyncio
from contextlib import ExitStack, asynccontextmanager
from dataclasses import asdict, dataclass, replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest
from made_logs import CLAIMS, DATA, made_run

from sfglab.arp.robots import DEPTHS
from sfglab.lab.cells import run_cells
from sfglab.lab.experiment import SkippedPartError
from sfglab.lab.experiments import transmission
from sfglab.lab.experiments.transmission import live, results
from sfglab.lab.live_flows import MODES
from sfglab.lab.runs import COMPLETION, standing
from sfglab.processes import ProcessFailedError
from sfglab.record import LogWriter
from sfglab.rtps import PRESETS, Medium
from sfglab.rtps.channel import airtime_ns
from sfglab.rtps.frames import data_bytes

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
    expected = []
    for preset in MODES:
        expected += [drawn(rng, preset, number) for number in range(COUNT)]
    assert pd.read_csv(DATA / "qos" / "validation.csv").to_dict("records") == expected
    cells = live.topic_cells()
    assert all(len(cell.scenario(8.0).flows) == 1 for cell in cells)
    assert len(cells) == len(expected)


def test_what_judges_on_the_papers_own_middleware_is_written_down():
    criteria = {claim.id: claim.criterion for claim in CLAIMS.values() if claim.criterion}
    assert set(criteria) == {"B-LAT", "B-LOSS", "B-COOP"}
    for criterion in criteria.values():
        assert set(criterion.modes) <= set(PRESETS)
        assert set(criterion.region) == {"loss", "frame_us", "stall_ms"}


MEASURED = ["loss_live", "loss_model", "p50_live_ms", "p50_model_ms", "kept_up"]


def test_shares_are_of_cells_that_kept_their_schedule_by_medians_and_by_the_first_play(tmp_path):
    grid = replace(live.grid_cells(transmission.exp.config("paper"))[0], preset="fast_dds_sync")
    differs, never_kept = live.topic_cells()[:2]
    plays = [
        (grid, 0.9, 0.3, 10.0, 10.0, False),
        (grid, 0.3, 0.3, 10.0, 20.0, True),
        (grid, 0.3, 0.3, 10.0, 10.0, True),
        (grid, 0.3, 0.3, 10.0, 10.0, True),
        (differs, 0.5, 0.3, 9.0, 9.0, True),
        (never_kept, 0.3, 0.3, 10.0, 10.0, False),
        (replace(never_kept, preset="cyclone_dds"), 0.3, 0.3, 10.0, 10.0, False),
    ]
    rows = [asdict(cell) | dict(zip(MEASURED, values, strict=True)) for cell, *values in plays]
    failed = {"failed": {"a cell": "no reason"}}
    run = made_run(
        transmission.exp, tmp_path / "made.mcap", {"validation": rows}, validation=failed
    )
    table = results.validated(run).set_index(["of", "preset"])
    columns = ["cells", "both_within", "first_within"]
    assert table.loc[("grid", "fast_dds_sync"), columns].tolist() == [1, 1, 0]
    assert table.loc[("topics", differs.preset), columns].tolist() == [1, 0, 0]
    assert ("topics", "cyclone_dds") not in table.index, "it has no play on time"
    figure, _ = transmission.exp.draw("transmission_validation", run)
    assert any(
        "4 of 7 plays kept their schedule and are shown; 1 failed" in text.get_text()
        for text in figure.texts
    )


def test_the_committed_log_shows_topics_and_the_grids_cells_on_fast_dds():
    run = transmission.exp.load(DATA / "reference" / "transmission.mcap")
    table = results.validated(run).set_index("of")
    assert table.loc["topics", "preset"].tolist() == [*MODES]
    assert len(table.loc["grid"]) == 2
    both = table.loc["topics", "both_within"].tolist()
    assert both == pytest.approx([0.875, 0.95, 0.925])
    first = table.loc["topics", "first_within"].tolist()
    assert first == pytest.approx([0.825, 0.925, 0.9])
    assert len(results.played(run)) == 634
    assert len(results.on_time(results.played(run))) == 501
    best = results.on_time(results.played(run)).query("of == 'grid' and method == 'OPT+LC'")
    assert best.groupby(["preset", "rate_hz"])["loss_live"].median().max() == 0


def test_cells_of_the_grid_are_slowed_where_python_is_too_slow():
    cells = live.grid_cells(transmission.exp.config("paper"))
    factors = {cell.rate_hz: cell.slowed for cell in cells}
    assert factors == {100: 2, 200: 4, 500: 10, 1000: 20}
    fast, slow = (replace(cells[-1], slowed=factor).scenario(8.0) for factor in (1.0, 20.0))
    assert slow.flows[0].rate_hz == pytest.approx(fast.flows[0].rate_hz / 20)
    airtimes_ns = [
        airtime_ns(100, 1, medium.overhead_ns, medium.rate_bps, medium.contention)
        for medium in (fast.medium, slow.medium)
    ]
    assert airtimes_ns[1] == pytest.approx(20 * airtimes_ns[0], rel=1e-6)
    assert live.validation_cells(transmission.exp.config("quick")) == {}


# --- The runner of live cells -----------------------------------------------------------------


@dataclass(frozen=True)
class Cell:
    """A cell of a made-up part."""

    number: int
    stage: str = "a"


def test_a_run_that_is_broken_off_goes_on_and_one_whose_cell_fails_twice_counts_for_no_claim(
    tmp_path,
):
    cells, played, started = [Cell(0), Cell(1), Cell(2, "b"), Cell(3)], [], []
    config, log = SimpleNamespace(profile="quick"), SimpleNamespace(path=tmp_path / "a.mcap")
    bench = Mock(experiment="made", config=config, log=log)

    @asynccontextmanager
    async def start(stage):
        started.append(stage)
        yield stage

    async def play(stage, cell, repeat):
        assert stage == cell.stage
        played.append((cell.number, repeat))
        if cell.number == 1:
            raise ProcessFailedError("it ended")
        if played.count((3, 1)) == 1 and cell.number == 3:
            raise KeyboardInterrupt
        return {"number": cell.number, "repeat": repeat}

    def run(repeats):
        stage_of = lambda cell: cell.stage  # noqa: E731
        how = {"stage_of": stage_of, "start": start, "play": play, "at_once": 1}
        with ExitStack() as bench.stack:
            asyncio.run(run_cells(bench, "made", dict.fromkeys(cells, repeats), **how))

    with pytest.raises(KeyboardInterrupt):
        run(2)
    assert not bench.write_all.called
    before = len(played)
    run(2)
    written = [row for call in bench.write_all.call_args_list for row in call.args[1]]
    assert written == [{"number": n, "repeat": r} for r in (0, 1) for n in (0, 2, 3)]
    assert list(bench.metadata.call_args.args[1]["failed"].values()) == ["it ended"] * 2
    assert {"a", "b"} == set(started)
    assert played[before:].count((0, 0)) == 0, "it is in the journal"
    assert not list(tmp_path.iterdir()), "a finished run leaves no journal"
    completion = {"profile": "quick", "changed": [], "explored": False}
    with LogWriter(log.path) as made:
        made.write_metadata(*bench.metadata.call_args.args)
        made.write_metadata(COMPLETION, completion)
    assert standing(log.path).why_not == "cells failed in made"
    with pytest.raises(SkippedPartError, match="not asked for"):
        run(0)


@pytest.mark.parametrize(
    ("failures", "played", "failed"),
    [
        ({}, [0, 1, 2], []),
        ({"play": [1]}, [0, 1, 1, 2], []),  # once: it is played again, and no failure
        ({"play": [1, 1]}, [0, 1, 1, 2], [1]),
        ({"end": 1}, [0, 1, 2], []),  # all were played before
        ({"start": 1}, [0, 1, 2], []),
        ({"start": 2}, [], [0, 1, 2]),
        ({"start": 1, "play": [0], "again": 1}, [0, 0, 1, 2], []),
    ],
)
def test_a_cell_counts_as_failed_if_it_is_not_played_at_the_end(tmp_path, failures, played, failed):
    config, log = SimpleNamespace(profile="quick"), SimpleNamespace(path=tmp_path / "a.mcap")
    bench = Mock(experiment="made", config=config, log=log)
    left, seen, starts = {"play": [], **failures}, [], []

    @asynccontextmanager
    async def start(stage):
        starts.append(stage)
        counted = "again" if seen else "start"
        if left.get(counted, 0):
            left[counted] -= 1
            raise ProcessFailedError("it did not start")
        yield stage
        if left.pop("end", 0):
            raise ProcessFailedError("it did not end")

    async def play(stage, cell, repeat):
        seen.append(cell.number)
        if cell.number in left["play"]:
            left["play"] = left["play"][1:]
            raise ProcessFailedError("it ended")
        return {"number": cell.number}

    cells = dict.fromkeys(map(Cell, range(3)), 1)
    how = {"stage_of": lambda cell: cell.stage, "start": start, "play": play, "at_once": 1}
    with ExitStack() as bench.stack:
        asyncio.run(run_cells(bench, "made", cells, **how))
    assert seen == played
    reasons = bench.metadata.call_args.args[1]["failed"]
    assert [*reasons] == [f"{Cell(number)}, repetition 0" for number in failed]
    assert bench.advance.call_count == len(cells), "the bar is full"
    assert seen or len(starts) == 2, "a stage that cannot start is not started for each cell"

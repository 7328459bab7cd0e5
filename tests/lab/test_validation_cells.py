"""The cells that validate the presets of RTPS are a seed's; what is shown of them; and the runner of live cells."""

import asyncio
from contextlib import ExitStack, asynccontextmanager
from dataclasses import asdict, dataclass, replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pandas as pd
import pytest
from made_logs import DATA, made_run

from sfglab.arp.robots import DEPTHS
from sfglab.lab.cells import _jobs, run_cells
from sfglab.lab.experiment import SkippedPartError
from sfglab.lab.experiments import transmission
from sfglab.lab.experiments.transmission import live, results
from sfglab.lab.live_flows import MODES
from sfglab.lab.runs import COMPLETION, standing
from sfglab.processes import ProcessFailedError
from sfglab.record import LogWriter
from sfglab.rtps import Medium
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


def test_shares_are_of_cells_that_kept_their_schedule_by_medians_and_by_the_first_play(tmp_path):
    grid = replace(live.grid_cells(transmission.exp.config("paper"))[0], preset="fast_dds_sync")
    topic = replace(live.topic_cells()[0], preset="fast_dds_sync")
    plays = [
        (grid, 0.9, 10.0, False),
        (grid, 0.3, 20.0, True),
        (grid, 0.3, 10.0, True),
        (grid, 0.3, 10.0, True),
        (topic, 0.5, 10.0, True),
        (replace(topic, preset="cyclone_dds"), 0.3, 10.0, False),
    ]
    rows = []
    for cell, loss, late_ms, kept_up in plays:
        model = {"loss_model": 0.3, "p50_model_ms": 10.0}
        seen = {"loss_live": loss, "p50_live_ms": late_ms, "kept_up": kept_up}
        rows.append(asdict(cell) | model | seen)
    failed = {"failed": {"a cell": "no reason"}}
    run = made_run(
        transmission.exp, tmp_path / "made.mcap", {"validation": rows}, validation=failed
    )
    table = results.validated(run).set_index(["of", "preset"])
    columns = ["cells", "both_within", "first_within"]
    assert table.loc[("grid", "fast_dds_sync"), columns].tolist() == [1, 1, 0]
    assert table.loc[("topics", "fast_dds_sync"), columns].tolist() == [1, 0, 0]
    assert ("topics", "cyclone_dds") not in table.index, "it has no play on time"
    figure, _ = transmission.exp.draw("transmission_validation", run)
    assert any(
        "4 of 6 trials kept their schedule, only these are shown; 1 failed" in text.get_text()
        for text in figure.texts
    )


def test_cells_of_the_grid_are_slowed_where_python_is_too_slow():
    cells = live.grid_cells(transmission.exp.config("paper"))
    factors = {cell.rate_hz: cell.slowed for cell in cells}
    assert factors == {100: 2, 200: 4, 500: 10, 1000: 20}
    rates_hz, airtimes_ns = [], []
    for factor in (1.0, 20.0):
        scenario = replace(cells[-1], slowed=factor).scenario(8.0)
        medium = scenario.medium
        rates_hz.append(scenario.flows[0].rate_hz)
        air = (medium.overhead_ns, medium.rate_bps, medium.contention)
        airtimes_ns.append(airtime_ns(100, 1, *air))
    assert rates_hz[0] == pytest.approx(20 * rates_hz[1])
    assert airtimes_ns[1] == pytest.approx(20 * airtimes_ns[0], rel=1e-6)


# --- The runner of live cells -----------------------------------------------------------------


@dataclass(frozen=True)
class Cell:
    """A cell of a made-up part."""

    number: int
    stage: str = "a"


@asynccontextmanager
async def started(stage):
    """Provide the processes of a stage, which are its name."""
    yield stage


@pytest.fixture
def bench(tmp_path):
    """The context of a run of a made-up experiment."""
    config, log = SimpleNamespace(profile="quick"), SimpleNamespace(path=tmp_path / "a.mcap")
    return Mock(experiment="made", config=config, log=log)


def test_each_cell_has_its_own_number_of_repetitions_and_all_first_ones_come_first():
    assert _jobs([2, 0, 1]) == [(0, 0), (2, 0), (0, 1)]


def run(bench, cells, play, *, start=started, repeats=1):
    async def rows_by_table(*played):
        return {"made": [await play(*played)]}

    how = {"stage_of": lambda cell: cell.stage, "start": start, "play": rows_by_table}
    with ExitStack() as bench.stack:
        asyncio.run(run_cells(bench, "made", dict.fromkeys(cells, repeats), **how))


def test_a_run_that_is_broken_off_goes_on(bench, tmp_path):
    played = []

    async def play(_, cell, repeat):
        played.append((cell.number, repeat))
        if len(played) == 3:
            raise KeyboardInterrupt
        return {"number": cell.number, "repeat": repeat}

    cells = [Cell(0), Cell(1)]
    with pytest.raises(KeyboardInterrupt):
        run(bench, cells, play, repeats=2)
    assert not bench.write_all.called
    run(bench, cells, play, repeats=2)
    assert played == [(0, 0), (1, 0), (0, 1), (0, 1), (1, 1)]
    written = [row for call in bench.write_all.call_args_list for row in call.args[1]]
    assert written == [{"number": n, "repeat": r} for r in (0, 1) for n in (0, 1)]
    assert not list(tmp_path.iterdir()), "a finished run leaves no journal"


def test_a_run_whose_cell_fails_twice_counts_for_no_claim(bench):
    async def play(stage, cell, _):
        assert stage == cell.stage
        if cell.number == 1:
            raise ProcessFailedError("it ended")
        return {"number": cell.number}

    run(bench, [Cell(0), Cell(1), Cell(2, "b")], play)
    name, told = bench.metadata.call_args.args
    assert list(told["failed"].values()) == ["it ended"]
    with LogWriter(bench.log.path) as made:
        made.write_metadata(name, told)
        made.write_metadata(COMPLETION, {"profile": "quick", "changed": [], "explored": False})
    assert standing(bench.log.path).why_not == "cells failed in made"
    with pytest.raises(SkippedPartError, match="not asked for"):
        run(bench, [Cell(0)], play, repeats=0)


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
def test_a_cell_counts_as_failed_if_it_is_not_played_at_the_end(bench, failures, played, failed):
    left, seen = {"start": 0, "again": 0, "end": 0, "play": [], **failures}, []

    def fail(when):
        if left[when]:
            left[when] -= 1
            raise ProcessFailedError(f"{when}: it did not")

    @asynccontextmanager
    async def start(stage):
        fail("again" if seen else "start")
        yield stage
        fail("end")

    async def play(_, cell, __):
        seen.append(cell.number)
        if cell.number in left["play"]:
            left["play"].remove(cell.number)
            raise ProcessFailedError("it ended")
        return {"number": cell.number}

    run(bench, [Cell(0), Cell(1), Cell(2)], play, start=start)
    assert seen == played
    reasons = bench.metadata.call_args.args[1]["failed"]
    assert [*reasons] == [f"{Cell(number)}, repetition 0" for number in failed]
    assert bench.advance.call_count == 3, "the bar is full"
    assert left["start"] == 0, "it is tried twice"

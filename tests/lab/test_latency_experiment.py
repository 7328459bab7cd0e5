"""The latency experiment: known delays are found again, and a short live run proves itself."""

from __future__ import annotations

import asyncio

import numpy as np
import psutil
import pytest

from sfglab.fields import to_json
from sfglab.lab.bench import Options
from sfglab.lab.experiments.latency import checks, exp
from sfglab.lab.experiments.latency.analysis import (
    added,
    first_mean,
    first_ratio,
    glass_median,
    idle_cost,
    sights,
)
from sfglab.lab.experiments.latency.experiment import IdleRow, LookRow, ShotRow, SightRow, looks_of
from sfglab.lab.experiments.latency.stage import PATHS
from sfglab.record import LogWriter

MS = 10**6
GLASS_MS = {"standard": 8, "decoder": 9, "agent": 11, "on_demand": 11}
FIRST_MS = {"standard": 500, "decoder": 60, "agent": 75, "on_demand": 1000}
REPEATS, STRANGER = 4, 10**6


def look_row(look: int, repeat: int, path: str, ordered_ns: int) -> LookRow:
    return LookRow(
        look=look,
        repeat=repeat,
        path=path,
        phase=0.5,
        ordered_ns=ordered_ns,
        first_ns=ordered_ns + (FIRST_MS[path] + 10 * repeat) * MS,
        pictures=6,
        unreadable=0,
        missed=0,
        disordered=0,
        broken=0,
        replay_packets=15 if path in ("decoder", "agent") else 0,
        replay_bytes=0,
    )


@pytest.fixture
def made(tmp_path):
    """A log as a run writes it, with known delays, and a slow beginning of every look."""
    path = tmp_path / "made.mcap"
    with LogWriter(path) as log:
        log.write_metadata("config", {"experiment": "latency", **to_json(exp.config())})
        log.write_metadata("hosts", {"description": "made", "separate": True})
        log.write_metadata("stream", {"encoder": "none", "gop_s": 1.0})
        for label in ("camera", "keeper", "router"):
            row = IdleRow(label=label, cpu_percent=1.5, tx_mbit_s=0.0, loopback_mbit_s=8.0, window_s=1.0)
            log.write_row("idle", row, log_time_ns=0)
        number = 0
        for repeat in range(REPEATS):
            for place, name in enumerate(PATHS):
                look, started_ns = repeat * len(PATHS) + place, (repeat * 10 + place) * 1000 * MS
                log.write_row("look", look_row(look, repeat, name, started_ns), log_time_ns=started_ns)
                for position in range(6):
                    stamp_ns = started_ns + position * 150 * MS
                    sent = ShotRow(number=number, stamp_ns=stamp_ns, size_bytes=1)
                    log.write_row("camera", sent, log_time_ns=stamp_ns)
                    late = 100 if position < 3 else 0  # what the first pictures are must not count
                    seen_ns = stamp_ns + (GLASS_MS[name] + repeat + late) * MS
                    log.write_row(
                        "sight", SightRow(look=look, number=number, seen_ns=seen_ns), log_time_ns=seen_ns
                    )
                    number += 1
        stray = SightRow(look=REPEATS * len(PATHS), number=STRANGER, seen_ns=1)
        log.write_row("sight", stray, log_time_ns=1)
        log.write_row("look", look_row(stray.look, REPEATS, "agent", 0), log_time_ns=1)
    return exp.load(path)


def test_what_a_path_adds_is_found_between_looks_of_one_repetition(made):
    assert glass_median(made, "standard").value == pytest.approx(8 + 1.5)
    assert added(made, "decoder").value == pytest.approx(1)
    assert added(made, "agent").value == pytest.approx(3)
    assert "on_demand" not in set(sights(made)["path"])


def test_times_to_the_first_picture_are_compared_by_their_means(made):
    assert first_mean(made, "standard").value == pytest.approx(515)
    assert first_ratio(made, "agent").value == pytest.approx(90 / 515)
    assert first_ratio(made, "on_demand").value == pytest.approx(1015 / 515)
    assert idle_cost(made, "keeper") == pytest.approx(1.5)


def test_a_picture_that_the_camera_did_not_send_is_noticed(made):
    table = checks(made).set_index("path")
    assert table["unknown"].to_dict() == {"standard": 0, "decoder": 0, "agent": 1, "on_demand": 0}
    assert table.loc["standard", "oldest_ms"] == pytest.approx(8 + 3 + 100)


def test_claims_and_figure_come_from_the_log_alone(made):
    claims = exp.measure(made)
    assert claims["A-G2G"].estimate.value == pytest.approx(1)
    assert claims["A-FIRST"].estimate.value == pytest.approx(90 / 515)
    ((name, (figure, shown)),) = exp.figures(made).items()
    assert name == "latency"
    assert len(figure.axes) == 2
    assert shown["first_ratio_agent"]["value"] == pytest.approx(90 / 515)


def test_every_repetition_asks_all_paths_at_one_phase_and_phases_cover_the_group():
    config = exp.config(repeats=10)
    looks = looks_of(config, rng=np.random.default_rng(1))
    assert len(looks) == 10 * len(PATHS)
    orders = set()
    for repeat in range(10):
        asked = [look for look in looks if look.repeat == repeat]
        assert {look.path for look in asked} == set(PATHS)
        assert len({look.phase for look in asked}) == 1
        orders.add(tuple(look.path for look in asked))
    assert len(orders) > 1
    assert sorted({int(10 * look.phase) for look in looks}) == list(range(10))


@pytest.mark.live
@pytest.mark.slow
def test_a_short_live_run_shows_present_pictures_and_leaves_nothing(tmp_path):
    before = {p.pid for p in psutil.Process().children(recursive=True)}
    short = {"repeats": 1, "encoder": "libx264", "idle_s": 0.5, "skipped": 0}
    options = Options(separate=False)
    run = asyncio.run(exp.run("smoke", path=tmp_path / "run.mcap", options=options, **short))
    assert run.metadata("hosts")["separate"] is False
    table = checks(run).set_index("path")
    assert set(table.index) == set(PATHS)
    assert (table[["unreadable", "disordered", "broken", "unknown"]] == 0).all(axis=None)
    assert (table["pictures"] > 0).all()
    assert (table.loc[["decoder", "agent"], "replay_packets"] > 0).all(), "keepers were asked"
    assert (table.loc[["standard", "on_demand"], "replay_packets"] == 0).all()
    assert (sights(run)["glass_ms"] > 0).all()
    assert {p.pid for p in psutil.Process().children(recursive=True)} <= before

"""The decode-once experiment: known costs are found again, and a short live run proves itself."""

import asyncio
import os
import signal
import subprocess
import sys
import time

import numpy as np
import psutil
import pytest
from made_logs import made_run

from sfglab.lab.bench import Options
from sfglab.lab.experiments.decode_once import cost_model, exp, frame_checks, slopes, stream_facts
from sfglab.lab.experiments.decode_once.experiment import Stage, cells_of
from sfglab.record import LogReader

NET, DEC, IPC = 1.5, 5.0, 0.5


def cost(mode: str, count: int) -> float:
    """Eq. 2 and 3 with known terms."""
    return {"standard": count * (NET + DEC), "proxy": NET + DEC + count * IPC, "network": count * NET}[mode]


@pytest.fixture
def made(tmp_path):
    """A log as a run writes it, with costs that are exactly Eq. 2 and 3."""
    cells = [(m, n) for n in range(1, 11) for m in ("standard", "proxy")] + [("network", 5)]
    tables = {name: [] for name in ("cell", "load", "view", "camera", "pair")}
    for cell, (mode, count) in enumerate(cells):
        stamp_ns = 10**9 * (cell + 1)
        tables["cell"].append({"cell": cell, "codec": "h264", "mode": mode, "subscribers": count})
        for label, cpu in (("consumer", cost(mode, count)), ("edge", 20.0)):
            load = {"cell": cell, "label": label, "cpu_percent": cpu}
            tables["load"] += 2 * [{**load, "rx_mbit_s": 4.0 * (1 if mode == "proxy" else count)}]
        tables["view"].append({"cell": cell, "frames": 30, "age_ms": 5.0})
        tables["camera"].append({"codec": "h264", "number": cell, "stamp_ns": stamp_ns})
        if mode != "network":
            # One subscriber claims a number that the camera sent with another stamp.
            tables["pair"].append({"cell": cell, "number": cell or 99, "stamp_ns": stamp_ns})
    return made_run(exp, tmp_path / "made.mcap", tables)


def test_slopes_reduction_and_terms_of_known_costs_are_found_and_explain_everything(made):
    found = slopes(made)
    assert found.cpu_standard.value == pytest.approx(NET + DEC)
    assert found.cpu_proxy.value == pytest.approx(IPC)
    assert found.reduction.value == pytest.approx(100 * (1 - IPC / (NET + DEC)))
    assert found.net_standard.value == pytest.approx(4)
    assert found.net_proxy.value == pytest.approx(0, abs=1e-9)
    model = cost_model(made)
    assert [e.value for e in (model.net, model.dec, model.ipc)] == pytest.approx([NET, DEC, IPC])
    assert model.residual.value == pytest.approx(0, abs=1e-9)
    assert model.explained.value == pytest.approx(1)


def test_a_frame_that_the_camera_never_sent_so_is_not_verified(made):
    checks = frame_checks(made).set_index("mode")
    assert (checks.loc["standard", "pairs"], checks.loc["standard", "verified"]) == (10, 9)
    assert (checks.loc["proxy", "pairs"], checks.loc["proxy", "verified"]) == (10, 10)
    assert (checks.loc["network", "pairs"], checks.loc["network", "verified"]) == (0, 0)


def test_every_pair_of_cells_is_side_by_side_and_profiles_differ_in_length_only():
    stage = Stage(codec="h264", source="photos", counts=(1, 2, 5), network_counts=(5,), repeats=2)
    order = cells_of(stage, rng=np.random.default_rng(3))
    assert len(order) == len(set(order)) == 2 * 3 * 2 + 1
    paired = [c for c in order if c[0] != "network"]
    for first, second in zip(paired[::2], paired[1::2], strict=True):
        assert {first[0], second[0]} == {"standard", "proxy"}
        assert first[1:] == second[1:]
    config = exp.config("quick", source="drive.mp4", seed=4)
    assert [s.source for s in config.stages] == ["drive.mp4", "stereo"]
    assert config.stages[0].counts == tuple(range(1, 11))
    assert config.seed == 4


def test_the_figure_draws_from_the_log_alone(made):
    figure, shown = exp.figures(made)["decode_once_h264"]
    assert len(figure.axes) == 3
    assert shown["reduction"]["value"] == pytest.approx(100 * (1 - IPC / (NET + DEC)))


SHORT = {
    "stages": (Stage(codec="h264", counts=(1, 2)),),
    "encoder": "libx264",
    "period_s": 0.3,
    "settle_s": 0.1,
    "raw_s": 1.2,
}


@pytest.mark.live
@pytest.mark.slow
def test_a_short_live_run_shows_the_right_frames_and_leaves_nothing(tmp_path):
    before = {p.pid for p in psutil.Process().children(recursive=True)}
    options = Options(separate=False)
    run = asyncio.run(exp.run("smoke", path=tmp_path / "run.mcap", options=options, **SHORT))
    assert run.metadata("hosts")["separate"] is False
    checks = frame_checks(run)
    assert (checks["frames"] > 10).all()
    assert (checks[["unreadable", "disordered", "broken"]] == 0).all(axis=None)
    assert (checks["pairs"] == checks["verified"]).all()
    assert (checks["pairs"] > 0).all()
    facts = stream_facts(run)
    assert (facts.width, facts.height) == (640, 360)
    assert facts.bitrate.value > 0
    assert {p.pid for p in psutil.Process().children(recursive=True)} <= before


@pytest.mark.live
@pytest.mark.slow
def test_an_interrupted_run_ends_its_processes_and_keeps_what_was_measured(tmp_path):
    log = tmp_path / "run.mcap"
    part = tmp_path / "run.mcap.part"
    code = (
        "import asyncio; from pathlib import Path; from dataclasses import replace\n"
        "from sfglab.lab.bench import Options\n"
        "from sfglab.lab.experiments.decode_once import exp\n"
        "s = (replace(exp.config('smoke').stages[0], repeats=50),)\n"
        f"asyncio.run(exp.run('smoke', path=Path({str(log)!r}), options=Options(separate=False), stages=s,"
        " encoder='libx264', raw_s=0.5))\n"
    )
    process = subprocess.Popen([sys.executable, "-c", code], stderr=subprocess.PIPE, start_new_session=True)
    running = psutil.Process(process.pid)
    deadline = time.monotonic() + 120
    while not (part.exists() and len(running.children(recursive=True)) >= 5) and time.monotonic() < deadline:
        time.sleep(0.1)
    children = running.children(recursive=True)
    assert len(children) >= 5, "viewers, decoder and camera run"
    os.kill(process.pid, signal.SIGINT)
    _, error = process.communicate(timeout=60)
    assert b"KeyboardInterrupt" in error
    _, alive = psutil.wait_procs(children, timeout=60)
    assert not alive
    assert not log.exists(), "it is not finished"
    with LogReader(part) as reader:
        assert not reader.truncated

"""The transfer experiment: rows of model and hardware, claims, and processes that leave nothing."""

import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import psutil
import pytest
from made_logs import ran

from sfglab.lab.experiments.transfer import exp, experiment, stated, transfer_curves
from sfglab.lab.experiments.transfer.experiment import (
    IN,
    OUT,
    READS,
    RTL,
    WRITE,
    memory_in_hardware,
)
from sfglab.lab.experiments.transfer.live import Crossing, message_count
from sfglab.lab.experiments.transfer.results import bars, live_bars
from sfglab.lab.workers.crossing import Message, random_bytes
from sfglab.processes import ProcessFailedError
from sfglab.soc.paper_values import speed_ups, stated_by_model


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Run all parts once."""
    return ran(exp, tmp_path_factory.mktemp("transfer") / "a.mcap")


def test_claims_say_what_was_fitted_and_measured(run):
    found = exp.measure(run)["C-HWSW"]
    assert found.fitted.startswith("6 constants to 7 stated numbers")
    assert "2 hardware subscribers, 10000 B" in found.details["live"]


def test_bars_and_stated_numbers_are_the_model_s(run):
    assert list(bars(run)["ratio"]) == [bar.ratio for bar in speed_ups()]
    assert list(stated(run)["model"]) == pytest.approx(stated_by_model())


def test_every_live_cell_is_measured_over_both_transports_in_every_repetition(run):
    rows = run["crossing"]
    assert len(rows) == message_count(run.config) == 12
    assert not rows.duplicated(["repeat", "publisher", "transport"]).any()
    assert (rows[["hardware_ns", "software_ns"]] > 0).all(axis=None)
    assert live_bars(run)["panel"].nunique() == 4


def test_the_explorer_shows_the_model_s_times_and_its_speed_up():
    here = speed_ups(subscribers=[8], sizes_bytes=[10_000_000])
    picture = transfer_curves(message_bytes=10_000_000, subscribers=8)
    dots = [row["y"] for row in picture.values() if row["kind"] == "dot"]
    assert dots == [1e3 * time_s for bar in here for time_s in (bar.smt_s, bar.gateway_s)]


def test_simulated_hardware_takes_the_model_s_cycles_on_all_paths(run):
    pytest.importorskip("amaranth", reason="the extra rtl is not installed")
    memory = memory_in_hardware()
    model_cycles = {
        OUT: memory.memory_to_stream_cycles,
        IN: memory.stream_to_memory_cycles,
        READS: 2 * memory.read_cycles,
        WRITE: memory.write_cycles,
    }
    assert dict(zip(run["law"]["path"], run["law"]["chunk_cycles"], strict=True)) == model_cycles
    model = bars(run).query("subscribers == 2")["ratio"]
    assert bars(run, RTL)["ratio"].tolist() == pytest.approx(model.tolist(), rel=0.05)


def test_without_amaranth_the_claims_say_why(tmp_path, monkeypatch):
    monkeypatch.setattr(experiment, "find_spec", lambda _name: None)
    run = ran(exp, tmp_path / "a.mcap", live_rounds=0)
    details = exp.measure(run)["C-HWHW"].details
    assert details["RTL"].startswith("left out: amaranth is not installed")
    assert details["live"] == "this case was not measured"


BYTES = 10_000
OVER_TOPIC = Message(
    publisher="software",
    gateway=False,
    message_bytes=BYTES,
    offset=0,
    order=("reader0", "subscriber", "reader1"),
    woken=(),
)


@pytest.fixture
def nothing_left():
    """Check that no process, descriptor or named memory is left."""
    here = psutil.Process()
    before, children = here.num_fds(), set(here.children())
    yield
    assert set(here.children()) <= children
    assert not list(Path("/dev/shm").glob("*sfglab*"))
    assert here.num_fds() <= before


@pytest.mark.live
@pytest.mark.usefixtures("nothing_left")
async def test_a_wrong_content_is_noticed():
    async with Crossing(2, BYTES, seed=0) as crossing:
        await crossing.carry(OVER_TOPIC)
        crossing._data = random_bytes(BYTES, seed=1)
        with pytest.raises(ProcessFailedError, match="wrong content at subscriber, reader0"):
            await crossing.carry(replace(OVER_TOPIC, offset=8))


_PARENT = """
import asyncio
from sfglab.lab.experiments.transfer.live import Crossing

async def main():
    async with Crossing(2, 10_000, seed=0) as crossing:
        crossing["reader0"].order(do="transfer", publisher="software", gateway=False,
                                  message_bytes=8, offset=0, order=["reader0"], woken=[])
        await crossing["reader0"].expect("armed", timeout_s=60)
        print(*(crossing[name].pid for name in crossing), flush=True)
        await asyncio.sleep(60)

asyncio.run(main())
"""


@pytest.mark.live
def test_processes_end_when_their_parent_is_killed_during_a_message():
    argv = [sys.executable, "-c", _PARENT]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, cwd=Path.cwd()) as parent:
        workers = [psutil.Process(int(pid)) for pid in parent.stdout.readline().split()]
        parent.kill()
    assert len(workers) == 6
    assert not psutil.wait_procs(workers, timeout=60)[1]


@pytest.mark.usefixtures("nothing_left")
@pytest.mark.parametrize("victim", ["software", "gateway"])
async def test_a_killed_process_is_named_and_nothing_is_left(victim):
    ways = {"order": ("subscriber",), "woken": ("reader0", "reader1", "gateway")}
    message = replace(OVER_TOPIC, publisher="hardware", gateway=True, **ways)
    async with Crossing(2, BYTES, seed=0) as crossing:
        crossing[victim].signal(signal.SIGKILL)
        with pytest.raises(ProcessFailedError, match=f"{victim} killed by a signal"):
            await crossing.carry(message)

"""Sweeps: equal rows on all kinds of workers, in order, once each, also after interruptions."""

import asyncio
import json
import os
import signal
import struct
import subprocess
import sys
from collections import Counter
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import contextmanager, suppress
from dataclasses import asdict
from functools import partial
from itertools import count

import numpy as np
import psutil
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sweep_tasks import (
    OtherRow,
    SpotPoint,
    dying,
    failing,
    large,
    obeying,
    quick,
    several,
    uneven,
)
from waiting import program

from sfglab.errors import MissingExtraError
from sfglab.lab import progress
from sfglab.lab.sweep import SweepError, Workers, sweep
from sfglab.lab.sweep.journal import code_digest, open_journal, text_from_result
from sfglab.lab.sweep.run import Job, _run_jobs, connected

POINTS = [SpotPoint(number=number) for number in range(5)]
SEEDS = range(6)
THREADS = Workers(count=2, threads=True)
PROCESSES = Workers(count=2)


@pytest.fixture
def on_step(monkeypatch):
    """A function that has another one called after each step of a sweep."""
    monkeypatch.setattr(progress, "_LINES_S", 0.0)
    return lambda listener: monkeypatch.setattr(progress, "_print_line", listener)


def bits(results):
    return [
        struct.pack("d", row["value"])
        + json.dumps([row["number"], row["seed"], row["even"], row["name"]]).encode()
        for row in results
    ]


CLUSTER = """
import sys
from distributed import LocalCluster
with LocalCluster(n_workers=1, threads_per_worker=2, processes=False, protocol="tcp",
                  host="127.0.0.1", dashboard_address="127.0.0.1:0",
                  local_directory=sys.argv[1]) as cluster:
    print(cluster.scheduler_address, flush=True)
    sys.stdin.readline()
"""


@contextmanager
def foreign_scheduler(folder):
    """A dask scheduler with one worker in another process, as on a cluster."""
    own = {"PYTHONPATH": os.pathsep.join(sys.path), "DASK_TEMPORARY_DIRECTORY": str(folder)}
    pipes = {"stdin": subprocess.PIPE, "stderr": subprocess.DEVNULL}
    argv = [sys.executable, "-c", CLUSTER, str(folder)]
    with program(*argv, **pipes, env=os.environ | own) as process:
        yield process.stdout.readline().strip()
        process.communicate("\n", timeout=60)


@pytest.fixture
def swept(tmp_path):
    """A sweep by threads, with a journal in the test's folder."""
    return partial(sweep, journal=tmp_path / "journal", workers=THREADS)


def nothing_is_left():
    children = psutil.Process().children(recursive=True)
    assert not [p for p in children if "resource_tracker" not in str(p.cmdline())]


# --- Rows -----------------------------------------------------------------------------------------------------


def test_numpy_scalars_become_pythons_and_other_values_are_refused():
    for level in (np.float64(0.1), np.float32(0.1), np.int64(3), np.bool_(True)):
        assert json.loads(text_from_result({"level": level})) == {"level": level.item()}
    with pytest.raises(SweepError, match=r"given \{1\} in a row, allowed: bool, int, float, str"):
        text_from_result(OtherRow(level={1}))


# --- Where it runs --------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_threads_processes_and_a_cluster_give_the_same_bits_in_order(tmp_path, monkeypatch):
    seeds = [*SEEDS][::-1]
    wanted = bits(asdict(quick(point, seed)) for point in POINTS for seed in seeds)
    run = partial(sweep, uneven, POINTS, seeds)
    assert bits(run(journal=tmp_path / "a", workers=THREADS)) == wanted
    assert bits(run(journal=tmp_path / "b", workers=PROCESSES)) == wanted
    with foreign_scheduler(tmp_path / "far") as address:
        monkeypatch.setenv("SFGLAB_SCHEDULER", address)
        assert bits(run(journal=tmp_path / "c")) == wanted
    nothing_is_left()


def test_a_task_may_return_several_rows_of_several_kinds(swept):
    for _ in range(2):  # run, then read
        assert swept(several, POINTS[2:3], [3]) == [(asdict(quick(POINTS[2], 3)), {"level": 3 / 7})]


def test_local_workers_listen_nowhere_and_are_gone_afterwards():
    def listening():
        family = [psutil.Process(), *psutil.Process().children(recursive=True)]
        found = [one for process in family for one in process.net_connections()]
        return {one.laddr for one in found if one.status == "LISTEN"}

    before = listening()
    with connected(PROCESSES, 5) as (pool, _):
        wait([pool.submit(code_digest) for _ in range(2)])
        assert listening() == before
    nothing_is_left()


def test_an_address_where_nobody_answers_is_named(swept, monkeypatch):
    monkeypatch.setattr("sfglab.lab.sweep.run._CONNECT_S", 0.5)
    monkeypatch.setenv("SFGLAB_SCHEDULER", "tcp://127.0.0.1:9")
    with pytest.raises(SweepError, match=r"tcp://127\.0\.0\.1:9', where no scheduler responds"):
        swept(quick, POINTS, SEEDS)


# --- The journal ----------------------------------------------------------------------------------------------


@given(cut=st.integers(0, 2000), damage=st.sampled_from([b"", b"\0" * 20 + b"\n"]))
def test_a_journal_cut_off_or_damaged_anywhere_is_continued(tmp_path_factory, cut, damage):
    path = tmp_path_factory.mktemp("cut") / "journal"
    identity = {"task": "t", "points": "p", "code": "c"}
    texts = [text_from_result(quick(POINTS[2], seed)) for seed in SEEDS]
    with open_journal(path, identity) as journal:
        for seed, text in enumerate(texts):
            journal.add(0, seed, text)
    content = path.read_bytes()
    rest = damage and damage + content[cut:]
    path.write_bytes(content[:cut] + rest)
    whole = max(0, content[:cut].count(b"\n") - 1)
    with open_journal(path, identity) as journal:
        assert journal.finished == {(0, seed): json.loads(texts[seed]) for seed in range(whole)}
        for seed in range(whole, len(texts)):
            journal.add(0, seed, texts[seed])
    assert path.read_bytes() == content


@pytest.mark.parametrize(
    ("task", "points", "code", "said"),
    [
        (uneven, POINTS[1:], code_digest(), "task, points"),
        (quick, POINTS, "another", "code"),
    ],
)
def test_another_sweeps_journal_is_set_aside_with_its_difference(
    task, points, code, said, swept, tmp_path, caplog, monkeypatch
):
    swept(quick, POINTS, SEEDS)
    before = (tmp_path / "journal").read_bytes()
    monkeypatch.setattr("sfglab.lab.sweep.journal.code_digest", lambda: code)
    assert len(swept(task, points, SEEDS, workers=THREADS)) == len(points) * len(SEEDS)
    assert f"differs in: {said}); copied to journal.1" in caplog.text
    assert (tmp_path / "journal.1").read_bytes() == before


def test_a_file_that_is_no_journal_is_set_aside(tmp_path):
    for number, content in enumerate(("precious\n", "precious", '{"a": 1}\n'), 1):
        (tmp_path / "journal").write_text(content)
        sweep(quick, POINTS, SEEDS, journal=tmp_path / "journal")
        assert (tmp_path / f"journal.{number}").read_text() == content


def test_a_journal_serves_one_sweep_at_a_time(tmp_path):
    path = tmp_path / "journal"
    with (
        open_journal(path, {}),
        pytest.raises(SweepError, match="another sweep is writing this journal"),
        open_journal(path, {}),
    ):
        pass


# --- Failures and interruptions -------------------------------------------------------------------------------


def test_a_failing_task_names_point_and_seed(swept):
    said = r"SpotPoint\(number=2.* seed 1: ZeroDivisionError: by nothing"
    with pytest.raises(SweepError, match=said) as caught:
        swept(failing, POINTS, SEEDS, workers=PROCESSES)
    assert "in failing" in caught.value.__notes__[0]
    nothing_is_left()


def test_results_that_were_there_when_a_task_failed_are_kept(tmp_path):
    class Queue(ThreadPoolExecutor):
        def submit(self, *job):
            future = super().submit(*job)
            wait([future])
            return future

    jobs = [Job(2, SpotPoint(number=2), seed) for seed in SEEDS]
    with Queue() as pool, open_journal(tmp_path / "journal", {}) as log:
        with pytest.raises(SweepError, match="seed 1: ZeroDivisionError"):
            _run_jobs(pool, 2, failing, jobs, log)
        assert [seed for _, seed in log.finished] == [0, 2, 3, 4]


def test_a_worker_that_dies_is_one_sentence_and_the_next_sweep_continues(swept, tmp_path):
    points = [SpotPoint(number=number, folder=str(tmp_path)) for number in range(3)]
    with pytest.raises(SweepError, match=r"a worker ended .* run the sweep again to continue"):
        swept(dying, points, SEEDS, workers=PROCESSES)
    nothing_is_left()
    (tmp_path / "healed").touch()
    assert len(swept(dying, points, SEEDS)) == 18


def test_another_version_of_the_code_on_a_worker_is_refused(swept, monkeypatch):
    monkeypatch.setattr("sfglab.lab.sweep.run.code_digest", partial(next, count()))
    with pytest.raises(SweepError, match="another version of the code; install the same version"):
        swept(quick, POINTS, SEEDS)


def test_a_scheduler_without_the_extra_cluster_names_the_extra(swept, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    monkeypatch.setenv("SFGLAB_SCHEDULER", "tcp://127.0.0.1:9")
    with pytest.raises(MissingExtraError, match=r"'\.\[cluster\]'"):
        swept(quick, POINTS, SEEDS)


def runs(folder):
    """How often each point and seed was run to its end."""
    return Counter(tuple(map(int, path.name.split("-")[1:3])) for path in folder.glob("run-*"))


def obeying_points(folder):
    return [SpotPoint(number=number, folder=str(folder)) for number in range(6)]


def resumed(folder):
    """Run what is missing, once each, and nothing else."""
    journal = folder / "journal"
    lines = journal.read_bytes().splitlines(keepends=True)[1:]
    entries = [json.loads(line) for line in lines if line.endswith(b"\n")]
    finished = {(entry["point"], entry["seed"]) for entry in entries}
    before = runs(folder)
    found = sweep(obeying, obeying_points(folder), SEEDS, journal=journal, workers=THREADS)
    all_jobs = [(number, seed) for number in range(6) for seed in SEEDS]
    assert [(row["number"], row["seed"]) for row in found] == all_jobs
    assert finished
    assert runs(folder) - before == Counter({*all_jobs} - finished)
    nothing_is_left()


ELSEWHERE = """
import sys
from pathlib import Path
from test_sweep import PROCESSES, SEEDS, obeying, obeying_points, sweep, nothing_is_left
folder = Path(sys.argv[1])
try:
    sweep(obeying, obeying_points(folder), SEEDS, journal=folder / "journal", workers=PROCESSES)
except KeyboardInterrupt:
    nothing_is_left()
    print("interrupted")
"""


def sweep_elsewhere(folder, order):
    """Sweep in another process, in its own process group, until the order was carried out."""
    code_digest.cache_clear()  # the tree may have been edited since the tests began
    code_digest()
    (folder / "order").write_text(order)
    argv = [sys.executable, "-W", "error", "-c", ELSEWHERE, str(folder)]
    own = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    how = {"capture_output": True, "text": True, "timeout": 60, "start_new_session": True}
    return subprocess.run(argv, env=own, check=False, **how)


def test_ctrl_c_in_a_terminal_ends_a_sweep_quietly_with_all_its_processes(tmp_path):
    ended = sweep_elsewhere(tmp_path, "ctrl-c")
    assert ended.stdout == "interrupted\n", ended.stderr
    assert "Traceback" not in ended.stderr
    resumed(tmp_path)


def test_ctrl_c_while_processes_write_large_results_leaves_no_process(swept, on_step):
    def interrupted(*_):
        signal.raise_signal(signal.SIGINT)

    on_step(interrupted)
    with pytest.raises(KeyboardInterrupt):
        swept(large, POINTS, SEEDS, workers=PROCESSES)
    nothing_is_left()


@pytest.mark.parametrize("within", ["a script", "an event loop"])
def test_one_ctrl_c_is_heard_between_jobs_so_that_no_lock_of_the_pool_stays_closed(
    swept, on_step, within
):
    points = [SpotPoint(number=number) for number in range(200)]
    steps = []

    def interrupt_first(done, _line):
        if not steps:
            signal.raise_signal(signal.SIGINT)
        steps.append(done)

    async def in_a_loop():
        swept(uneven, points, SEEDS)

    on_step(interrupt_first)
    with pytest.raises(KeyboardInterrupt):
        asyncio.run(in_a_loop()) if within == "an event loop" else swept(uneven, points, SEEDS)
    assert 0 < len(steps) < len(points) * len(SEEDS)


@pytest.mark.slow
def test_a_killed_sweep_leaves_no_workers_and_is_continued(tmp_path):
    ended = sweep_elsewhere(tmp_path, "kill")
    assert ended.returncode == -9, ended.stderr
    worker = int((tmp_path / "pid").read_text())
    with suppress(psutil.NoSuchProcess):
        psutil.Process(worker).wait(timeout=60)
    assert not psutil.pid_exists(worker)
    with (tmp_path / "journal").open("a") as journal:
        journal.write('{"point": 5, "se')
    resumed(tmp_path)

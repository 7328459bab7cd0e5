"""The soak: what did not hold in a log is found; a short one runs in `tests/notebooks`, one of kills here."""

import json
import struct
import subprocess
import sys
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from made_logs import made_run

from sfglab.lab.experiments.reliability import (
    COMPONENTS,
    KINDS,
    deck,
    exp,
    problems,
    recoveries,
    slope,
)
from sfglab.lab.growth import growing
from sfglab.lab.workers import soaked
from sfglab.lab.workers.soaked import Stream

WAITS = """
import ctypes, time
libc, mutex, condition = ctypes.CDLL(None), ctypes.create_string_buffer(64), ctypes.create_string_buffer(64)
until, began_s = (ctypes.c_long * 2)(int(time.time()) + 2, 0), time.monotonic()
libc.pthread_mutex_lock(mutex)
assert libc.pthread_cond_timedwait(condition, mutex, until) == 110, "not timed out"
assert 0.5 < time.monotonic() - began_s < 50
"""
FAULT = {
    "kind": "kill",
    "component": "router",
    "agent": "go2",
    "recovered_s": 2.0,
    "recovered": True,
}
COUNT, STATE = (
    {"consumer": "pc", "name": name, "received": 9} for name in ("count of go2", "state of go2")
)


@pytest.mark.parametrize(
    ("changed", "found"),
    [
        ({}, []),
        ({"stream": [COUNT, STATE | {"repeated": 1, "disordered": 1}]}, []),
        ({"fault": [FAULT, FAULT | {"recovered_s": 10.1}]}, ["kill router of go2: 10.1 s"]),
        (
            {"fault": [FAULT | {"recovered": False, "slowest": "count"}]},
            ["kill router of go2: 2.0 s, count"],
        ),
        ({"stream": [COUNT | {"repeated": 1}]}, ["count of go2 at pc: 1 again, 0 late"]),
        ({"stream": [COUNT | {"disordered": 2}, STATE]}, ["count of go2 at pc: 0 again, 2 late"]),
        ({"stream": [COUNT | {"received": 0}]}, ["count of go2 at pc: 0 again"]),
        ({"left": [{"what": "process 7"}]}, ["left: process 7"]),
    ],
    ids=["whole", "latched", "late", "given up", "repeated", "disordered", "silent", "left"],
)
def test_what_did_not_hold_is_told(tmp_path, changed, found):
    tables = {"fault": [FAULT], "stream": [COUNT], "left": []} | changed
    run = made_run(exp, tmp_path / "a.mcap", tables)
    assert [said[: len(start)] for said, start in zip(problems(run), found, strict=True)] == found
    assert recoveries(run)["faults"].sum() == len(tables["fault"])


def test_growth_is_that_of_lives_whatever_each_began_with(tmp_path):
    lives = [(pid, 50.0 * pid, rate) for pid, rate in ((1, 9.0), (2, 10.0), (3, 11.0))]
    rows = [
        {
            "t_s": t_s,
            "agent": "go2",
            "who": "router",
            "pid": pid,
            "rss_mb": start + rate * t_s / 3600,
        }
        for pid, start, rate in lives
        for t_s in map(float, range(100 * pid, 100 * pid + 80, 2))
    ]
    run = made_run(exp, tmp_path / "a.mcap", {"process": rows})
    grown = slope(run, "rss_mb", "router")
    assert (grown.value, 8.9 < grown.low < 10 < grown.high < 11.1) == (pytest.approx(10), True)
    assert (slope(run, "descriptors").value, slope(run, "rss_mb", "decoder")) == (0, None)


@pytest.mark.parametrize(
    ("rate", "lasts_s", "told"), [(2.0, 900, []), (4.0, 900, ["router"]), (4.0, 300, [])]
)
def test_memory_is_flat_when_it_does_not_double_in_a_day_after_its_warm_up(rate, lasts_s, told):
    at_s = np.arange(0.0, lasts_s, 5)
    warming = 10 * np.minimum(at_s, 60) / 60
    rss_mb = 60 + warming + np.where(at_s // 20 % 2, 0.002, 0) + rate * at_s / 3600
    rows = pd.DataFrame({"t_s": at_s, "agent": "spot", "who": "router", "pid": 1, "rss_mb": rss_mb})
    said = list(growing(rows, warm_s=60))
    assert [sentence.split(":")[0] for sentence in said] == [f"memory of {who}" for who in told]


def test_each_round_of_faults_has_every_kind_and_component_and_a_seed_has_its_own_order():
    size = 2 * len(COMPONENTS) + len(KINDS) - 2
    first, again, other = (
        list(islice(deck(exp.config("smoke", seed=seed)), 2 * size)) for seed in (1, 1, 2)
    )
    assert (first == again, first == other, sorted(first[:size]) == sorted(first[size:])) == (
        True,
        False,
        True,
    )
    assert len(set(first)) == size
    assert {kind for kind, _ in first} == set(KINDS)


def test_a_stream_counts_what_came_again_and_late_and_tells_what_was_sent_after_a_mark():
    told = []
    stream = Stream("count", told.append)
    for number in (1, 2, 2, 1, 3):
        stream.note(number, number * 10)
    stream.mark(7, 40)
    for number in (3, 4, 5):
        stream.note(number, number * 10)
    assert (stream.received, stream.repeated, stream.disordered) == (8, 2, 1)
    *wrong, fresh = told
    assert {said["is"] for said in wrong} == {"wrong"}
    assert [(said["number"], said["last"]) for said in wrong] == [(2, 2), (1, 2), (3, 3)]
    assert (fresh["is"], fresh["mark"], fresh["stream"]) == ("fresh", 7, "count")


@pytest.mark.parametrize("step_s", [0, 10**8, -(10**8)])
def test_a_stepped_clock_moves_the_time_of_day_and_neither_steady_time_nor_waits(tmp_path, step_s):
    source, shim = Path(soaked.__file__).with_name("stepped_clock.c"), tmp_path / "clock.so"
    subprocess.run(
        ["cc", "-Wall", "-Werror", "-shared", "-fPIC", "-o", shim, source, "-ldl"], check=True
    )
    (tmp_path / "step").write_bytes(struct.pack("l", step_s).ljust(4096, b"\0"))
    looks = "import time, json; print(json.dumps([time.time(), time.monotonic()]))"
    environment = {"LD_PRELOAD": str(shim), "SFGLAB_SOAK_CLOCK": str(tmp_path / "step")}
    look = partial(subprocess.run, [sys.executable, "-c", looks], capture_output=True, check=True)
    (day, steady), (own_day, own_steady) = (
        json.loads(look(env=env).stdout) for env in ({}, environment)
    )
    assert (own_day - day - step_s, own_steady - steady) == (pytest.approx(0, abs=60),) * 2
    subprocess.run([sys.executable, "-c", WAITS], env=environment, timeout=60, check=True)

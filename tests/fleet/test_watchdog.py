"""Processes that hang are ended and started anew; those that only get no processor are not."""

import asyncio
import os
import signal
import sys
from contextlib import ExitStack, contextmanager

import pytest
from test_agent_supervisor import SERVES, component, running
from waiting import program

from sfglab.fleet.agent.supervision import Component, State
from sfglab.processes import HANG_S, Watchdog

HANGS = """
import asyncio, sys, time
from sfglab.component import run_component
async def serve(config, report, orders):
    report({"is": "ready"})
    await asyncio.sleep(0.1)
    if config == "hangs":
        time.sleep(1000)
    await asyncio.sleep(1000)
run_component(str, serve)
"""


NONE = f"no watchdog beat for {HANG_S:g} s"


@pytest.mark.parametrize(
    ("beats", "states", "cpu_s", "hangs"),
    [
        ({*range(60)}, "S" * 60, 0.01, ""),
        ({0}, "R" * 60, 0.02, ""),
        ({0, 9}, "S" * 18, 0.0, ""),
        ({0, 10, 20}, "S" * 30, 0.0, ""),
        ({0}, "Dt" * 10, 0.0, ""),
        ({}, "S" * 60, 0.0, ""),
        ({0}, "S" * 20, 0.0, NONE),
        ({0}, "R" * 100, 0.25, NONE),
        ({0, 1}, "SSTTT", 0.0, "stopped"),
    ],
    ids=[
        "idle",
        "starved",
        "late",
        "on its way",
        "disk",
        "never beat",
        "deadlock",
        "slow loop",
        "stopped",
    ],
)
def test_only_who_could_have_beaten_and_did_not_hangs(beats, states, cpu_s, hangs):
    watchdog, why = Watchdog(), ""
    for number, state in enumerate(states):
        if number in beats:
            watchdog.beat()
        why = why or watchdog.check_state(state, number * cpu_s)
    assert (hangs in why, bool(why)) == (True, bool(hangs))


@pytest.mark.live
async def test_a_component_that_is_stopped_is_started_anew_and_the_agent_says_so():
    async with running(component("one", SERVES), component("two", SERVES)) as watched:
        pids = [await watched.pid(name) for name in ("one", "two")]
        os.kill(pids[0], signal.SIGSTOP)
        assert await watched.pid("one", 2) != pids[0]
        (back,) = watched.changes("one", State.BACKING_OFF)
        assert back["why"] == "it was stopped"
        assert watched.states("two") == [State.STARTING, State.RUNNING]


@pytest.mark.live
async def test_a_component_whose_loop_hangs_is_started_anew_and_one_that_beats_is_not(monkeypatch):
    monkeypatch.setattr("sfglab.processes.HANG_S", 2.0)
    argv = (sys.executable, "-c", HANGS)
    parts = [Component(name=name, argv=(*argv, f'"{name}"')) for name in ("hangs", "beats")]
    async with running(*parts) as watched:
        await watched.pid("hangs", 2)
        assert watched.states("beats") == [State.STARTING, State.RUNNING]
        (why,) = {change["why"] for change in watched.changes("hangs", State.BACKING_OFF)}
        assert "no watchdog beat" in why


@contextmanager
def two_endless_loops_a_core():
    with ExitStack() as loops:
        for core in sorted(os.sched_getaffinity(0)) * 2:
            loop = loops.enter_context(program(sys.executable, "-S", "-c", "while True: pass"))
            os.sched_setaffinity(loop.pid, {core})
        yield


@pytest.mark.live
async def test_under_two_endless_loops_a_core_nobody_is_restarted_who_beats_when_it_may(
    monkeypatch,
):
    monkeypatch.setattr("sfglab.processes.HANG_S", 3.0)
    parts = [
        Component(name=f"n{n}", argv=(sys.executable, "-c", HANGS, '"beats"')) for n in range(4)
    ]
    with two_endless_loops_a_core():
        async with running(*parts) as watched:
            for part in parts:
                await watched.pid(part.name)
            await asyncio.sleep(
                12
            )  # four times as long as one may be silent that could have beaten
            assert [watched.states(part.name) for part in parts] == [
                [State.STARTING, State.RUNNING]
            ] * 4

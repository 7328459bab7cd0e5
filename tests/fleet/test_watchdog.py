"""Unresponsive processes are ended and restarted; processes that only wait for a core are not."""

import os
import signal
import sys

import pytest
from test_agent_supervisor import running

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
@pytest.mark.parametrize(
    ("hangs", "said"), [("hangs", "no watchdog beat"), ("stopped", "it was stopped")]
)
async def test_a_component_that_hangs_or_is_stopped_is_started_anew_and_one_that_beats_is_not(
    monkeypatch, hangs, said
):
    monkeypatch.setattr("sfglab.processes.HANG_S", 2.0)
    argv = (sys.executable, "-c", HANGS)
    parts = [Component(name=name, argv=(*argv, f'"{name}"')) for name in (hangs, "beats")]
    async with running(*parts) as watched:
        pid = await watched.pid(hangs)
        if hangs == "stopped":
            os.kill(pid, signal.SIGSTOP)
        assert await watched.pid(hangs, 2) != pid
        assert watched.states("beats") == [State.STARTING, State.RUNNING]
        (why,) = {change["why"] for change in watched.changes(hangs, State.BACKING_OFF)}
        assert said in why

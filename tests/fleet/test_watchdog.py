"""Processes that hang are ended and started anew; those that only get no processor are not."""

import os
import signal
import sys

import pytest
from test_agent_supervisor import component, running

from sfglab.fleet.agent.supervision import Component, State
from sfglab.processes import HANG_S, HangWatch

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


def looks(beats: str, states: str, cpu_s: float) -> list[str]:
    """What a watch says, look by look: "!" is a beat before it; cpu_s is what it gets a look."""
    watch = HangWatch()
    return [
        (watch.beat() if beat == "!" else None) or watch.judge(state, number * cpu_s)
        for number, (beat, state) in enumerate(zip(beats, states, strict=True), 1)
    ]


@pytest.mark.parametrize(
    ("beats", "states", "cpu_s", "hangs"),
    [
        ("!" * 60, "S" * 60, 0.01, ""),
        ("!" * 60, "R" * 60, 1.0, ""),
        ("!" + " " * 59, "R" * 60, 0.0, ""),
        ("!" + " " * 59, "R" * 60, 0.02, ""),
        ("!" + " " * 8 + "!" + " " * 8, "S" * 18, 0.0, ""),
        ("!" + " " * 19, "D" * 20, 0.0, ""),
        (" " * 60, "S" * 60, 0.0, ""),
        ("!" + " " * 19, "S" * 20, 0.0, f"no sign of life for {HANG_S:g}"),
        ("!" + " " * 19, "R" * 20, 1.0, f"no sign of life for {HANG_S:g}"),
        ("!" + " " * 99, "R" * 100, 0.25, f"no sign of life for {HANG_S:g}"),
        (" " * 3, "T" * 3, 0.0, "stopped"),
        ("!" * 2 + " " * 3, "SSTTT", 0.0, "stopped"),
    ],
)
def test_only_who_could_have_beaten_and_did_not_hangs(beats, states, cpu_s, hangs):
    said = looks(beats, states, cpu_s)
    assert any(hangs in one for one in said if one) == bool(hangs)
    assert hangs or not any(said)


@pytest.mark.live
async def test_a_component_that_is_stopped_is_started_anew_and_the_agent_says_so():
    serves = 'import sys; print(\'{"is": "ready"}\', flush=True); sys.stdin.read()'
    async with running(component("one", serves), component("two", serves)) as watched:
        pids = [await watched.pid(name) for name in ("one", "two")]
        os.kill(pids[0], signal.SIGSTOP)
        assert await watched.pid("one", 2) != pids[0]
        (back,) = [change for change in watched.changes("one") if change.state is State.BACKING_OFF]
        assert back.why == "it was stopped"
        assert watched.states("two") == [State.STARTING, State.RUNNING]


@pytest.mark.live
async def test_a_component_whose_loop_hangs_is_started_anew_and_one_that_beats_is_not(monkeypatch):
    monkeypatch.setattr("sfglab.processes.HANG_S", 2.0)
    parts = [
        Component(name=name, argv=(sys.executable, "-c", HANGS, f'"{name}"')) for name in ("hangs", "beats")
    ]
    async with running(*parts) as watched:
        await watched.pid("hangs", 2)
        assert watched.states("beats") == [State.STARTING, State.RUNNING]
        (why,) = {change.why for change in watched.changes("hangs") if change.state is State.BACKING_OFF}
        assert "no sign of life" in why

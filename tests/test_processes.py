"""Processes: orders and reports, failures in clear sentences, groups that begin and end as a whole."""

import asyncio
import json
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from toy_component import ToyConfig
from waiting import program

from sfglab.processes import LineProcess, Member, ProcessFailedError, ProcessGroup

S = 30.0


def on_host(_host: str, command: tuple[str, ...]) -> list[str]:
    """Run a command where the toy can be imported."""
    path = os.pathsep.join((str(Path(__file__).parent), *sys.path))
    return ["env", f"PYTHONPATH={path}", *command]


def toy(name: str, **config: object) -> Member:
    return Member(name=name, module="toy_component", config=ToyConfig(**config))


def gone(pid: int) -> bool:
    return not Path(f"/proc/{pid}").exists()


def grouped(*members: Member, **options):
    return ProcessGroup(members, wrap_command=on_host, **options)


async def test_a_group_asks_its_members_hears_every_report_and_ends_them(tmp_path):
    heard: list[tuple[str, str]] = []
    farewell = str(tmp_path / "farewell")
    members = (
        toy("a", number=1, pairs=(("x", 2),), farewell=farewell),
        replace(toy("b", number=2, begins="here", farewell=farewell), ready="here"),
    )
    async with grouped(*members, on_report=lambda *heard_of: heard.append(heard_of)) as group:
        assert group["a"].readiness == {"is": "ready", "number": 1, "pairs": [["x", 2]]}
        first = await group.ask("counted", timeout_s=S, do="count", to=3)
        second = await group.ask("echo", ["b"], timeout_s=S, do="echo", pairs=((1, 2),))
        pids = [group[name].pid for name in group]
    assert first == {"a": {"is": "counted"}, "b": {"is": "counted"}}
    assert second == {"b": {"is": "echo", "order": {"do": "echo", "pairs": [[1, 2]]}}}
    kinds = [report["is"] for name, report in heard if name == "b"]
    assert kinds == ["here", *["count"] * 3, "counted", "echo", "ended"]
    assert all(map(gone, pids))
    assert sorted((tmp_path / "farewell").read_text().split()) == ["1", "2"]


@pytest.mark.parametrize(
    ("begins", "message"),
    [("broken", "b: broken as told"), ("late", "not report 'ready' within 1 s")],
)
async def test_a_failed_start_is_named_and_leaves_nobody(begins, message):
    group = ProcessGroup(wrap_command=on_host, start_s=1.0 if begins == "late" else S)
    with pytest.raises(ProcessFailedError, match=message):
        await group.start(toy("a"), toy("b", begins=begins))
    assert list(group) == []


async def test_members_can_be_killed_and_added_midway():
    async with grouped(toy("a"), toy("b")) as group:
        before = group["a"].pid
        await group.kill("a")
        await group.start(toy("a"))
        assert gone(before)
        assert set(await group.ask("counted", timeout_s=S, do="count", to=0)) == {"a", "b"}


@pytest.mark.parametrize(
    ("do", "message"),
    [
        ("die", "a killed by a signal; a: it ended with status -9"),
        ("fail", "a: failed as told"),
        ("exit", "a: it ended with status 7"),
        ("babble", "a killed by a signal; a: given .*, which is no report"),
        ("nothing", "a: it did not report 'counted' within 1 s"),
    ],
)
async def test_who_fails_is_named_with_the_reason(do, message):
    async with grouped(toy("a"), toy("b")) as group:
        with pytest.raises(ProcessFailedError, match=f"^{message}$"):
            await group.ask("counted", ["a"], timeout_s=1.0 if do == "nothing" else S, do=do)
        if do != "nothing":
            with pytest.raises(ProcessFailedError):
                group.check()
        await group.ask("counted", ["b"], timeout_s=S, do="count", to=0)


async def test_a_cancelled_group_leaves_nobody():
    with pytest.raises(TimeoutError):  # noqa: PT012 - the block is what is tested
        async with asyncio.timeout(None) as limit, grouped(toy("a"), toy("b")) as group:
            pids = [group[name].pid for name in group]
            limit.reschedule(0)  # the group is left by a cancellation
            await asyncio.sleep(S)
    assert all(map(gone, pids))


async def test_a_process_that_does_not_end_is_ended_by_force():
    process = await LineProcess.start("a", on_host("", toy("a", deaf=True).command))
    await process.expect("ready", timeout_s=S)
    await process.close(grace_s=0.2)
    assert process.status == -signal.SIGKILL


async def test_an_error_of_who_listens_is_raised_when_the_process_is_closed():
    def deafen(_name, report):
        if report["is"] == "count":
            raise RuntimeError("not prepared for this")

    group = await grouped(toy("a"), on_report=deafen).__aenter__()
    with pytest.raises(ProcessFailedError, match="a killed by a signal"):
        await group.ask("counted", timeout_s=S, do="count", to=1)
    with pytest.raises(RuntimeError, match="not prepared"):
        await group.__aexit__(None, None, None)


def component(**config: object):
    argv = on_host("", toy("a", **config).command)
    return program(*argv, stdin=subprocess.PIPE, stderr=subprocess.PIPE)


@pytest.mark.parametrize("told", ["signal", "input"])
@pytest.mark.parametrize(("deaf", "status"), [(False, 0), (True, -signal.SIGALRM)])
def test_a_component_cleans_up_when_told_but_not_for_ever(told, deaf, status, tmp_path):
    with component(deaf=deaf, number=3, farewell=str(tmp_path / "farewell")) as process:
        assert json.loads(process.stdout.readline())["is"] == "ready"
        process.send_signal(signal.SIGINT)  # the terminal's interrupt is for its starter
        if told == "signal":
            process.terminate()
        out, err = process.communicate(timeout=S)
        assert (out, process.returncode) == ("", status)
        assert "noise of a library" in err, "what is printed is no report"
    assert (tmp_path / "farewell").read_text() == "3\n"


def test_a_refusal_is_one_sentence_and_an_order_that_is_none_is_said_aloud():
    with component(begins="broken") as process:
        out, err = process.communicate(timeout=S)
        assert json.loads(out) == {"is": "failed", "why": "broken as told"}
        assert (err, process.returncode) == ("", 1)
    with component() as process:
        process.stdout.readline()
        _, err = process.communicate("not json\n", timeout=S)
        assert "JSONDecodeError" in err
        assert process.returncode == 1

"""A component as a process: it reports, and it ends when it is told to, when its input ends, and in time."""

from __future__ import annotations

import json
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest

pytestmark = [pytest.mark.live]

DEADLINE_S = 60
PREAMBLE = """
import asyncio
from sfglab.errors import SfglabError
from sfglab.fleet import component
component.END_LIMIT_S = 1
"""
SERVES = """
async def body(report):
    report({"is": "ready"})
    try:
        await asyncio.Event().wait()
    finally:
        report({"is": "released"})
component.run_component(body, on_order=lambda order: print(order, flush=True))
"""
HANGS = """
import time
async def body(report):
    report({"is": "ready"})
    try:
        await asyncio.Event().wait()
    finally:
        time.sleep(1000)
component.run_component(body)
"""
REFUSES = """
async def body(report):
    raise SfglabError("domain: given 400, allowed are 0 to 232")
component.run_component(body)
"""


@contextmanager
def running(code: str):
    with subprocess.Popen(
        [sys.executable, "-W", "error", "-c", PREAMBLE + code],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def test_it_releases_what_it_holds_when_its_input_ends():
    with running(SERVES) as process:
        assert json.loads(process.stdout.readline()) == {"is": "ready"}
        out, err = process.communicate(timeout=DEADLINE_S)
        assert (json.loads(out), err, process.returncode) == ({"is": "released"}, "", 0)


def test_it_releases_what_it_holds_when_it_is_terminated():
    with running(SERVES) as process:
        process.stdout.readline()
        process.send_signal(signal.SIGINT)  # the terminal's interrupt is for whoever started it
        process.terminate()
        assert json.loads(process.stdout.readline()) == {"is": "released"}
        assert process.wait(DEADLINE_S) == 0


def test_what_is_printed_is_no_report():
    with running(SERVES) as process:
        process.stdout.readline()
        process.stdin.write('{"do": "something"}\n')
        process.stdin.flush()
        assert process.stderr.readline() == "{'do': 'something'}\n"


@pytest.mark.parametrize("how", ["input ends", "terminated"])
def test_a_clean_up_that_hangs_is_cut_short(how):
    with running(HANGS) as process:
        process.stdout.readline()
        if how == "terminated":
            process.terminate()
        else:
            process.stdin.close()
        assert process.wait(DEADLINE_S) == -signal.SIGALRM


def test_a_refusal_is_one_sentence_and_status_1():
    with running(REFUSES) as process:
        out, err = process.communicate(timeout=DEADLINE_S)
        assert json.loads(out) == {"is": "failed", "why": "domain: given 400, allowed are 0 to 232"}
        assert (err, process.returncode) == ("", 1)


def test_an_order_that_is_none_is_said_aloud():
    with running(SERVES) as process:
        process.stdout.readline()
        out, err = process.communicate("not json\n", timeout=DEADLINE_S)
        assert json.loads(out) == {"is": "released"}
        assert "JSONDecodeError" in err
        assert process.returncode == 1

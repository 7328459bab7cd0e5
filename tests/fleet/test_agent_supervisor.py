"""The supervisor with real processes: restarted and reported when they crash, none left when it ends."""

import asyncio
import os
import signal
import sys
from contextlib import asynccontextmanager, suppress

import psutil
import pytest
from waiting import DEADLINE_S, lives, program, until, wait_until

from sfglab.component import beside
from sfglab.fleet.agent import app
from sfglab.fleet.agent.plan import AgentConfig
from sfglab.fleet.agent.supervision import Component, State
from sfglab.fleet.router.config import RouterConfig
from sfglab.machine import ProcessTiming

pytestmark = [pytest.mark.live]

TIMING = ProcessTiming(
    start_ns=10**10, stop_ns=300_000_000, backoff_ns=20_000_000, backoff_max_ns=80_000_000
)

SERVES = """
import sys
print('a banner')
print('{"is": "ready"}', flush=True)
sys.stdin.read()
"""
STUBBORN = """
import signal, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
print('{"is": "ready"}', flush=True)
time.sleep(1000)
"""
REFUSES = """
import sys
print('{"is": "failed", "why": "network interface: given \\'wlan7\\', allowed are eth0, lo"}', flush=True)
sys.exit(1)
"""
# Its child shares standard error, ignores every polite signal and reads nothing.
PARENT = """
import json, subprocess, sys
child = subprocess.Popen([sys.executable, "-S", "-c", '''
import signal, time
signal.signal(signal.SIGTERM, signal.SIG_IGN)
time.sleep(1000)
'''], stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
print(json.dumps({"is": "child", "pid": child.pid}), flush=True)
print('{"is": "ready"}', flush=True)
sys.stdin.read()
"""


def component(name, code, *arguments):
    return Component(name=name, argv=(sys.executable, "-S", "-c", code, *arguments))


class Watched:
    """A running agent and its reports."""

    def __init__(self, *components, timing=TIMING):
        self.reports = []
        self.agent = app.Agent(components, timing=timing, on_report=self.reports.append)

    def changes(self, name, state=None):
        """Return the changes of a component, or those to a state."""
        changes = [r for r in self.reports if r["is"] == "component" and r["component"] == name]
        return [r for r in changes if state is None or State[r["state"].upper()] is state]

    def states(self, name):
        return [State[change["state"].upper()] for change in self.changes(name)]

    async def pid(self, name, starts=1):
        """Return the process of the given start, once it serves."""
        await until(lambda: self.states(name).count(State.RUNNING) >= starts)
        return self.changes(name, State.RUNNING)[-1]["pid"]


@asynccontextmanager
async def running(*components, **options):
    """Run an agent of components, and end it in order."""
    watched = Watched(*components, **options)
    async with beside(watched.agent.run()) as (watched.task,):
        yield watched
        watched.agent.stop()
        await asyncio.wait_for(watched.task, DEADLINE_S)


async def test_a_killed_component_is_restarted_with_back_off_and_the_others_stay():
    async with running(component("router", SERVES), component("status", SERVES)) as watched:
        other = await watched.pid("status")
        for kills in range(1, 4):
            os.kill(await watched.pid("router", starts=kills), signal.SIGKILL)
        await watched.pid("router", starts=4)
        assert watched.reports.count({"is": "ready"}) == 1
        banner = {"is": "line", "component": "status", "line": "a banner"}
        assert banner in watched.reports, "a line that is no report ends nothing"
        crashed = watched.changes("router", State.BACKING_OFF)
        assert [change["why"] for change in crashed] == ["killed by SIGKILL"] * 3
        assert [change["crashes"] for change in crashed] == [1, 2, 3]
        assert [round(change["retry_s"], 2) for change in crashed] == [0.02, 0.04, 0.08]
        assert watched.states("status") == [State.STARTING, State.RUNNING]
        assert lives(other)
    assert watched.states("router")[-2:] == [State.STOPPING, State.STOPPED]


async def test_a_refused_configuration_or_one_that_dies_on_import_ends_the_agent_in_its_words():
    watched = Watched(component("status", SERVES), component("router", REFUSES))
    with pytest.raises(app.ComponentError) as caught:
        await watched.agent.run()
    assert str(caught.value) == "router: network interface: given 'wlan7', allowed are eth0, lo"
    assert watched.states("router") == [State.STARTING, State.FAILED]
    assert watched.states("status")[-1] is State.STOPPED
    failed = watched.changes("router", State.FAILED)[0]
    stopping = watched.changes("status", State.STOPPING)[0]
    assert watched.reports.index(failed) < watched.reports.index(stopping), "the cause comes first"
    watched = Watched(component("router", "import no_such_module"))
    with pytest.raises(app.ComponentError, match="router: it ended with status 1"):
        await watched.agent.run()
    lines = [report["line"] for report in watched.reports if report["is"] == "line"]
    assert "ModuleNotFoundError: No module named 'no_such_module'" in lines


async def test_one_that_ignores_the_order_to_end_is_ended_by_force_in_time_or_told_twice_at_once():
    async with running(component("router", STUBBORN)) as watched:
        pid = await watched.pid("router")
    assert not lives(pid)
    never = ProcessTiming(stop_ns=10**15)
    async with running(component("router", STUBBORN), timing=never) as watched:
        pid = await watched.pid("router")
        watched.agent.stop()
    assert not lives(pid)


@pytest.mark.parametrize("how", ["killed", "stopped", "cancelled"])
async def test_what_a_component_has_started_ends_with_it(how):
    async with beside((watched := Watched(component("decoder", PARENT))).agent.run()) as (task,):
        pid = await watched.pid("decoder")
        assert lives(pid)
        if how == "killed":
            os.kill(pid, signal.SIGKILL)
            await watched.pid("decoder", starts=2)
        if how == "cancelled":
            task.cancel()
        watched.agent.stop()
        with suppress(asyncio.CancelledError):
            await task
    assert task.cancelled() == (how == "cancelled")
    reports = [report["report"] for report in watched.reports if report["is"] == "report"]
    children = [report["pid"] for report in reports if report["is"] == "child"]
    assert children
    # Its pipe has ended, so it is about to be gone, if it is not yet.
    await until(lambda: not any(map(lives, children)))


TERMINAL = """
import sys
from sfglab.bus.address import BusAddress
from sfglab.fleet.agent.app import serve_agent
from sfglab.fleet.agent.plan import AgentConfig
from sfglab.fleet.router.config import RouterConfig
from sfglab.component import run
local, remote = (BusAddress(domain_id=int(domain), interface="lo") for domain in sys.argv[1:])
router = RouterConfig(agent="go2", local=local, remote=remote)
config = AgentConfig(router=router, components=("router",))
run(serve_agent(config, lambda line: print(line, flush=True)))
"""


@pytest.mark.parametrize(
    ("signals", "last", "status"),
    [
        ([signal.SIGINT] * 2, "agent go2: everything has ended\n", 0),
        ([signal.SIGTERM], "agent go2: everything has ended\n", 0),
        ([signal.SIGKILL], "", -signal.SIGKILL),
    ],
    ids=["two interrupts", "terminated", "killed"],
)
def test_components_end_with_their_agent_and_a_second_agent_on_its_domains_is_refused(
    domains, signals, last, status
):
    remote, local = domains
    numbers = (f"{address.domain_id}" for address in (local, remote))
    router = RouterConfig(agent="go2", local=local, remote=remote)
    said, config = [], AgentConfig(router=router, components=("router",))
    with program(sys.executable, "-c", TERMINAL, *numbers) as process:
        lines = [process.stdout.readline() for _ in range(3)]
        assert lines[1:] == ["router: ready\n", "agent go2: ready, end it with Ctrl-C\n"]
        with pytest.raises(app.ComponentError, match=f"^router of domain {local.domain_id}: proc"):
            asyncio.run(app.serve_agent(config, said.append))
        assert [f"{line}\n" for line in said] == lines[:1]
        (router,) = psutil.Process(process.pid).children()
        for number in signals:
            process.send_signal(number)
        assert process.stdout.read() == last
        assert process.wait(DEADLINE_S) == status
        wait_until(lambda: not lives(router.pid))

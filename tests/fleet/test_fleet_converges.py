"""Whole agents lose their processes one after the other, converge again, and end without trace."""

import asyncio
import os
import signal
from collections import defaultdict

import psutil
import pytest
from waiting import lives, until

from sfglab.bus.address import BusAddress
from sfglab.fleet.agent.app import SupervisorConfig
from sfglab.fleet.agent.plan import AgentConfig, plan
from sfglab.fleet.discovery.config import Timing as DiscoveryTiming
from sfglab.fleet.router.config import RouterConfig
from sfglab.fleet.status.heartbeat import Schedule
from sfglab.lab.testbed import Testbed
from sfglab.machine import ProcessTiming
from sfglab.processes import Member, ProcessGroup

pytestmark = [pytest.mark.live, pytest.mark.slow]

AGENTS = {
    "go2": ("router", "status", "discoverer"),
    "station": ("router", "status", "discoverer", "decoder"),
}
# Short, yet a process that starves on a busy machine for a second is not taken for lost.
SCHEDULE = Schedule(startup_period_s=0.4, steady_period_s=0.4, startup_s=0)
DISCOVERY = DiscoveryTiming(
    missed=3, slack_ns=600_000_000, backoff_ns=100_000_000, backoff_max_ns=500_000_000
)
SUPERVISION = ProcessTiming(backoff_ns=50_000_000, backoff_max_ns=400_000_000)
SILENCE_S = 3 * 0.4 + 0.6


def agent(testbed: Testbed, name: str, remote: int, local: int) -> Member:
    router = RouterConfig(
        agent=name,
        local=BusAddress(domain_id=local, interface="lo"),
        remote=BusAddress(domain_id=remote, interface=testbed.interface(name)),
        advertise_unused_topics=True,
    )
    config = AgentConfig(
        router=router,
        components=AGENTS[name],
        schedule=SCHEDULE,
        discovery=DISCOVERY,
        detect=False,
    )
    told = SupervisorConfig(components=plan(config), timing=SUPERVISION)
    return Member(name=name, host=name, module="sfglab.fleet.agent.app", config=told)


async def test_components_that_are_killed_come_back_and_the_fleet_converges_and_ends(free_domains):
    remote, *locals_ = free_domains(3)
    reports = defaultdict(list)

    def component(name: str, component_name: str) -> dict:
        """Return the last change of a component."""
        changes = [r for r in reports[name] if r["is"] == "component"]
        mine = [r for r in changes if r["component"] == component_name]
        return mine[-1] if mine else {"state": ""}

    def events(name: str, since: int = 0) -> list[str]:
        """Return what the discoverer has told of the other agent."""
        told = (r["report"] for r in reports[name][since:] if r["is"] == "report")
        return [r["event"] for r in told if r["is"] == "event"]

    def is_together() -> bool:
        """Return whether all serve and know each other."""
        return all(
            {component(name, each)["state"] for each in parts} == {"running"}
            and (events(name) or ["LOST"])[-1] != "LOST"
            for name, parts in AGENTS.items()
        )

    with Testbed(*AGENTS) as testbed:
        members = [
            agent(testbed, name, remote, local) for name, local in zip(AGENTS, locals_, strict=True)
        ]
        group = ProcessGroup(
            members,
            wrap_command=testbed.argv,
            on_report=lambda name, report: reports[name].append(report),
        )
        seen = set()
        async with group:
            for name, part in (
                ("go2", "router"),
                ("go2", "status"),
                ("station", "discoverer"),
                ("station", "decoder"),
            ):
                witness = "station" if name == "go2" else "go2"
                victim = psutil.Process(group[name].pid)
                await until(is_together, every_s=0.05)
                known, mark = component(name, part), len(reports[witness])
                family = {victim.pid, *(p.pid for p in victim.children(recursive=True))}
                seen |= family
                os.kill(known["pid"], signal.SIGKILL)
                await until(lambda n=name, p=part, k=known: component(n, p) != k)
                await until(is_together, every_s=0.05)
                await asyncio.sleep(SILENCE_S)  # for as long as silence could go unnoticed
                await until(is_together, every_s=0.05)
                assert component(name, part)["crashes"] == 1
                size = len(family) - 1
                await until(lambda v=victim, s=size: len(v.children(recursive=True)) == s)
                heard = events(witness, mark)
                if part == "status":
                    assert "RESTARTED" in heard
                else:
                    assert heard == [] or (part, heard) == ("router", ["LOST", "RETURNED"])
            agents = [group[name] for name in AGENTS]
        assert [await process.wait() for process in agents] == [0, 0]
        await until(lambda: not any(map(lives, seen)))

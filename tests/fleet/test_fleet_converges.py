"""Whole agents lose their processes one after the other, converge again, and end without trace."""

import asyncio
import os
import signal
import sys

import psutil
import pytest
from waiting import DEADLINE_S, lives, until

from sfglab.bus.address import BusAddress
from sfglab.component import argument_of
from sfglab.fleet.agent.app import SupervisorConfig
from sfglab.fleet.agent.plan import AgentConfig, plan
from sfglab.fleet.discovery.config import Timing as DiscoveryTiming
from sfglab.fleet.router.config import RouterConfig
from sfglab.fleet.status.heartbeat import Schedule
from sfglab.lab.testbed import Testbed
from sfglab.machine import ProcessTiming
from sfglab.processes import LineProcess

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


class Agent(LineProcess):
    """A supervisor as it is seen from outside: by its reports."""

    buffers_reports = False

    @classmethod
    async def begin(cls, testbed: Testbed, name: str, remote: int, local: int):
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
        told = argument_of(SupervisorConfig(components=plan(config), timing=SUPERVISION))
        argv = testbed.argv(name, [sys.executable, "-m", "sfglab.fleet.agent.app", told])
        agent = await cls.start(name, argv)
        agent.reports = []
        agent.on_report = agent.reports.append
        return agent

    def family(self) -> set[int]:
        """Return the pids of the process and all below it."""
        return {self.pid, *(p.pid for p in psutil.Process(self.pid).children(recursive=True))}

    def component(self, name: str) -> dict:
        """Return the last change of a component."""
        mine = (r for r in reversed(self.reports) if r.get("component") == name)
        return next((r for r in mine if r["is"] == "component"), {"state": ""})

    def events(self, since: int = 0) -> list[str]:
        """Return what the discoverer has told of the other agent."""
        told = (r["report"] for r in self.reports[since:] if r["is"] == "report")
        return [r["event"] for r in told if r["is"] == "event"]


async def test_components_that_are_killed_come_back_and_the_fleet_converges_and_ends(free_domains):
    remote, *locals_ = free_domains(3)
    with Testbed(*AGENTS) as testbed:
        places = zip(AGENTS, locals_, strict=True)
        agents = {name: await Agent.begin(testbed, name, remote, local) for name, local in places}

        def is_together() -> bool:
            """Return whether all serve and know each other."""
            return all(
                {agent.component(component)["state"] for component in AGENTS[name]} == {"running"}
                and (agent.events() or ["LOST"])[-1] != "LOST"
                for name, agent in agents.items()
            )

        seen = set()
        try:
            for name, component in (
                ("go2", "router"),
                ("go2", "status"),
                ("station", "discoverer"),
                ("station", "decoder"),
            ):
                victim, witness = agents[name], agents[(*{*AGENTS} - {name},)[0]]
                await until(is_together, every_s=0.05)
                known, mark, family = (
                    victim.component(component),
                    len(witness.reports),
                    victim.family(),
                )
                seen |= family
                os.kill(known["pid"], signal.SIGKILL)
                await until(lambda v=victim, c=component, k=known: v.component(c) != k)
                await until(is_together, every_s=0.05)
                await asyncio.sleep(SILENCE_S)  # for as long as silence could go unnoticed
                await until(is_together, every_s=0.05)
                assert victim.component(component)["crashes"] == 1
                await until(lambda v=victim, f=family: len(v.family()) == len(f), every_s=0.05)
                heard = witness.events(mark)
                if component == "status":
                    assert "RESTARTED" in heard
                else:
                    assert heard == [] or (component, heard) == ("router", ["LOST", "RETURNED"])
        finally:
            for agent in agents.values():
                await agent.close(grace_s=DEADLINE_S)
        assert [agent.status for agent in agents.values()] == [0, 0]
        await until(lambda: not any(map(lives, seen)))

"""An agent of a fleet as a process: `sfglab agent up`, or ``python -m sfglab.fleet.agent CONFIG``.

The second form is for programs: it is a component as its own components are (see `component`), and reports
``ready`` once all of them have served, ``{"is": "component", "component", "state", "pid", "crashes", "why",
"retry_s"}`` for every change of one, ``{"is": "report", "component", "report"}`` for what one reports, and
``{"is": "line", "component", "line"}`` for what one writes on standard error.
"""

from __future__ import annotations

import asyncio
import json
import signal
from dataclasses import asdict, dataclass, field
from typing import TYPE_CHECKING

from sfglab.fleet.agent.events import report_from_event
from sfglab.fleet.agent.narrator import Narrator
from sfglab.fleet.agent.plan import Component, plan
from sfglab.fleet.agent.supervision import Timing
from sfglab.fleet.agent.supervisor import Agent
from sfglab.fleet.component import run_component

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.fleet.agent.events import AgentEvent
    from sfglab.fleet.agent.plan import AgentConfig
    from sfglab.fleet.component import Report


@dataclass(frozen=True, slots=True, kw_only=True)
class SupervisorConfig:
    """What an agent's process is told: the result of `plan`."""

    components: tuple[Component, ...]  #: The processes to run.
    timing: Timing = field(default_factory=Timing)  #: The waits of every component.

    @classmethod
    def of_agent(cls, config: AgentConfig) -> SupervisorConfig:
        """Return what the process of an agent is told.

        Raises:
            SfglabError: The agent could not be run as it is described.
        """
        return cls(components=plan(config), timing=config.supervision)

    def to_json(self) -> str:
        """Return the configuration as a process's argument."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> SupervisorConfig:
        """Read what `to_json` wrote."""
        values = json.loads(text)
        components = tuple(Component(name=c["name"], argv=tuple(c["argv"])) for c in values["components"])
        return cls(components=components, timing=Timing(**values["timing"]))


async def serve_agent(config: AgentConfig, say: Callable[[str], None], *, as_json: bool = False) -> None:
    """Run an agent for a person at a terminal, until interrupted, hung up or terminated; twice ends it at once.

    Args:
        config: What the agent is.
        say: Takes a line for everything that a person should know.
        as_json: The lines are JSON reports instead, and there are more of them.

    Raises:
        SfglabError: The agent could not be run as it is described.
        ComponentError: A component ended of its own accord before it had ever served.
    """
    narrator = Narrator(config)

    def tell(event: AgentEvent) -> None:
        for line in [json.dumps(report_from_event(event))] if as_json else narrator.lines(event):
            say(line)

    agent = Agent(plan(config), timing=config.supervision, on_event=tell)
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        asyncio.get_running_loop().add_signal_handler(number, agent.stop)
    if not as_json:
        say(narrator.beginning())
    await agent.run()
    if not as_json:
        say(narrator.end())


def main(argument: str) -> None:
    """Be the process: serve until standard input ends or until told to terminate."""

    async def body(report: Callable[[Report], None]) -> None:
        config = SupervisorConfig.from_json(argument)
        agent = Agent(
            config.components, timing=config.timing, on_event=lambda event: report(report_from_event(event))
        )
        await agent.run()

    run_component(body)

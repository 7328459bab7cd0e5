"""Visualizers of a fleet: events of an agent's discoverer, and ages of heartbeats (paper A, section 4.2)."""

from __future__ import annotations

from typing import Any

from sfglab.errors import InvalidValueError
from sfglab.fleet.discovery.lifecycle import ANNOUNCEMENTS
from sfglab.fleet.discovery.listener import DISCOVERY_EVENT, DISCOVERY_QOS
from sfglab.fleet.status.heartbeat import AGENT_HEARTBEAT, Phase
from sfglab.messages.text import to_yaml, values_of
from sfglab.names import validate_agent
from sfglab.qos import DEFAULT
from sfglab.units import NS_PER_S
from sfglab.view.rerunning import rr
from sfglab.view.visualizer import Canvas, Input, Update, Visualizer, agent_root

LATE_PERIODS = 1.5  #: Age, in announced periods, from which a heartbeat is late.
#: Age of the last heartbeat, in announced periods, from which an agent counts as lost.
LOST_PERIODS = 3.0
_MOST_AGENTS = 256  #: Largest number of agents, so that made-up names do not fill the memory.
_LONGEST_PERIOD_S = 86_400.0

LIFE_COLORS = {
    "starting": (86, 180, 233),
    "alive": (0, 158, 115),
    "late": (230, 159, 0),
    "lost": (213, 94, 0),
}
"""Colours of the states of an agent by its heartbeats, distinct for people with colour blindness."""


class AgentHeartbeats(Visualizer):
    """Age of the last heartbeat of each agent as a curve in seconds, and the agent's state as a band."""

    name = "agent_heartbeats"
    inputs = (Input("heartbeats", AGENT_HEARTBEAT, qos=DEFAULT),)
    max_hz = None
    queue = 1000
    tick_hz = 5.0

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._last: dict[str, tuple[int, Any]] = {}  # time of reception and heartbeat by agent
        self._drawn: dict[str, str] = {}  # state by agent

    def show(self, update: Update, canvas: Canvas) -> None:  # noqa: ARG002 - drawn with the next tick
        """Store a heartbeat, which is drawn with the next tick.

        Raises:
            InvalidValueError: The period is not between 0 and one day, or there are too many agents.
            FqnError: The agent's name is not valid.
        """
        heartbeat = update.only
        if not 0 < heartbeat.period_s < _LONGEST_PERIOD_S:
            raise InvalidValueError("period_s", heartbeat.period_s, "seconds above 0, below a day")
        if heartbeat.agent not in self._last:
            validate_agent(heartbeat.agent)
            if len(self._last) >= _MOST_AGENTS:
                raise InvalidValueError("agent", heartbeat.agent, f"{_MOST_AGENTS} agents at most")
        self._last[heartbeat.agent] = update.received_ns, heartbeat

    def tick(self, now_ns: int, canvas: Canvas) -> None:
        """Draw the age of each heartbeat, and each state that has changed."""
        for agent, (received_ns, heartbeat) in self._last.items():
            root = f"{agent_root(agent)}/heartbeat"
            age_s = max(0.0, (now_ns - received_ns) / NS_PER_S)
            canvas.log(f"{root}/age_s", rr.Scalars([age_s]))
            if agent not in self._drawn:
                bands = rr.StateConfiguration(
                    values=list(LIFE_COLORS), colors=list(LIFE_COLORS.values())
                )
                canvas.log(f"{root}/life", bands, static=True)
            life = _life(heartbeat, age_s)
            if self._drawn.get(agent) != life:
                self._drawn[agent] = life
                canvas.log(f"{root}/life", rr.StateChange(state=[life]))


def _life(heartbeat: Any, age_s: float) -> str:
    """Return the state of an agent by its last heartbeat: starting, alive, late or lost."""
    periods = age_s / heartbeat.period_s
    if periods > LOST_PERIODS:
        return "lost"
    if periods > LATE_PERIODS:
        return "late"
    return "starting" if heartbeat.phase == Phase.STARTUP else "alive"


class AgentStatus(Visualizer):
    """Events of a discoverer: a log of them, the presence of each agent as a band, and its description as text."""

    name = "agent_status"
    inputs = (Input("events", DISCOVERY_EVENT, qos=DISCOVERY_QOS),)
    max_hz = None
    queue = 1000

    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw one discovery event.

        Raises:
            InvalidValueError: The kind of the event is unknown.
        """
        event = update.only
        words = {getattr(event, action.name): action.name.lower() for action in ANNOUNCEMENTS}
        if event.event not in words:
            raise InvalidValueError("discovery event", event.event, ", ".join(map(str, words)))
        is_lost = event.event == event.LOST
        entity = f"{agent_root(event.agent)}/status"
        level = rr.TextLogLevel.WARN if is_lost else rr.TextLogLevel.INFO
        line = f"{event.agent} {words[event.event]}"
        canvas.log(f"{entity}/log", rr.TextLog(line, level=level))
        canvas.log(entity, rr.StateChange(state=["lost" if is_lost else "there"]))
        if event.metadata.agent:
            description = rr.TextDocument(to_yaml(values_of(event.metadata)))
            canvas.log(f"{entity}/description", description)

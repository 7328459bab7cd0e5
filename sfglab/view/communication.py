"""Links between the agents of a fleet, folded from what a viewer can see: beats, endpoints, drops.

Pure: facts and `now_ns` in, one value per agent out. Refuses to know messages, the bus and the viewer. What it
holds is bounded by the agents (`max_agents`) and by the endpoints that there are.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

from sfglab.names import FqnError, Resource, Scope, parse, validate_agent
from sfglab.units import NS_PER_S
from sfglab.view.errors import SettingError

LATE_PERIODS = 1.5
"""A heartbeat is late when it is this many of its own periods old."""

LOST_PERIODS = 3.0
"""An agent is taken for lost when its last heartbeat is this many of its own periods old."""


class Life(Enum):
    """How an agent is, as far as its heartbeats tell."""

    SILENT = "silent"  #: Known from elsewhere, but not heard yet.
    STARTING = "starting"  #: It has just started: others may not know it yet.
    ALIVE = "alive"
    LATE = "late"
    LOST = "lost"


class Services(Enum):
    """Whether the streams of a remote agent are decoded on this host."""

    NONE = "none"  #: Never seen one.
    UP = "up"
    DOWN = "down"


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentLink:
    """One agent at one moment."""

    agent: str  #: Its name.
    life: Life  #: How it is.
    age_ns: int | None  #: Since its last heartbeat was received; None before the first.
    restarts: int  #: How often it came back as another incarnation.
    decoders: Services  #: Whether its streams are decoded here.
    decoded: int  #: How many of them are.
    dropped: int  #: Messages of its topics that were passed over before they were shown.
    lost: int  #: Messages of its topics that did not arrive.


@dataclass(slots=True)
class _Known:
    """What was heard of one agent."""

    beat_ns: int | None = None
    period_ns: int = NS_PER_S
    starting: bool = False
    said_lost: bool = False
    incarnation: int | None = None
    restarts: int = 0
    decoders: dict[bytes, str] = field(default_factory=dict)
    ever_decoded: bool = False
    health: dict[str, tuple[int, int]] = field(default_factory=dict)


def decoded_stream_agent(topic: str) -> str | None:
    """Return whose decoded stream a topic is: ``/local/<agent>/<component>/<stream>/image_raw``; else None."""
    try:
        fqn = parse(topic)
    except FqnError:
        return None
    decoded = fqn.scope is Scope.LOCAL and fqn.stream is not None and fqn.resource is Resource.IMAGE_RAW
    return fqn.agent if decoded else None


class FleetLinks:
    """The links of a fleet.

    Args:
        max_agents: How many agents are followed at most; others are counted as `refused`.

    Attributes:
        refused: Facts about agents beyond that number, or with names that no agent can bear.
    """

    def __init__(self, *, max_agents: int = 256) -> None:
        self.refused = 0
        self._max_agents = max_agents
        self._known: dict[str, _Known] = {}

    def expect(self, agent: str) -> None:
        """Take note of an agent that has not been heard yet, as from a fleet file."""
        self._agent(agent)

    def heard(self, agent: str, *, incarnation: int, period_s: float, is_starting: bool, now_ns: int) -> None:
        """Take one heartbeat.

        Args:
            agent: Who sent it.
            incarnation: When that agent started, on its own clock.
            period_s: Time until its next one.
            is_starting: Whether its phase says so.
            now_ns: When it was received.
        """
        known = self._agent(agent)
        if known is None:
            return
        if not 0 < period_s < 86_400:
            raise SettingError("period_s", period_s, "seconds above 0, below a day")
        known.restarts += known.incarnation is not None and incarnation > known.incarnation
        known.incarnation = max(incarnation, known.incarnation or 0)
        known.beat_ns, known.period_ns = now_ns, round(period_s * NS_PER_S)
        known.starting, known.said_lost = is_starting, False

    def discovered(self, agent: str, *, is_lost: bool) -> None:
        """Take what a discoverer says of an agent; a heartbeat afterwards says otherwise again."""
        known = self._agent(agent)
        if known is not None:
            known.said_lost = is_lost

    def endpoint(self, topic: str, gid: bytes, *, is_there: bool) -> None:
        """Take note of a publisher that appeared or went; those of decoded streams count."""
        agent = decoded_stream_agent(topic)
        known = None if agent is None else self._agent(agent)
        if known is None:
            return
        known.decoders.pop(gid, None)
        if is_there:
            known.decoders[gid] = topic
            known.ever_decoded = True

    def health(self, agent: str | None, topic: str, *, dropped: int, lost: int) -> None:
        """Take the counts of one topic of an agent, summed up since the beginning."""
        known = None if agent is None else self._known.get(agent)
        if known is not None:
            known.health[topic] = dropped, lost

    def links(self, now_ns: int) -> tuple[AgentLink, ...]:
        """Return how each agent is now, by name."""
        return tuple(_link(agent, known, now_ns) for agent, known in sorted(self._known.items()))

    def _agent(self, agent: str) -> _Known | None:
        if agent in self._known:
            return self._known[agent]
        try:
            validate_agent(agent)
        except FqnError:
            self.refused += 1
            return None
        if len(self._known) >= self._max_agents:
            self.refused += 1
            return None
        return self._known.setdefault(agent, _Known())


def _link(agent: str, known: _Known, now_ns: int) -> AgentLink:
    age_ns = None if known.beat_ns is None else max(0, now_ns - known.beat_ns)
    decoded = len(set(known.decoders.values()))
    services = Services.UP if decoded else Services.DOWN if known.ever_decoded else Services.NONE
    return AgentLink(
        agent=agent,
        life=_life(known, age_ns),
        age_ns=age_ns,
        restarts=known.restarts,
        decoders=services,
        decoded=decoded,
        dropped=sum(dropped for dropped, _ in known.health.values()),
        lost=sum(lost for _, lost in known.health.values()),
    )


def _life(known: _Known, age_ns: int | None) -> Life:
    if age_ns is None:
        return Life.LOST if known.said_lost else Life.SILENT
    if known.said_lost or age_ns > LOST_PERIODS * known.period_ns:
        return Life.LOST
    if age_ns > LATE_PERIODS * known.period_ns:
        return Life.LATE
    return Life.STARTING if known.starting else Life.ALIVE

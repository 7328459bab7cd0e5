"""The fleet itself: what is known of its agents, and how they hear each other, drawn over where they are.

Links between agents are folded from what a viewer can see: beats, endpoints, drops. `FleetLinks` is pure: facts
and `now_ns` in, one value per agent out; what it holds is bounded by the agents (`max_agents`) and by the
endpoints that there are.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from enum import Enum
from typing import Any

import numpy as np

from sfglab.bus import EndpointAdded, EndpointEvent, EndpointKind, EndpointRemoved
from sfglab.errors import InvalidValueError
from sfglab.fleet.discovery.listener import DISCOVERY_EVENT, DISCOVERY_QOS
from sfglab.fleet.fleet_file import load_fleet
from sfglab.fleet.status.heartbeat import AGENT_HEARTBEAT, Phase
from sfglab.names import FqnError, Resource, Scope, parse, validate_agent
from sfglab.qos import DEFAULT
from sfglab.units import NS_PER_S
from sfglab.view.rerunning import rr
from sfglab.view.visualizer import (
    Canvas,
    Input,
    Parameter,
    TopicHealth,
    Update,
    Visualizer,
    agent_of_topic,
    agent_root,
)

LATE_PERIODS = 1.5  #: A heartbeat is late when it is this many of its own periods old.

#: An agent is taken for lost when its last heartbeat is this many of its own periods old.
LOST_PERIODS = 3.0


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
    decoded = (
        fqn.scope is Scope.LOCAL and fqn.stream is not None and fqn.resource is Resource.IMAGE_RAW
    )
    return fqn.agent if decoded else None


class FleetLinks:
    """The links of a fleet of up to `max_agents`; others are counted as `refused`."""

    def __init__(self, *, max_agents: int = 256) -> None:
        #: Facts about agents beyond that number, or with names that no agent can bear.
        self.refused = 0
        self._max_agents = max_agents
        self._known: dict[str, _Known] = {}

    def expect(self, agent: str) -> None:
        """Take note of an agent that has not been heard yet, as from a fleet file."""
        self._agent(agent)

    def heard(
        self, agent: str, *, incarnation: int, period_s: float, is_starting: bool, now_ns: int
    ) -> None:
        """Take a heartbeat of an agent, whose incarnation is when it started by its own clock."""
        known = self._agent(agent)
        if known is None:
            return
        if not 0 < period_s < 86_400:
            raise InvalidValueError("period_s", period_s, "seconds above 0, below a day")
        known.restarts += known.incarnation is not None and incarnation > known.incarnation
        known.incarnation = max(incarnation, known.incarnation or 0)
        known.beat_ns, known.period_ns = now_ns, round(period_s * NS_PER_S)
        known.starting, known.said_lost = is_starting, False

    def discovered(self, agent: str, *, is_lost: bool) -> None:
        """Take what a discoverer says of an agent; a heartbeat afterwards says otherwise again."""
        if (known := self._agent(agent)) is not None:
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
    return AgentLink(
        agent=agent,
        life=_life(known, age_ns),
        age_ns=age_ns,
        restarts=known.restarts,
        decoders=Services.UP if decoded else Services.DOWN if known.ever_decoded else Services.NONE,
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


Color = tuple[int, int, int]


LIFE_COLORS = {
    Life.SILENT: (150, 150, 150),
    Life.STARTING: (86, 180, 233),
    Life.ALIVE: (0, 158, 115),
    Life.LATE: (230, 159, 0),
    Life.LOST: (213, 94, 0),
}
"""From the palette of Okabe and Ito, which the colour-blind tell apart."""

_DECODER_COLORS = {
    Services.NONE: (150, 150, 150),
    Services.UP: (0, 158, 115),
    Services.DOWN: (213, 94, 0),
}
_RING = np.linspace(0, 2 * math.pi, 49)


def border_edges(fleet: Any) -> tuple[tuple[str, str, str], ...]:
    """Return speaker, hearer and name for everything that crosses between two agents of a fleet."""
    from sfglab.fleet.lint import View

    return tuple(
        (speaker, hearer, hearing.name)
        for hearing in View(fleet).hearings()
        if hearing.crosses
        for speaker in hearing.speakers
        for hearer in hearing.hearers
        if speaker != hearer
    )


def _for_all(edges: tuple[tuple[str, str, str], ...], agents: list[str]) -> frozenset[str]:
    """Return the names that everybody hears, such as heartbeats: drawn as arrows they would hide the others."""
    hearers: dict[str, set[str]] = {}
    for _, hearer, name in edges:
        hearers.setdefault(name, set()).add(hearer)
    return frozenset(
        name for name, found in hearers.items() if len(found) >= max(2, len(agents) - 1)
    )


class AgentStatus(Visualizer):
    """What a discoverer finds out about agents: events as a log, states as bands, descriptions as text."""

    name = "agent_status"
    inputs = (Input("events", DISCOVERY_EVENT, qos=DISCOVERY_QOS),)
    max_hz = None
    queue = 1000

    def show(self, update: Update, canvas: Canvas) -> None:
        """Tell one event."""
        event = update.only
        names = {event.DISCOVERED: "discovered", event.UPDATED: "updated", event.LOST: "lost"}
        names |= {event.RETURNED: "returned", event.RESTARTED: "restarted"}
        if event.event not in names:
            raise InvalidValueError("discovery event", event.event, f"{', '.join(map(str, names))}")
        what = names[event.event]
        level = rr.TextLogLevel.WARN if event.event == event.LOST else rr.TextLogLevel.INFO
        entity = f"{agent_root(event.agent)}/status"
        canvas.log(f"{entity}/log", rr.TextLog(f"{event.agent} {what}", level=level))
        canvas.log(entity, rr.StateChange(state=["lost" if event.event == event.LOST else "there"]))
        if event.metadata.agent:
            text = rr.TextDocument(_description(event.metadata), media_type=rr.MediaType.MARKDOWN)
            canvas.log(f"{entity}/description", text)


def _description(metadata: Any) -> str:
    lines = [f"# {metadata.agent}", ""]
    for sensor in metadata.sensors:
        lines += [f"- **{sensor.name}** {sensor.model}"]
        lines += [
            f"  - `{s.topic}` {s.codec} {s.width} x {s.height}, {s.rate_hz:g} Hz"
            for s in sensor.streams
        ]
    lines += ["", *(f"- {part}" for part in (*metadata.software, *metadata.accelerators))]
    return "\n".join(lines)


class Communication(Visualizer):
    """Who is heard, decoded, dropped, and what crosses: rings in space, curves and bands, ``/fleet/border``."""

    name = "communication"
    inputs = (
        Input("heartbeats", AGENT_HEARTBEAT, pattern="/global/agent_heartbeat", qos=DEFAULT),
        Input("events", DISCOVERY_EVENT, optional=True, qos=DISCOVERY_QOS),
    )
    max_hz = None
    queue = 1000
    tick_hz = 5.0
    parameters = (
        Parameter("fleet", "", "fleet file: expected agents, and what crosses; empty: none"),
        Parameter("frame", "{agent}/base", "frame of an agent's ring; {agent} is its name"),
        Parameter("radius_m", 0.6, "radius of the ring, m", minimum=0.01, maximum=100.0),
    )

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._links = FleetLinks()
        self._said: dict[str, str] = {}
        self._fleet_drawn = ""

    def show(self, update: Update, canvas: Canvas) -> None:  # noqa: ARG002 - drawn with the next tick
        """Take one heartbeat or event; it is drawn with the next tick."""
        for role, message in update.messages.items():
            if role == "events":
                self._links.discovered(message.agent, is_lost=message.event == message.LOST)
            else:
                self._links.heard(
                    message.agent,
                    incarnation=int(message.incarnation),
                    period_s=float(message.period_s),
                    is_starting=message.phase == Phase.STARTUP,
                    now_ns=update.received_ns,
                )

    def observe(self, fact: EndpointEvent | TopicHealth) -> None:
        """Take note of publishers and counts."""
        if isinstance(fact, TopicHealth):
            self._links.health(
                agent_of_topic(fact.topic), fact.topic, dropped=fact.dropped, lost=fact.lost
            )
        elif (
            isinstance(fact, EndpointAdded | EndpointRemoved)
            and fact.endpoint.kind is EndpointKind.PUBLISHER
        ):
            is_there = isinstance(fact, EndpointAdded)
            self._links.endpoint(fact.endpoint.topic, fact.endpoint.gid, is_there=is_there)

    def tick(self, now_ns: int, canvas: Canvas) -> None:
        """Draw every agent as it is now."""
        if self["fleet"] != self._fleet_drawn:
            self._draw_border(canvas)
        for link in self._links.links(now_ns):
            self._draw(link, canvas)

    def _draw(self, link: AgentLink, canvas: Canvas) -> None:
        root = f"{agent_root(link.agent)}/communication"
        self._band(f"{root}/life", link.life.value, LIFE_COLORS, canvas)
        self._band(f"{root}/decoders", link.decoders.value, _DECODER_COLORS, canvas)
        if link.age_ns is not None:
            canvas.log(f"{root}/heartbeat_age_s", rr.Scalars([link.age_ns / NS_PER_S]))
        canvas.log(f"{root}/dropped", rr.Scalars([link.dropped]))
        canvas.log(f"{root}/lost", rr.Scalars([link.lost]))
        self._draw_ring(link, f"{root}/ring", canvas)

    def _band(self, entity: str, state: str, colors: dict[Any, Color], canvas: Canvas) -> None:
        """Say a state where it changed."""
        if entity not in self._said:
            bands = rr.StateConfiguration(
                values=[key.value for key in colors], colors=list(colors.values())
            )
            canvas.log(entity, bands, static=True)
        if self._said.get(entity) != state:
            self._said[entity] = state
            canvas.log(entity, rr.StateChange(state=[state]))

    def _draw_ring(self, link: AgentLink, entity: str, canvas: Canvas) -> None:
        color, radius_m = LIFE_COLORS[link.life], self["radius_m"]
        circle = np.column_stack([np.cos(_RING), np.sin(_RING), np.zeros(len(_RING))]) * radius_m
        canvas.place(entity, str(self["frame"]).replace("{agent}", link.agent))
        ring = rr.LineStrips3D(
            [circle], colors=[color], radii=radius_m / 40, labels=[describe(link)], show_labels=True
        )
        canvas.log(entity, ring)

    def _draw_border(self, canvas: Canvas) -> None:
        self._fleet_drawn = str(self["fleet"])
        if not self._fleet_drawn:
            return
        fleet = load_fleet(self._fleet_drawn)
        for agent in fleet.agents:
            self._links.expect(agent.name)
        edges = border_edges(fleet)
        nodes = [agent.name for agent in fleet.agents]
        labels = [f"{agent.name} (domain {agent.domain})" for agent in fleet.agents]
        angles = np.arange(len(nodes)) * 2 * math.pi / max(1, len(nodes))
        radius = 80 + 20 * len(nodes)  # pixels, so that neighbours do not lie on each other
        # names, and views, are wide
        places = np.column_stack([np.cos(angles), 0.4 * np.sin(angles)]) * radius
        shared = _for_all(edges, nodes)
        pairs = sorted({(speaker, hearer) for speaker, hearer, name in edges if name not in shared})
        canvas.log(
            "/fleet/border",
            rr.GraphNodes(nodes, positions=places, labels=labels),
            rr.GraphEdges(pairs, graph_type="directed"),
            static=True,
        )
        rows = [f"| {speaker} | {hearer} | `{name}` |" for speaker, hearer, name in edges]
        table = "\n".join(["| from | to | name |", "|---|---|---|", *rows])
        canvas.log(
            "/fleet/border/names",
            rr.TextDocument(table, media_type=rr.MediaType.MARKDOWN),
            static=True,
        )


def describe(link: AgentLink) -> str:
    """Return a link in a few words, as they stand beside the agent."""
    parts = [f"{link.agent}: {link.life.value}"]
    if link.age_ns is not None:
        parts.append(f"{link.age_ns / NS_PER_S:.1f} s")
    if link.decoders is not Services.NONE:
        parts.append(f"decoder {link.decoders.value}")
    if link.dropped or link.lost:
        parts.append(f"{link.dropped} dropped, {link.lost} lost")
    return ", ".join(parts)

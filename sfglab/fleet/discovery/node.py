"""Agent discoverer: one node per agent that knows the fleet. Paper A, section 4.2, Fig. 3.

The thin shell around `registry`; it publishes discovery events in the agent's own domain. As a process
(``python -m sfglab.fleet.discovery.node CONFIG``; see `sfglab.component`) it reports, beside ``ready``, every
event, ``{"is": "event", "agent", "event", "incarnation", "t_ns"}``, and if so configured every transition,
``{"is": "move", "agent", "before", "given", "after", "actions", "t_ns"}``. The order ``{"report": true}`` is
answered with what is known now: ``{"is": "status", "agents": [...], "counts": {...}}``.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.component import (
    Orders,
    Reporter,
    beside,
    end_tasks,
    is_set_before,
    run_component,
    steady_ns,
)
from sfglab.errors import InvalidValueError, SfglabError
from sfglab.fleet.discovery.lifecycle import Action
from sfglab.fleet.discovery.listener import DISCOVERY_EVENT, DISCOVERY_QOS, HISTORY, discovery_topic
from sfglab.fleet.discovery.offers import Offers
from sfglab.fleet.discovery.registry import AgentStatus, Move, Order, Registry, Timing
from sfglab.fleet.discovery.screening import Limits, Refusal, admitted
from sfglab.fleet.discovery.turns import Turns
from sfglab.fleet.refusals import SaidOnce
from sfglab.fleet.status.heartbeat import (
    AGENT_HEARTBEAT,
    AGENT_METADATA,
    GET_METADATA,
    MAX_SAMPLE_BYTES,
    heartbeat_topic,
    metadata_service,
    metadata_topic,
)
from sfglab.messages import CdrError, deserialize, message_type, service_type, stamp_from_ns
from sfglab.names import validate_agent
from sfglab.qos import LATCHED

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from sfglab.bus import Node, Publisher, Subscription


class History:
    """The agents of the last `depth` events; what late consumers would not hear any more is repeated."""

    def __init__(self, depth: int) -> None:
        self._window: deque[str] = deque(maxlen=depth)
        self._events_of: dict[str, int] = {}

    def published(self, agent: str) -> str | None:
        """Take note of one more event about an agent.

        Returns:
            The agent whose last event has just been pushed out, and has to be repeated if it is there.
        """
        pushed_out = self._window[0] if len(self._window) == self._window.maxlen else None
        self._window.append(agent)
        self._events_of[agent] = self._events_of.get(agent, 0) + 1
        if pushed_out is None:
            return None
        self._events_of[pushed_out] -= 1
        if self._events_of[pushed_out]:
            return None
        del self._events_of[pushed_out]
        return pushed_out


_LOG = logging.getLogger(__name__)
_HEARTBEATS = replace(LATCHED, depth=1000)  # of all agents together, for they share one topic
_OFFER_WAIT_S = 0.5  # what is offered comes with the heartbeat, but for a repair
_TICK_NS = 1_000_000_000  # the watch looks at least this often, to notice when it stood still
_OVERSLEPT_NS = 500_000_000
# Events that are kept for late consumers beyond those that are reckoned with: a repetition is never too late.
_MARGIN = 50


@dataclass(frozen=True, slots=True, kw_only=True)
class DiscoverySettings:
    """What a discoverer is told."""

    agent: str  #: Its own agent, whose heartbeats it ignores.
    timing: Timing = field(default_factory=Timing)  #: The waits.
    limits: Limits = field(default_factory=Limits)  #: The bounds.
    #: How long an agent's service may take to be found, seconds. In a fleet that starts together this takes
    #: long, and longer when those who look for it give up and begin anew.
    find_timeout_s: float = 5.0
    query_timeout_s: float = 2.0  #: How long an agent may take to answer then, seconds.
    #: Whether descriptions that agents offer are read; then a service is asked only where there is none of use.
    offers: bool = False
    #: Queries that may be under way at once; the others have their turns (`Turns`).
    max_queries: int = 128

    def __post_init__(self) -> None:
        validate_agent(self.agent)
        for name in ("find_timeout_s", "query_timeout_s"):
            if not 0 < (given := getattr(self, name)) <= 60:
                raise InvalidValueError(f"discovery, {name}", given, "seconds above 0, at most 60")
        if self.max_queries < 1:
            raise InvalidValueError(
                "discovery, max_queries", self.max_queries, "whole numbers from 1"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class DiscoveryStatus:
    """What a discoverer knows now."""

    agents: tuple[AgentStatus, ...]  #: The remote agents, by name.
    #: How often what happened; see `Registry.counts`. ``event_<name>`` counts events.
    counts: dict[str, int]


class AgentDiscoverer:
    """Tells an agent who else is there; calls `on_event` after an event, `on_move` at a transition."""

    def __init__(
        self,
        node: Node,
        settings: DiscoverySettings,
        *,
        on_event: Callable[[Order], None] = lambda _: None,
        on_move: Callable[[Move], None] | None = None,
    ) -> None:
        self._node = node
        self._settings = settings
        self._on_event = on_event
        self._say = SaidOnce(_LOG)
        self._registry = Registry(
            settings.agent,
            timing=settings.timing,
            limits=settings.limits,
            on_move=on_move,
            on_alarm=lambda key, sentence: self._say(key, f"discoverer: {sentence}"),
        )
        self._history = History(HISTORY - _MARGIN)
        self._turns = Turns(settings.max_queries)
        self._asked: dict[int, Order] = {}  # by queries that wait or are under way
        self._offers = Offers(settings.limits)
        self._offered = asyncio.Event()
        self._queries: dict[int, asyncio.Task[None]] = {}
        self._rearmed = asyncio.Event()
        self._events: Publisher | None = None
        self._broken: asyncio.Future[None]

    def status(self) -> DiscoveryStatus:
        """Return what is known now."""
        return DiscoveryStatus(agents=self._registry.agents(), counts=dict(self._registry.counts))

    async def run(self, on_ready: Callable[[], None] = lambda: None) -> None:
        """Serve until cancelled; nothing of it is left then. `on_ready` is called before it hears anything."""
        own_topic = discovery_topic(self._settings.agent)
        self._events = self._node.create_publisher(DISCOVERY_EVENT, own_topic, DISCOVERY_QOS)
        heard = [
            self._node.create_subscription(AGENT_HEARTBEAT, heartbeat_topic(), qos=_HEARTBEATS)
        ]
        hearing = [self._hear(heard[0])]
        if self._settings.offers:
            topic = metadata_topic()
            heard.append(
                self._node.create_subscription(AGENT_METADATA, topic, qos=_HEARTBEATS, raw=True)
            )
            hearing.append(self._hear_offers(heard[1]))
        on_ready()
        self._broken = asyncio.get_running_loop().create_future()
        try:
            async with beside(*hearing, self._watch_time()) as serving:
                done, _ = await asyncio.wait(
                    [self._broken, *serving], return_when=asyncio.FIRST_COMPLETED
                )
                for future in done:
                    future.result()
        finally:
            await end_tasks(*self._queries.values())
            self._broken.cancel()
            for subscription in heard:
                subscription.close()
            self._events.close()

    async def _hear(self, heartbeats: Subscription) -> None:
        while True:
            try:
                heartbeat, info = await heartbeats.take_with_info()
            except CdrError:
                self._registry.refuse(Refusal.MALFORMED)
                continue
            orders = self._registry.heard(heartbeat, info.publisher_gid, now_ns=steady_ns())
            self._carry_out(orders)
            if orders:  # else it put a deadline off, for which nobody has to wake
                self._rearmed.set()

    async def _hear_offers(self, offers: Subscription) -> None:
        while True:
            cdr, info = await offers.take_with_info()
            refusal = self._offers.heard(len(cdr), info.publisher_gid, now_ns=steady_ns())
            try:
                if refusal is None:
                    self._offers.take(deserialize(cdr, AGENT_METADATA), info.publisher_gid)
                    self._offered.set()
                    continue
            except CdrError:
                refusal = Refusal.MALFORMED
            self._registry.counts[f"dropped_offer_{refusal.value}"] += 1

    async def _watch_time(self) -> None:
        """Call the registry when it is time, and tell it when this process stood still meanwhile."""
        now_ns = steady_ns()
        while True:
            self._rearmed.clear()
            since_ns = now_ns
            deadlines = (self._registry.deadline_ns, self._turns.deadline_ns, since_ns + _TICK_NS)
            wake_ns = min(deadline for deadline in deadlines if deadline is not None)
            rearmed = await is_set_before(self._rearmed, wake_ns / 1e9)
            # a timer may be early by its resolution
            now_ns = steady_ns() if rearmed else max(steady_ns(), wake_ns)
            if now_ns - wake_ns > _OVERSLEPT_NS:
                self._registry.overslept(since_ns, now_ns)
            self._carry_out(self._registry.due(now_ns))

    def _carry_out(self, orders: Iterable[Order]) -> None:
        for order in orders:
            if order.query is None:
                self._announce(order)
            elif order.action is Action.QUERY:
                self._asked[order.query] = order
                self._turns.ask(order.query, order.publisher, order.failures)
            else:
                self._end(order.query)
        self._take_turns()

    def _take_turns(self) -> None:
        """Begin the queries whose turn it is; those in whose place they come have failed."""
        now_ns = steady_ns()
        while (query := (turn := self._turns.next(now_ns))[0]) is not None:
            if (leaves := turn[1]) is not None:
                agent = self._asked[leaves].agent
                self._end(leaves)
                self._carry_out(self._registry.failed(agent, leaves, now_ns=now_ns))
            task = asyncio.create_task(self._ask(self._asked[query], query))
            self._queries[query] = task
            task.add_done_callback(partial(self._query_ended, query))

    def _end(self, query: int) -> None:
        """End a query, wherever it stands."""
        self._asked.pop(query, None)
        self._turns.ended(query)
        if query in self._queries:
            self._queries[query].cancel()

    def _query_ended(self, query: int, task: asyncio.Task[None]) -> None:
        del self._queries[query]
        self._end(query)
        self._rearmed.set()  # there is a place now, and the next try may be due before anything else
        if (
            not task.cancelled()
            and (error := task.exception()) is not None
            and not self._broken.done()
        ):
            self._broken.set_exception(error)

    async def _ask(self, order: Order, query: int) -> None:
        agent = order.agent
        metadata = (
            await self._offer_of(order) if self._settings.offers and not order.failures else None
        )
        metadata = self._admitted(agent, metadata or await self._answer_of(agent, query))
        if metadata is None:
            orders = self._registry.failed(agent, query, now_ns=steady_ns())
        else:
            orders = self._registry.answered(agent, query, metadata, now_ns=steady_ns())
        self._carry_out(orders)

    async def _offer_of(self, order: Order) -> Any:
        """Return what an agent offers of itself; None where that does not come, or is disputed."""
        end_s = steady_ns() / 1e9 + _OFFER_WAIT_S
        waits = True
        while waits:
            self._offered.clear()
            if (offer := self._offers.of(order.agent, order.wanted, self._is_there)) is not None:
                self._registry.counts["offered"] += 1
                return offer
            waits = await is_set_before(self._offered, end_s)
        return None

    def _is_there(self, publisher: bytes) -> bool:
        return any(
            publisher == endpoint.gid for endpoint in self._node.graph.publishers(metadata_topic())
        )

    async def _answer_of(self, agent: str, query: int) -> Any:
        """Ask an agent; None when there is no answer."""
        client = self._node.create_client(GET_METADATA, metadata_service(agent))
        try:
            request = service_type(GET_METADATA).request()
            await client.wait_for_service(self._settings.find_timeout_s)
            self._turns.found(query, steady_ns())
            most, timeout_s = (
                self._settings.limits.max_metadata_bytes,
                self._settings.query_timeout_s,
            )
            response = await client.call(request, timeout_s=timeout_s, max_bytes=most)
        except SfglabError as error:
            _LOG.info("discoverer: %s", error)
            return None
        finally:
            client.close()
        return response.metadata if response.success else None

    def _admitted(self, agent: str, metadata: Any) -> Any:
        """Return what may be used of a description; None of None."""
        if metadata is None:
            return None
        metadata, refused = admitted(metadata)
        self._registry.counts["refused_parts"] += len(refused)
        for wrong in refused:
            self._say((agent, wrong.place), f"discoverer: {agent}: {wrong}")
        return metadata

    def _announce(self, news: Order | None) -> None:
        """Publish an event, and again the last news of agents that late consumers would not hear otherwise."""
        while news is not None:
            self._publish(news)
            self._registry.counts[f"event_{news.event.lower()}"] += 1
            self._on_event(news)
            unheard = self._history.published(news.agent)
            news = None if unheard is None else self._registry.announcement(unheard)

    def _publish(self, news: Order) -> None:
        type_ = message_type(DISCOVERY_EVENT)
        stamp, kind = stamp_from_ns(self._node.get_clock().now_ns()), getattr(type_, news.event)
        event: Any = type_(stamp=stamp, agent=news.agent, event=kind, metadata=news.metadata)
        assert self._events is not None
        self._events.publish(event)


@dataclass(frozen=True, slots=True, kw_only=True)
class DiscoveryConfig:
    """What a discoverer's process is told."""

    address: BusAddress  #: The agent's local domain.
    settings: DiscoverySettings  #: Whose discoverer it is, and how it works.
    report_moves: bool = False  #: Whether every transition is reported.


async def run_discoverer(config: DiscoveryConfig, report: Reporter, orders: Orders) -> None:
    """Run a discoverer until cancelled and all it started has ended; `BusError` if it cannot join a domain."""
    from sfglab.bus import Node

    async with Node(
        "agent_discoverer", **config.address.options(), max_sample_bytes=MAX_SAMPLE_BYTES
    ) as node:
        now_ns = node.get_clock().now_ns

        def told(event: Order) -> None:
            what = {"agent": event.agent, "event": event.event, "incarnation": event.incarnation}
            report({"is": "event", **what, "t_ns": now_ns()})

        def moved(move: Move) -> None:
            names = {"before": move.before.name, "given": move.given.name, "after": move.after.name}
            actions = [action.name for action in move.actions]
            report(
                {"is": "move", "agent": move.agent, **names, "actions": actions, "t_ns": now_ns()}
            )

        on_move = moved if config.report_moves else None
        discoverer = AgentDiscoverer(node, config.settings, on_event=told, on_move=on_move)
        async with beside(_obey(discoverer, report, orders)):
            await discoverer.run(on_ready=lambda: report({"is": "ready"}))


async def _obey(discoverer: AgentDiscoverer, report: Reporter, orders: Orders) -> None:
    while True:
        await orders.get()
        status = discoverer.status()
        agents = [{**asdict(agent), "state": agent.state.name} for agent in status.agents]
        report({"is": "status", "agents": agents, "counts": status.counts})


def main() -> None:
    """Be the process: serve until told to end."""
    run_component(DiscoveryConfig, run_discoverer)


if __name__ == "__main__":
    main()

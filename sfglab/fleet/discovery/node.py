"""The agent discoverer: one node per agent that knows the fleet. Paper A, section 4.2, Fig. 3.

The thin shell around `registry`: it hears heartbeats, asks agents what they are, watches the time, and
publishes discovery events in the agent's own domain, so that no other node of the agent has to.
"""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass, field, replace
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.fleet.discovery.history import History
from sfglab.fleet.discovery.listener import DISCOVERY_EVENT, DISCOVERY_QOS, HISTORY, discovery_topic
from sfglab.fleet.discovery.orders import Abandon, Announce, Answer, Ask, Timing
from sfglab.fleet.discovery.registry import Registry
from sfglab.fleet.discovery.screening import Limits, LimitsError, Refusal
from sfglab.fleet.status.heartbeat import (
    AGENT_HEARTBEAT,
    GET_METADATA,
    Heartbeat,
    heartbeat_topic,
    metadata_service,
)
from sfglab.messages import CdrError, message_type, serialized_size, service_type, stamp_from_ns
from sfglab.names import validate_agent
from sfglab.qos import LATCHED

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from sfglab.bus import Node, Publisher, Subscription
    from sfglab.fleet.discovery.orders import AgentStatus, Move, Order


_LOG = logging.getLogger(__name__)
_HEARTBEATS = replace(LATCHED, depth=1000)  # of all agents together, for they share one topic
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
    max_queries: int = 8  #: Queries that may be under way at once, to different agents; others wait in order.

    def __post_init__(self) -> None:
        validate_agent(self.agent)
        for name in ("find_timeout_s", "query_timeout_s"):
            if not 0 < (given := getattr(self, name)) <= 60:
                raise LimitsError(name, given, "seconds above 0, at most 60")
        if self.max_queries < 1:
            raise LimitsError("max_queries", self.max_queries, "whole numbers from 1")


@dataclass(frozen=True, slots=True, kw_only=True)
class DiscoveryStatus:
    """What a discoverer knows now."""

    agents: tuple[AgentStatus, ...]  #: The remote agents, by name.
    counts: dict[str, int]  #: How often what happened; see `Registry.counts`. ``event_<name>`` counts events.


class AgentDiscoverer:
    """The node that tells its agent who else is there.

    Args:
        node: Node on the agent's local domain.
        settings: Whose, and how.
        on_event: Called with every discovery event, after it was published.
        on_move: Called with every transition of a remote agent's life.
    """

    def __init__(
        self,
        node: Node,
        settings: DiscoverySettings,
        *,
        on_event: Callable[[Announce], None] = lambda _: None,
        on_move: Callable[[Move], None] = lambda _: None,
    ) -> None:
        self._node = node
        self._settings = settings
        self._on_event = on_event
        self._registry = Registry(
            settings.agent, timing=settings.timing, limits=settings.limits, on_move=on_move
        )
        self._history = History(HISTORY - _MARGIN)
        self._slots = asyncio.Semaphore(settings.max_queries)
        self._queries: dict[int, asyncio.Task[None]] = {}
        self._rearmed = asyncio.Event()
        self._events: Publisher | None = None
        self._broken: asyncio.Future[None]

    def status(self) -> DiscoveryStatus:
        """Return what is known now."""
        return DiscoveryStatus(agents=self._registry.agents(), counts=dict(self._registry.counts))

    async def run(self, on_ready: Callable[[], None] = lambda: None) -> None:
        """Serve until cancelled; nothing of it is left then.

        Args:
            on_ready: Called when it serves and before it has heard anything.
        """
        self._events = self._node.create_publisher(
            DISCOVERY_EVENT, discovery_topic(self._settings.agent), DISCOVERY_QOS
        )
        heartbeats = self._node.create_subscription(AGENT_HEARTBEAT, heartbeat_topic(), qos=_HEARTBEATS)
        on_ready()
        self._broken = asyncio.get_running_loop().create_future()
        serving = [asyncio.create_task(self._hear(heartbeats)), asyncio.create_task(self._watch_time())]
        try:
            done, _ = await asyncio.wait([self._broken, *serving], return_when=asyncio.FIRST_COMPLETED)
            for future in done:
                future.result()
        finally:
            await _end([*serving, *self._queries.values()])
            self._broken.cancel()
            heartbeats.close()
            self._events.close()

    async def _hear(self, heartbeats: Subscription) -> None:
        while True:
            try:
                message, info = await heartbeats.take_with_info()
                heartbeat = Heartbeat.from_message(message)
            except CdrError:
                self._registry.refuse(Refusal.MALFORMED)
                continue
            orders = self._registry.heard(heartbeat, info.publisher_gid, now_ns=_now_ns())
            self._carry_out(orders)
            if orders:  # else it put a deadline off, for which nobody has to wake
                self._rearmed.set()

    async def _watch_time(self) -> None:
        """Call the registry when it is time, and tell it when this process stood still meanwhile."""
        now_ns = _now_ns()
        while True:
            self._rearmed.clear()
            since_ns = now_ns
            deadlines = (self._registry.deadline_ns, since_ns + _TICK_NS)
            wake_ns = min(deadline for deadline in deadlines if deadline is not None)
            rearmed = await self._sleep_until(wake_ns)
            now_ns = _now_ns() if rearmed else max(_now_ns(), wake_ns)  # a timer may be early by its resolution
            if now_ns - wake_ns > _OVERSLEPT_NS:
                self._registry.overslept(since_ns, now_ns)
            self._carry_out(self._registry.due(now_ns))

    async def _sleep_until(self, deadline_ns: int) -> bool:
        """Wait until the loop's clock says so; return True at once when there may be an earlier deadline."""
        try:
            async with asyncio.timeout_at(deadline_ns / 1e9):
                await self._rearmed.wait()
        except TimeoutError:
            return False
        return True

    def _carry_out(self, orders: Iterable[Order]) -> None:
        for order in orders:
            if isinstance(order, Ask):
                task = self._queries[order.query] = asyncio.create_task(self._ask(order))
                task.add_done_callback(partial(self._query_ended, order.query))
            elif isinstance(order, Abandon):
                self._queries[order.query].cancel()
            else:
                self._announce(order)

    def _query_ended(self, query: int, task: asyncio.Task[None]) -> None:
        del self._queries[query]
        if not task.cancelled() and (error := task.exception()) is not None and not self._broken.done():
            self._broken.set_exception(error)

    async def _ask(self, ask: Ask) -> None:
        answer = await self._answer_of(ask.agent)
        if answer is None:
            orders = self._registry.failed(ask.agent, ask.query, now_ns=_now_ns())
        else:
            orders = self._registry.answered(ask.agent, ask.query, answer, now_ns=_now_ns())
        self._carry_out(orders)
        self._rearmed.set()  # the next try may be due before anything else

    async def _answer_of(self, agent: str) -> Answer | None:
        """Ask an agent when it is its turn; None when there is no answer, or none of use."""
        async with self._slots:
            client = self._node.create_client(GET_METADATA, metadata_service(agent))
            try:
                request = service_type(GET_METADATA).request()
                await client.wait_for_service(self._settings.find_timeout_s)
                response = await client.call(request, timeout_s=self._settings.query_timeout_s)
            except SfglabError as error:
                _LOG.info("discoverer: %s", error)
                return None
            finally:
                client.close()
        metadata = response.metadata
        if not response.success or serialized_size(metadata) > self._settings.limits.max_metadata_bytes:
            return None
        return Answer(
            agent=metadata.agent,
            incarnation=int(metadata.incarnation),
            revision=int(metadata.revision),
            metadata=metadata,
        )

    def _announce(self, news: Announce | None) -> None:
        """Publish an event, and again the last news of agents that late consumers would not hear otherwise."""
        while news is not None:
            self._publish(news)
            self._registry.counts[f"event_{news.event.lower()}"] += 1
            self._on_event(news)
            unheard = self._history.published(news.agent)
            news = None if unheard is None else self._registry.announcement(unheard)

    def _publish(self, news: Announce) -> None:
        type_ = message_type(DISCOVERY_EVENT)
        event: Any = type_(
            stamp=stamp_from_ns(self._node.get_clock().now_ns()),
            agent=news.agent,
            event=getattr(type_, news.event),
            metadata=news.metadata,
        )
        assert self._events is not None
        self._events.publish(event)


async def _end(tasks: Sequence[asyncio.Task[None]]) -> None:
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


def _now_ns() -> int:
    """Return the loop's time: it is the node's world's, and never set back."""
    return round(asyncio.get_running_loop().time() * 1e9)

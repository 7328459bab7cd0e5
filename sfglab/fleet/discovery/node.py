"""Agent discoverer: one node per agent that keeps track of the fleet. Paper A, section 4.2, Fig. 3.

The node is an I/O wrapper of `registry`, and publishes discovery events in the agent's own domain. As a process
(``python -m sfglab.fleet.discovery.node CONFIG``; see `sfglab.component`) it reports ``ready``, each event as
``{"is": "event", "agent", "event", "incarnation", "t_ns"}`` and, if configured, each transition as
``{"is": "move", "agent", "before", "given", "after", "actions", "t_ns"}``.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter, deque
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from sfglab.component import (
    Orders,
    Reporter,
    beside,
    end_tasks,
    is_set_before,
    run_component,
    steady_ns,
)
from sfglab.errors import SfglabError
from sfglab.fleet.discovery.config import DiscoveryConfig, DiscoverySettings
from sfglab.fleet.discovery.lifecycle import Action, State
from sfglab.fleet.discovery.listener import DISCOVERY_EVENT, DISCOVERY_QOS, HISTORY, discovery_topic
from sfglab.fleet.discovery.published import PublishedDescriptions
from sfglab.fleet.discovery.registry import Move, Order, Registry
from sfglab.fleet.discovery.validation import MAX_METADATA_BYTES, Refusal, validated_metadata
from sfglab.fleet.refusals import WarnOnce
from sfglab.fleet.status.heartbeat import (
    AGENT_HEARTBEAT,
    AGENT_METADATA,
    GET_METADATA,
    MAX_SAMPLE_BYTES,
    heartbeat_topic,
    metadata_service,
    metadata_topic,
)
from sfglab.messages import CdrError, message_type, service_type, stamp_from_ns
from sfglab.qos import LATCHED

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Iterable

    from sfglab.bus import Node, Publisher, Subscription

_LOG = logging.getLogger(__name__)
_HEARTBEATS = replace(LATCHED, depth=1000)  # all agents share one topic
# In a fleet that starts together, the discovery of a service takes long, and longer if the clients give up and
# start again.
_FIND_TIMEOUT_S = 5.0
_PUBLISHED_WAIT_S = 0.5  # the description arrives with the heartbeat, unless a sample is lost
_TICK_NS = 1_000_000_000  # longest time between two checks for a pause of this process
_PAUSE_NS = 500_000_000  # shortest delay of such a check that counts as a pause
# Events beyond those in the window, so that an event is repeated before it leaves the publisher's history.
_MARGIN = 50


class QueryLimit:
    """A limited number of places for service calls. Calls with fewer failures before them go first."""

    def __init__(self, places: int) -> None:
        self._free = places
        self._waiting: dict[tuple[int, int], asyncio.Future[None]] = {}

    @asynccontextmanager
    async def place(self, failures: int, query: int) -> AsyncIterator[None]:
        """Wait for a place, and hold it during the context.

        Args:
            failures: Number of queries to the same agent that failed before.
            query: Unique number of the query. Among equal failures the smallest number goes first.
        """
        granted: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._waiting[failures, query] = granted
        self._grant()
        try:
            await granted
            yield
        finally:
            if self._waiting.pop((failures, query), None) is None:  # the place was granted
                self._free += 1
                self._grant()

    def _grant(self) -> None:
        while self._free and self._waiting:
            granted = self._waiting.pop(min(self._waiting))
            self._free -= 1
            if not granted.cancelled():  # a cancelled query returns its place itself
                granted.set_result(None)


class AgentDiscoverer:
    """Node that announces which other agents are present."""

    def __init__(
        self,
        node: Node,
        settings: DiscoverySettings,
        *,
        on_event: Callable[[Order], None] = lambda _: None,
        on_move: Callable[[Move], None] | None = None,
    ) -> None:
        """Create a discoverer.

        Args:
            node: Node in the agent's own domain.
            settings: Its settings.
            on_event: Called after each discovery event.
            on_move: Called after each transition of an agent.
        """
        self._node = node
        self._settings = settings
        self._on_event = on_event
        self._warn_once = WarnOnce(_LOG)
        self._registry = Registry(
            settings.agent,
            timing=settings.timing,
            max_agents=settings.max_agents,
            on_move=on_move,
            on_alarm=lambda key, sentence: self._warn_once(key, f"discoverer: {sentence}"),
        )
        self._announced: deque[str] = deque(maxlen=HISTORY - _MARGIN)  # agents of the last events
        self._descriptions = PublishedDescriptions(settings.max_agents)
        self._description_received = asyncio.Event()
        self._limit = QueryLimit(settings.max_queries)
        self._queries: dict[int, asyncio.Task[None]] = {}
        self._deadline_changed = asyncio.Event()
        self._events: Publisher | None = None

    @property
    def states(self) -> dict[str, State]:
        """States of the remote agents, sorted by name."""
        return self._registry.states

    @property
    def counts(self) -> Counter[str]:
        """Numbers of events, see `Registry.counts`.

        ``published`` counts the queries that a published description answered.
        """
        return self._registry.counts

    async def run(self, on_ready: Callable[[], None] = lambda: None) -> None:
        """Run until cancelled, then close everything. `on_ready` is called before the first heartbeat."""
        own_topic = discovery_topic(self._settings.agent)
        self._events = self._node.create_publisher(DISCOVERY_EVENT, own_topic, DISCOVERY_QOS)
        heartbeats = self._node.create_subscription(
            AGENT_HEARTBEAT, heartbeat_topic(), qos=_HEARTBEATS
        )
        subscriptions = [heartbeats]
        bodies = [self._receive_heartbeats(heartbeats), self._watch_time()]
        if self._settings.use_published_descriptions:
            descriptions = self._node.create_subscription(
                AGENT_METADATA, metadata_topic(), qos=_HEARTBEATS, raw=True
            )
            subscriptions.append(descriptions)
            bodies.append(self._receive_descriptions(descriptions))
        on_ready()
        try:
            async with beside(*bodies) as tasks:
                done, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                for task in done:
                    task.result()
        finally:
            await end_tasks(*self._queries.values())
            for subscription in subscriptions:
                subscription.close()
            self._events.close()

    async def _receive_heartbeats(self, heartbeats: Subscription) -> None:
        while True:
            try:
                heartbeat, info = await heartbeats.take_with_info()
            except CdrError:
                self._registry.refuse(Refusal.MALFORMED)
                continue
            orders = self._registry.heard(heartbeat, info.publisher_gid, now_ns=steady_ns())
            self._execute(orders)
            if orders:  # without orders a deadline only moves to a later time
                self._deadline_changed.set()

    async def _receive_descriptions(self, descriptions: Subscription) -> None:
        while True:
            cdr, info = await descriptions.take_with_info()
            refusal = self._descriptions.receive(cdr, info.publisher_gid, now_ns=steady_ns())
            if refusal is None:
                self._description_received.set()
            else:
                publisher = info.publisher_gid.hex()
                sentence = f"discoverer: dropped a description from {publisher}: {refusal.value}"
                self._warn_once(("description", refusal, publisher), sentence)

    async def _watch_time(self) -> None:
        """Process the registry's deadlines, and compensate pauses of this process."""
        now_ns = steady_ns()
        while True:
            self._deadline_changed.clear()
            self._forget_queries()
            since_ns = now_ns
            wake_ns = since_ns + _TICK_NS
            deadline_ns = self._registry.deadline_ns
            if deadline_ns is not None:
                wake_ns = min(wake_ns, deadline_ns)
            changed = await is_set_before(self._deadline_changed, wake_ns / 1e9)
            # A timer may be early by its resolution.
            now_ns = steady_ns() if changed else max(steady_ns(), wake_ns)
            if now_ns - wake_ns > _PAUSE_NS:
                self._registry.compensate_pause(since_ns, now_ns)
            self._execute(self._registry.due(now_ns))

    def _execute(self, orders: Iterable[Order]) -> None:
        for order in orders:
            query = order.query
            if query is None:
                self._announce(order)
            elif order.action is Action.QUERY:
                task = asyncio.create_task(self._query(order, query))
                self._queries[query] = task
                # The next query of the agent may be due before other deadlines.
                task.add_done_callback(lambda _: self._deadline_changed.set())
            elif query in self._queries:
                self._queries[query].cancel()

    def _forget_queries(self) -> None:
        """Forget the queries that have ended, and raise the error of one that failed unexpectedly."""
        ended = {query: task for query, task in self._queries.items() if task.done()}
        for query, task in ended.items():
            del self._queries[query]
            if not task.cancelled():
                task.result()

    async def _query(self, order: Order, query: int) -> None:
        """Get an agent's description and pass it to the registry."""
        agent = order.agent
        metadata = None
        if self._settings.use_published_descriptions:
            metadata = await self._published_description(order)
        if metadata is None:
            async with self._limit.place(order.failures, query):
                metadata = await self._call_service(agent)
        if metadata is None:
            orders = self._registry.failed(agent, query, now_ns=steady_ns())
        else:
            metadata = self._validated(agent, metadata)
            orders = self._registry.answered(agent, query, metadata, now_ns=steady_ns())
        self._execute(orders)

    async def _published_description(self, order: Order) -> Any:
        """Return a published description of an agent; None if it is missing, disputed or not claimed.

        The first query waits for it; later ones take what has come meanwhile.
        """
        end_s = steady_ns() / 1e9 + (0 if order.failures else _PUBLISHED_WAIT_S)
        in_time = True
        while in_time:
            self._description_received.clear()
            metadata = self._descriptions.find(order.agent, order.wanted, self._is_publisher)
            if metadata is not None and self._registry.is_claimed(metadata):
                self._registry.counts["published"] += 1
                return metadata
            in_time = await is_set_before(self._description_received, end_s)
        return None

    def _is_publisher(self, gid: bytes) -> bool:
        publishers = self._node.graph.publishers(metadata_topic())
        return any(endpoint.gid == gid for endpoint in publishers)

    async def _call_service(self, agent: str) -> Any:
        """Call an agent's metadata service. Return None if there is no answer."""
        client = self._node.create_client(GET_METADATA, metadata_service(agent))
        try:
            await client.wait_for_service(_FIND_TIMEOUT_S)
            response = await client.call(
                service_type(GET_METADATA).request(),
                timeout_s=self._settings.query_timeout_s,
                max_bytes=MAX_METADATA_BYTES,
            )
        except SfglabError as error:
            _LOG.info("discoverer: %s", error)
            return None
        finally:
            client.close()
        return response.metadata if response.success else None

    def _validated(self, agent: str, metadata: Any) -> Any:
        """Return the valid parts of a description, and warn about the others."""
        metadata, errors = validated_metadata(metadata)
        for error in errors:
            self._warn_once((agent, error.place), f"discoverer: {agent}: {error}")
        return metadata

    def _announce(self, event: Order | None) -> None:
        """Publish an event, and repeat the events of other agents that late joiners would miss."""
        while event is not None:
            self._publish(event)
            self._on_event(event)
            is_full = len(self._announced) == self._announced.maxlen
            oldest = self._announced[0] if is_full else event.agent
            self._announced.append(event.agent)
            is_missed = oldest not in self._announced
            event = self._registry.announcement(oldest) if is_missed else None

    def _publish(self, event: Order) -> None:
        type_ = message_type(DISCOVERY_EVENT)
        message: Any = type_(
            stamp=stamp_from_ns(self._node.get_clock().now_ns()),
            agent=event.agent,
            event=getattr(type_, event.event),
            metadata=event.metadata,
        )
        assert self._events is not None
        self._events.publish(message)


async def run_discoverer(config: DiscoveryConfig, report: Reporter, _orders: Orders) -> None:
    """Run a discoverer until cancelled.

    Raises:
        BusError: The domain cannot be joined.
    """
    from sfglab.bus import Node

    async with Node(
        "agent_discoverer", **config.address.options(), max_sample_bytes=MAX_SAMPLE_BYTES
    ) as node:
        now_ns = node.get_clock().now_ns

        def report_event(event: Order) -> None:
            values = {
                "agent": event.agent,
                "event": event.event,
                "incarnation": event.incarnation,
            }
            report({"is": "event", **values, "t_ns": now_ns()})

        def report_move(move: Move) -> None:
            values = {
                "agent": move.agent,
                "before": move.before.name,
                "given": move.given.name,
                "after": move.after.name,
                "actions": [action.name for action in move.actions],
            }
            report({"is": "move", **values, "t_ns": now_ns()})

        discoverer = AgentDiscoverer(
            node,
            config.settings,
            on_event=report_event,
            on_move=report_move if config.report_moves else None,
        )
        await discoverer.run(on_ready=lambda: report({"is": "ready"}))


def main() -> None:
    """Run the process."""
    run_component(DiscoveryConfig, run_discoverer)


if __name__ == "__main__":
    main()

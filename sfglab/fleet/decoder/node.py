"""The agent's decoder: starts a pipeline when a local subscriber appears, ends it when the last one leaves.

The thin shell around `lifecycle`, `demand` and `streams` (paper A, section 4.3, Fig. 4): it listens to the
local graph, to discovery events and to its pipeline processes, feeds the tables, and carries out what they
say. Everything happens in one task, one event after the other.
"""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from sfglab.fleet.decoder.agents import agent_changes
from sfglab.fleet.decoder.demand import Demand
from sfglab.fleet.decoder.lifecycle import TRANSITIONS, Action, Input, Lifecycle, State, Timing
from sfglab.fleet.decoder.protocol import Close, Closed, Failed, Open, Opened, Serve, Statistics
from sfglab.fleet.decoder.streams import Route, routes_of_agent
from sfglab.fleet.discovery.listener import Withdrawn

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from sfglab.bus import Node
    from sfglab.bus.api import EndpointEvent
    from sfglab.fleet.decoder.pool import Worker, WorkerPool
    from sfglab.fleet.decoder.protocol import Line
    from sfglab.fleet.discovery.listener import Change


_LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class PipelineStatus:
    """One stream, as the decoder sees it now."""

    local_topic: str  #: The local topic.
    source_topic: str  #: The remote topic.
    state: str  #: Name of the life cycle's state.
    subscribers: int  #: Local subscriptions.
    crashes: int  #: How often its pipeline ended although it was wanted.
    statistics: Statistics | None  #: Its latest counts; None before the first.


@dataclass(slots=True)
class _Pipeline:
    route: Route
    life: Lifecycle
    wanted: bool = False
    worker: Worker | None = None
    statistics: Statistics | None = None
    successor: Route | None = None  # the stream came back while its old pipeline was ending


@dataclass(frozen=True, slots=True)
class _Said:
    """Something a worker said, or None when it is gone."""

    topic: str
    worker: Worker
    line: Line | None


@dataclass(frozen=True, slots=True)
class _Known:
    """What an agent offers from now on; empty when it is lost."""

    agent: str
    routes: tuple[Route, ...] = field(default=())


class AgentDecoder:
    """Demand-driven decoding of remote streams for all subscribers on this device.

    Args:
        local: Node on the local domain.
        pool: Started pool of pipeline processes.
        timing: The waits of every pipeline.
        replay: Whether streams are joined by their replay, where their sender offers one.
        on_status: Called with a stream's status whenever its state or counts change.
    """

    def __init__(
        self,
        local: Node,
        pool: WorkerPool,
        *,
        timing: Timing | None = None,
        replay: bool = True,
        on_status: Callable[[PipelineStatus], None] | None = None,
    ) -> None:
        self._local = local
        self._pool = pool
        self._timing = timing or Timing()
        self._replay = replay
        self._on_status = on_status or (lambda _: None)
        self._demand = Demand()
        self._pipelines: dict[str, _Pipeline] = {}
        self._events: asyncio.Queue[EndpointEvent | _Said | _Known] = asyncio.Queue()

    def offer(self, agent: str, routes: Iterable[Route]) -> None:
        """Offer exactly these streams of an agent from now on; none withdraws the agent.

        Args:
            agent: The remote agent.
            routes: Its streams.
        """
        self._events.put_nowait(_Known(agent, tuple(routes)))

    def hear(self, change: Change) -> None:
        """Take what a remote agent offers from now on, or that it is gone."""
        if isinstance(change, Withdrawn):
            self.offer(change.agent, ())
            return
        routes, errors = routes_of_agent(change.metadata)
        for error in errors:
            _LOG.warning("decoder: %s", error)
        self.offer(change.agent, routes)

    def status(self) -> tuple[PipelineStatus, ...]:
        """Return the state of all streams, ordered by local topic."""
        return tuple(self._status(p) for _, p in sorted(self._pipelines.items()))

    async def run(self, discovery_topic: str | None = None) -> None:
        """Serve until cancelled, then release everything but the pool.

        Args:
            discovery_topic: Where the agent's discoverer announces remote agents; None: nobody does.
        """
        watchers = [asyncio.create_task(self._watch_graph())]
        if discovery_topic is not None:
            watchers.append(asyncio.create_task(self._watch_agents(discovery_topic)))
        try:
            while True:
                for watcher in watchers:
                    if watcher.done():
                        watcher.result()
                await self._step()
        finally:
            for watcher in watchers:
                watcher.cancel()
            await asyncio.gather(*watchers, return_exceptions=True)
            for pipeline in self._pipelines.values():
                if pipeline.worker is not None:
                    pipeline.worker.owner = None
                    await pipeline.worker.end()

    async def _watch_graph(self) -> None:
        async for event in self._local.graph.events():
            self._events.put_nowait(event)

    async def _watch_agents(self, topic: str) -> None:
        async for change in agent_changes(self._local, topic):
            self.hear(change)

    async def _step(self) -> None:
        """Handle the next event, or the timers that ran out before it."""
        now_ns = self._local.get_clock().now_ns()
        deadlines = [p.life.deadline_ns for p in self._pipelines.values() if p.life.deadline_ns is not None]
        wait_s = max(0.0, (min(deadlines) - now_ns) / 1e9) if deadlines else None
        try:
            event = await asyncio.wait_for(self._events.get(), wait_s)
        except TimeoutError:
            await self._run_timers()
            return
        if isinstance(event, _Said):
            await self._heard(event)
        elif isinstance(event, _Known):
            await self._know(event)
        else:
            topic = self._demand.feed(event)
            if topic in self._pipelines:
                await self._follow_demand(self._pipelines[topic])

    async def _run_timers(self) -> None:
        now_ns = self._local.get_clock().now_ns()
        for pipeline in list(self._pipelines.values()):
            if pipeline.life.due(now_ns):
                await self._feed(pipeline, Input.TIMER)

    async def _know(self, known: _Known) -> None:
        offered = {route.local_topic: route for route in known.routes}
        for topic, pipeline in list(self._pipelines.items()):
            if pipeline.route.agent == known.agent and offered.get(topic) != pipeline.route:
                pipeline.successor = offered.pop(topic, None)
                await self._feed(pipeline, Input.WITHDRAWN)
        for topic, route in offered.items():
            known_route = self._pipelines[topic].route if topic in self._pipelines else None
            if known_route is None:
                await self._add(route)
            elif known_route != route:
                _LOG.warning("decoder: %s is offered by %s already", topic, known_route.agent)

    async def _add(self, route: Route) -> None:
        pipeline = self._pipelines[route.local_topic] = _Pipeline(route, Lifecycle(self._timing))
        self._on_status(self._status(pipeline))
        await self._follow_demand(pipeline)

    async def _follow_demand(self, pipeline: _Pipeline) -> None:
        transports = self._demand.transports(pipeline.route.local_topic)
        if bool(transports) != pipeline.wanted:
            pipeline.wanted = bool(transports)
            await self._feed(pipeline, Input.WANTED if transports else Input.UNWANTED)
        elif pipeline.worker is not None and transports:
            pipeline.worker.send(Serve(transports=tuple(sorted(transports))))

    async def _heard(self, said: _Said) -> None:
        pipeline = self._pipelines.get(said.topic)
        if pipeline is None or pipeline.worker is not said.worker:
            return
        if isinstance(said.line, Statistics):
            pipeline.statistics = said.line
            self._on_status(self._status(pipeline))
        elif isinstance(said.line, Opened):
            await self._feed(pipeline, Input.STARTED)
        elif isinstance(said.line, Closed):
            await self._ended(pipeline, reuse=True)
        elif isinstance(said.line, Failed):
            _LOG.warning("decoder: %s: %s", said.topic, said.line.why)
            await self._ended(pipeline, reuse=False)
        elif said.line is None:
            _LOG.warning("decoder: %s: its pipeline process %d is gone", said.topic, said.worker.pid)
            await self._ended(pipeline, reuse=False)

    async def _ended(self, pipeline: _Pipeline, *, reuse: bool) -> None:
        worker, pipeline.worker = pipeline.worker, None
        assert worker is not None
        if reuse:
            await self._pool.take_back(worker)
        else:
            worker.owner = None
            worker.kill()
        await self._feed(pipeline, Input.ENDED)

    async def _feed(self, pipeline: _Pipeline, given: Input) -> None:
        if (pipeline.life.state, given) not in TRANSITIONS:
            return  # a withdrawn stream's demand, for instance, is nobody's business any more
        action = pipeline.life.feed(given, now_ns=self._local.get_clock().now_ns())
        await self._carry_out(pipeline, action)
        self._on_status(self._status(pipeline))
        if pipeline.life.state is State.GONE:
            del self._pipelines[pipeline.route.local_topic]
            if pipeline.successor is not None:
                await self._add(pipeline.successor)

    async def _carry_out(self, pipeline: _Pipeline, action: Action | None) -> None:
        if action is Action.START:
            await self._start(pipeline)
        elif pipeline.worker is not None and action is Action.STOP:
            pipeline.worker.send(Close())
        elif pipeline.worker is not None and action is Action.KILL:
            pipeline.worker.kill()

    async def _start(self, pipeline: _Pipeline) -> None:
        route = pipeline.route

        def pass_on(worker: Worker, line: Line | None) -> None:
            self._events.put_nowait(_Said(route.local_topic, worker, line))

        pipeline.worker = await self._pool.lend(pass_on)
        pipeline.statistics = None
        transports = self._demand.transports(route.local_topic)
        pipeline.worker.send(
            Open(
                source_topic=route.source_topic,
                source_type=route.source_type,
                codec=route.codec,
                local_topic=route.local_topic,
                replay_topic=route.replay_topic if self._replay else "",
                transports=tuple(sorted(transports)),
            )
        )

    def _status(self, pipeline: _Pipeline) -> PipelineStatus:
        return PipelineStatus(
            local_topic=pipeline.route.local_topic,
            source_topic=pipeline.route.source_topic,
            state=pipeline.life.state.name,
            subscribers=self._demand.count(pipeline.route.local_topic),
            crashes=pipeline.life.crashes,
            statistics=pipeline.statistics,
        )

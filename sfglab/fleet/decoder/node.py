"""Agent's decoder: starts a pipeline when a local subscriber appears, ends it when the last one leaves.

The module is an I/O wrapper of `streams` (paper A, section 4.3, Fig. 4). One task handles one event after
the other. As a process (`sfglab decoder`, or ``python -m sfglab.fleet.decoder.node CONFIG``; see
`sfglab.component`) it reports, beside ``ready``, every change of a stream, ``{"is": "status", ...}`` with a
`PipelineStatus`. It answers each order, a JSON object, with ``{"is": "processes", "pids", "warm"}``.
``warm`` states whether a spare pipeline process is ready.
"""

from __future__ import annotations

import asyncio
import logging
import sys
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from signal import SIGKILL
from typing import TYPE_CHECKING

from sfglab.bus.api import OFFER_KEY, EndpointKind, user_data
from sfglab.bus.parameters import Parameters
from sfglab.bus.pubsub import Publisher, topic_endpoint
from sfglab.component import (
    Orders,
    Report,
    Reporter,
    beside,
    next_before,
    run_component,
    steady_ns,
)
from sfglab.fields import from_json
from sfglab.fleet.decoder.config import DecoderConfig
from sfglab.fleet.decoder.pipeline import LOCAL_QOS, Statistics
from sfglab.fleet.decoder.process import Worker, WorkerConfig, WorkerPool
from sfglab.fleet.decoder.streams import (
    Action,
    Input,
    Lifecycle,
    Route,
    State,
    Timing,
    routes_of_agent,
    routes_of_topic,
)
from sfglab.fleet.discovery.listener import Offered, agent_changes
from sfglab.processes import CHECK_PERIOD_S, Watchdog

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Iterable

    from sfglab.bus import Node
    from sfglab.bus.api import EndpointEvent, Transport


_LOG = logging.getLogger(__name__)
_WATCHED = (
    State.STARTING,
    State.RUNNING,
    State.LINGERING,
)  # A spare process may have been stopped while it waited.
#: USER_DATA of writers that only advertise a topic.
OFFER = user_data({OFFER_KEY: "decoder"})


@dataclass(frozen=True, slots=True, kw_only=True)
class PipelineStatus:
    """Current state of one stream in the decoder."""

    local_topic: str  #: Name of the local topic.
    state: str  #: Name of the life cycle's state.
    subscribers: int  #: Number of local subscriptions.
    statistics: Statistics | None  #: Latest counts of the pipeline; None before the first.


@dataclass(slots=True)
class _Pipeline:
    route: Route
    life: Lifecycle
    wanted: bool = False
    # whether subscribers may have received frames of an earlier pipeline or decoder
    seen: bool = False
    worker: Worker | None = None
    statistics: Statistics | None = None
    watch: Watchdog = field(default_factory=Watchdog)
    offer: Publisher | None = None  # advertises the topic; nothing is published


class AgentDecoder:
    """Demand-driven decoding of remote streams for all subscribers on this device; the caller starts the pool.

    With `replay`, a pipeline begins with the GOP replay of its stream, if the sender offers one. With
    `advertise_unused_topics`, every stream has a second writer, which publishes nothing. Its purpose is
    that ROS 2's tools list the topic. `on_status` is called with a stream's status whenever its state or
    counts change.
    """

    def __init__(  # noqa: PLR0913 - by keyword
        self,
        local: Node,
        pool: WorkerPool,
        *,
        timing: Timing | None = None,
        replay: bool = True,
        advertise_unused_topics: bool = True,
        on_status: Callable[[PipelineStatus], None] | None = None,
    ) -> None:
        self._local = local
        self._advertises = advertise_unused_topics
        self._pool = pool
        self._timing = timing or Timing()
        self._replay = replay
        self._on_status = on_status or (lambda _: None)
        self._pipelines: dict[str, _Pipeline] = {}
        # Routes by local topic and agent, in their order: the first one is decoded until it is withdrawn.
        self._offered: dict[str, dict[str, Route]] = {}
        self._events: asyncio.Queue[Callable[[], Awaitable[None]]] = asyncio.Queue()

    def offer(self, agent: str, routes: Iterable[Route]) -> None:
        """Decode exactly these streams of a remote agent on demand; an empty sequence withdraws the agent."""
        self._events.put_nowait(partial(self._know, agent, tuple(routes)))

    async def run(self, discovery_topic: str = "") -> None:
        """Serve until cancelled, then release everything except the pool; the discoverer's topic may be empty."""
        watched = [self._watch_workers()]
        watched += [self._watch_agents(discovery_topic)] if discovery_topic else []
        unlisten = self._local.graph.listen(self._note_subscription)
        try:
            async with beside(*watched) as watchers:
                while True:
                    for watcher in watchers:
                        if watcher.done():
                            watcher.result()
                    await self._step()
        finally:
            unlisten()
            for pipeline in self._pipelines.values():
                if pipeline.worker is not None:
                    await pipeline.worker.end()

    def _note_subscription(self, event: EndpointEvent) -> None:
        if event.endpoint.kind is EndpointKind.SUBSCRIPTION:
            self._events.put_nowait(partial(self._see, event.endpoint.topic))

    async def _watch_workers(self) -> None:
        """End unresponsive pipeline processes by force; they are replaced as after a crash."""
        while True:
            await asyncio.sleep(CHECK_PERIOD_S)
            for pipeline in self._pipelines.values():
                worker = pipeline.worker if pipeline.life.state in _WATCHED else None
                if worker is not None and (why := pipeline.watch.check(worker.pid)):
                    _LOG.warning(
                        "decoder: %s: its pipeline process: %s", pipeline.route.local_topic, why
                    )
                    worker.signal(SIGKILL)

    async def _watch_agents(self, topic: str) -> None:
        async for change in agent_changes(self._local, topic):
            routes: tuple[Route, ...] = ()
            if isinstance(change, Offered):
                routes, errors = routes_of_agent(change.metadata)
                for error in errors:
                    _LOG.warning("decoder: %s", error)
            self.offer(change.agent, routes)

    async def _step(self) -> None:
        """Handle the expired timers, or the next event that comes before them."""
        deadlines = [pipeline.life.deadline_ns for pipeline in self._pipelines.values()]
        event = await next_before(self._events, deadlines)
        await (event or self._run_timers)()

    async def _see(self, topic: str) -> None:
        if topic in self._pipelines:
            await self._follow_demand(self._pipelines[topic])

    async def _run_timers(self) -> None:
        now_ns = steady_ns()
        for pipeline in list(self._pipelines.values()):
            if pipeline.life.due(now_ns):
                await self._feed(pipeline, Input.TIMER)

    async def _know(self, agent: str, routes: tuple[Route, ...]) -> None:
        offered = {route.local_topic: route for route in routes}
        for topic in [topic for topic, by_agent in self._offered.items() if agent in by_agent]:
            if topic not in offered:
                del self._offered[topic][agent]
                await self._settle(topic)
        for topic, route in offered.items():
            by_agent = self._offered.setdefault(topic, {})
            if by_agent and agent not in by_agent:
                _LOG.warning("decoder: %s is offered by %s already", topic, next(iter(by_agent)))
            by_agent[agent] = route
            await self._settle(topic)

    async def _settle(self, topic: str) -> None:
        """Decode a topic of the first agent that has it, after the pipeline of another agent has gone."""
        by_agent = self._offered.get(topic, {})
        pipeline = self._pipelines.get(topic)
        if not by_agent:
            self._offered.pop(topic, None)
        if pipeline is None and by_agent:
            await self._add(next(iter(by_agent.values())))
        elif pipeline is not None and by_agent.get(pipeline.route.agent) != pipeline.route:
            await self._feed(pipeline, Input.WITHDRAWN)

    async def _add(self, route: Route) -> None:
        pipeline = self._pipelines[route.local_topic] = _Pipeline(route, Lifecycle(self._timing))
        if self._advertises:
            endpoint = topic_endpoint(
                route.local_type, route.local_topic, LOCAL_QOS, user_data=OFFER
            )
            pipeline.offer = Publisher(self._local.backend, endpoint)
        self._on_status(self._status(pipeline))
        pipeline.seen = bool(self._subscribed(route))
        await self._follow_demand(pipeline)

    async def _follow_demand(self, pipeline: _Pipeline) -> None:
        transports = self._subscribed(pipeline.route)
        if bool(transports) != pipeline.wanted:
            pipeline.wanted = bool(transports)
            await self._feed(pipeline, Input.WANTED if transports else Input.UNWANTED)
        elif pipeline.worker is not None and transports:
            pipeline.worker.order(do="serve", transports=sorted(set(transports)))

    def _subscribed(self, route: Route) -> list[Transport]:
        """Return the transport of each local subscription of a stream."""
        return [end.transport for end in self._local.graph.subscriptions(route.local_topic)]

    async def _heard(self, topic: str, worker: Worker, report: Report) -> None:
        pipeline = self._pipelines.get(topic)
        if pipeline is None or pipeline.worker is not worker:
            return
        match report["is"]:
            case "statistics":
                pipeline.watch.beat()
                pipeline.statistics = from_json(Statistics, report)
                self._on_status(self._status(pipeline))
            case "opened":
                await self._feed(pipeline, Input.STARTED)
            case "closed":
                await self._ended(pipeline, reuse=True)
            case "broken" | "failed":
                _LOG.warning("decoder: %s: %s", topic, report["why"])
                await self._ended(pipeline, reuse=False)
            case "ended":
                _LOG.warning("decoder: %s: its pipeline process %d is gone", topic, worker.pid)
                await self._ended(pipeline, reuse=False)

    async def _ended(self, pipeline: _Pipeline, *, reuse: bool) -> None:
        worker, pipeline.worker = pipeline.worker, None
        assert worker is not None
        if reuse:
            await self._pool.release(worker)
        else:
            worker.signal(SIGKILL)
        await self._feed(pipeline, Input.ENDED)

    async def _feed(self, pipeline: _Pipeline, given: Input) -> None:
        if not pipeline.life.allows(given):
            return  # such as demand for a stream that was withdrawn
        action = pipeline.life.feed(given, now_ns=steady_ns())
        if action is Action.START:
            await self._start(pipeline)
        elif pipeline.worker is not None and action is Action.STOP:
            pipeline.worker.order(do="close")
        elif pipeline.worker is not None and action is Action.KILL:
            pipeline.worker.signal(SIGKILL)
        pipeline.seen &= pipeline.life.state is not State.IDLE
        self._on_status(self._status(pipeline))
        if pipeline.life.state is State.GONE:
            del self._pipelines[pipeline.route.local_topic]
            if pipeline.offer is not None:
                pipeline.offer.close()
            await self._settle(pipeline.route.local_topic)

    async def _start(self, pipeline: _Pipeline) -> None:
        route = pipeline.route

        def pass_on(worker: Worker, report: Report) -> None:
            self._events.put_nowait(partial(self._heard, route.local_topic, worker, report))

        pipeline.worker = await self._pool.acquire(pass_on)
        newest = pipeline.statistics.newest if pipeline.statistics else -1
        after = sys.maxsize if pipeline.seen else newest
        pipeline.statistics, pipeline.watch, pipeline.seen = None, Watchdog(), True
        stream = replace(
            route, after=after, replay_topic=route.replay_topic if self._replay else ""
        )
        transports = sorted(set(self._subscribed(route)))
        pipeline.worker.order(do="open", stream=stream, transports=transports)

    def _status(self, pipeline: _Pipeline) -> PipelineStatus:
        return PipelineStatus(
            local_topic=pipeline.route.local_topic,
            state=pipeline.life.state.name,
            subscribers=len(self._subscribed(pipeline.route)),
            statistics=pipeline.statistics,
        )


async def run_decoder(
    config: DecoderConfig,
    *,
    on_status: Callable[[PipelineStatus], None] = lambda _: None,
    on_ready: Callable[[WorkerPool], None] = lambda _: None,
) -> None:
    """Run a decoder until cancelled; everything it started has ended when this returns.

    `on_status` is called whenever a stream's state or counts change, `on_ready` once when it serves.

    Raises:
        StreamError: One of the configured streams cannot be offered.
        BusError: The local domain cannot be joined.
        ProcessFailedError: No pipeline process can be started, as when the remote domain cannot be joined.
    """
    from sfglab.bus import Node

    routes = [route for topic in config.streams for route in routes_of_topic(topic)]
    workers = WorkerConfig(remote=config.remote, local=config.local)
    pool = WorkerPool(workers, spare=config.spare, refill=config.refill)
    # The node is created first, so that a wrong domain or interface is reported once and not by each
    # process.
    async with Node("agent_decoder", **asdict(config.local)) as local:
        if config.parameters is not None:
            Parameters(local, config, config.parameters)
        try:
            await pool.start()
            timing = Timing(linger_ns=round(config.idle_timeout_s * 1e9))
            decoder = AgentDecoder(
                local,
                pool,
                timing=timing,
                replay=config.replay,
                advertise_unused_topics=config.advertise_unused_topics,
                on_status=on_status,
            )
            for agent in sorted({route.agent for route in routes}):
                decoder.offer(agent, [route for route in routes if route.agent == agent])
            on_ready(pool)
            await decoder.run(config.discovery_topic)
        finally:
            await pool.close()


async def serve(config: DecoderConfig, report: Reporter, orders: Orders) -> None:
    """Run a decoder that reports; once it is ready, answer each order with its processes."""
    serving: asyncio.Future[WorkerPool] = asyncio.get_running_loop().create_future()

    def ready(pool: WorkerPool) -> None:
        serving.set_result(pool)
        report({"is": "ready"})

    async def answer() -> None:
        pool = await serving
        while True:
            await orders.get()
            report({"is": "processes", "pids": pool.pids, "warm": pool.warm})

    async with beside(answer()):
        await run_decoder(
            config, on_status=lambda s: report({"is": "status", **asdict(s)}), on_ready=ready
        )


if __name__ == "__main__":
    run_component(DecoderConfig, serve)

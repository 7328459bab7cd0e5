"""The decoder as a process: `sfglab decoder`, or ``python -m sfglab.fleet.decoder CONFIG``; see `component`.

Puts node, pool and bus together and ends them in order. Beside ``ready`` it reports every change of a stream,
``{"is": "status", ...}`` with a `PipelineStatus`. Any order, a JSON object, is answered with ``{"is":
"processes", "pids", "warm"}``: what belongs to the decoder, and whether a spare pipeline process is warm.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import signal
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from sfglab.fleet.address import BusAddress
from sfglab.fleet.component import run_component
from sfglab.fleet.decoder.lifecycle import Timing
from sfglab.fleet.decoder.node import AgentDecoder
from sfglab.fleet.decoder.pool import WorkerPool
from sfglab.fleet.decoder.streams import routes_of_topic
from sfglab.fleet.decoder.worker import WorkerConfig

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.fleet.component import Report
    from sfglab.fleet.decoder.node import PipelineStatus


@dataclass(frozen=True, slots=True, kw_only=True)
class DecoderConfig:
    """What a decoder process is told."""

    remote: BusAddress  #: Where remote streams arrive.
    local: BusAddress  #: Where local subscribers are.
    streams: tuple[str, ...] = ()  #: Remote topics to offer from the start, by their names in the schema.
    discovery_topic: str = ""  #: Topic of discovery events; empty: none is listened to.
    linger_s: float = 1.0  #: How long a pipeline outlives its last subscriber, seconds.
    #: Whether streams are joined by their sender's replay, if it offers one; in paper A the decoder waits for
    #: the next key frame.
    replay: bool = True
    #: Whether a pipeline process waits, warm, for the next stream; in paper A it is loaded on demand.
    spare: bool = True

    def to_json(self) -> str:
        """Return the configuration as a process's argument."""
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> DecoderConfig:
        """Read what `to_json` wrote."""
        values = json.loads(text)
        values["remote"], values["local"] = BusAddress(**values["remote"]), BusAddress(**values["local"])
        return cls(**{**values, "streams": tuple(values["streams"])})


async def run_decoder(
    config: DecoderConfig,
    *,
    on_status: Callable[[PipelineStatus], None],
    on_ready: Callable[[WorkerPool], None] = lambda _: None,
) -> None:
    """Run a decoder until cancelled; everything it started has ended when this returns.

    Args:
        config: Where and what.
        on_status: Called whenever a stream's state or counts change.
        on_ready: Called once when it serves.

    Raises:
        StreamError: One of the configured streams cannot be offered.
        BusError: The local domain cannot be joined.
        PoolError: No pipeline process can be started, as when the remote domain cannot be joined.
    """
    from sfglab.bus import Node

    routes = [route for topic in config.streams for route in routes_of_topic(topic)]
    workers = WorkerConfig(remote=config.remote, local=config.local)
    pool = WorkerPool(workers, spares=int(config.spare))
    # The node first: what is wrong with the domain or interface is said once, here, and not by processes.
    async with Node("agent_decoder", **asdict(config.local)) as local:
        try:
            await pool.start()
            timing = Timing(linger_ns=round(config.linger_s * 1e9))
            decoder = AgentDecoder(local, pool, timing=timing, replay=config.replay, on_status=on_status)
            for agent in sorted({route.agent for route in routes}):
                decoder.offer(agent, [route for route in routes if route.agent == agent])
            on_ready(pool)
            await decoder.run(config.discovery_topic or None)
        finally:
            await pool.close()


def main(argument: str) -> None:
    """Be the process: serve until standard input ends or until told to terminate."""
    orders: asyncio.Queue[Report] = asyncio.Queue()

    async def body(report: Callable[[Report], None]) -> None:
        await _serve(DecoderConfig.from_json(argument), report, orders)

    run_component(body, on_order=orders.put_nowait)


async def _serve(
    config: DecoderConfig, report: Callable[[Report], None], orders: asyncio.Queue[Report]
) -> None:
    """Run a decoder that reports, and answer orders once it serves."""
    answering: list[asyncio.Task[None]] = []

    async def answer(pool: WorkerPool) -> None:
        while True:
            await orders.get()
            report({"is": "processes", "pids": pool.pids, "warm": pool.warm})

    def ready(pool: WorkerPool) -> None:
        answering.append(asyncio.create_task(answer(pool)))
        report({"is": "ready"})

    try:
        await run_decoder(config, on_status=lambda s: report({"is": "status", **asdict(s)}), on_ready=ready)
    finally:
        for task in answering:
            task.cancel()
        await asyncio.gather(*answering, return_exceptions=True)


async def serve_terminal(config: DecoderConfig, say: Callable[[str], None]) -> None:
    """Run a decoder for a person at a terminal, until interrupted or terminated.

    Args:
        config: Where and what.
        say: Takes a line for each change of a stream's state.
    """
    states: dict[str, str] = {}

    def note(status: PipelineStatus) -> None:
        if states.get(status.local_topic) != status.state:
            states[status.local_topic] = status.state
            who = f"{status.subscribers} subscriber{'' if status.subscribers == 1 else 's'}"
            say(f"{status.local_topic}: {status.state.lower()}, {who}  (from {status.source_topic})")

    running = asyncio.create_task(
        run_decoder(config, on_status=note, on_ready=lambda _: say("decoder: ready, end it with Ctrl-C"))
    )
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, running.cancel)
    with contextlib.suppress(asyncio.CancelledError):
        await running
    say("decoder: everything is released")

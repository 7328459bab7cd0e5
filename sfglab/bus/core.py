"""What a live node owns, apart from the node itself.

Threads, callbacks and sockets refer to the core and never to the `Node`, so a node that a notebook forgot is
collected, and its finalizer closes the core.
"""

from __future__ import annotations

import asyncio
import secrets
from functools import partial
from typing import TYPE_CHECKING, Any, Protocol

from sfglab.bus.bridge import LoopBridge
from sfglab.bus.calls import Calls, OnError
from sfglab.bus.dds.discovery import Discovery
from sfglab.bus.dds.participant import DdsParticipant
from sfglab.bus.dds.presence import Presence
from sfglab.bus.graph import Graph
from sfglab.bus.host import host_id
from sfglab.bus.transports import open_service_side
from sfglab.bus.userdata import HOST_KEY, NODE_KEY, user_data

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.dds.config import DomainConfig
    from sfglab.bus.inbox import Inbox
    from sfglab.bus.transports import ServiceReader, ServiceSide, ServiceWriter


class Owned(Protocol):
    """Something that ends with its node."""

    def close(self) -> None:
        """Release what it holds."""


class Core:
    """A participant, its graph, and the endpoints, timers and tasks to end.

    Args:
        name: The node's full name.
        config: The DDS domain.
        on_error: Told about exceptions in callbacks; None logs them.
        presence: Whether ROS 2's tools shall see the node as one.
    """

    def __init__(self, name: str, config: DomainConfig, on_error: OnError | None, *, presence: bool) -> None:
        self.loop = asyncio.get_running_loop()
        self.bridge = LoopBridge(self.loop)
        self.graph = Graph(self.loop, read_nodes=self._read_nodes)
        self.closed = False
        self._on_error = on_error
        self._owned: list[Owned] = []
        self._tasks: set[asyncio.Task[Any]] = set()
        identity = user_data({"enclave": "/", NODE_KEY: name, HOST_KEY: host_id()})
        self.participant = DdsParticipant(
            config, identity, name=f"sfglab {name}", after_round=self.bridge.flush
        )
        post = partial(_post, self.bridge, self.graph.apply)
        self._discovery = Discovery(self.participant, post)
        if presence:
            self.own(Presence(self.participant, self.graph, name, loop=self.loop))

    def calls(self, where: str) -> Calls:
        """Return a runner for the callbacks of one endpoint."""
        return Calls(self._tasks, where, self._on_error)

    def random_bytes(self, count: int) -> bytes:
        """Return bytes that no other node will have."""
        return secrets.token_bytes(count)

    def open_service_side(
        self, side: ServiceSide, *, inbox: Inbox, notify: Callable[[], None]
    ) -> tuple[ServiceWriter, ServiceReader]:
        """Return what one side of a service sends and receives by."""
        return open_service_side(self, side, inbox=inbox, notify=notify)

    def own(self, thing: Owned) -> None:
        """Close `thing` when the node closes."""
        self._owned.append(thing)

    def disown(self, thing: Owned) -> None:
        """Forget a thing that was closed before its node."""
        if thing in self._owned:
            self._owned.remove(thing)

    def close(self) -> None:
        """End everything now; from any thread, also without a running loop; again is harmless."""
        if self.closed:
            return
        self.closed = True
        self.participant.waiter.stop()
        if self.loop.is_running() and _running_loop() is not self.loop:
            self.loop.call_soon_threadsafe(self._close_owned)
        else:
            self._close_owned()

    async def ended(self) -> None:
        """Return when the callbacks that `close` cancelled have ended."""
        tasks = self._tasks - {asyncio.current_task()}
        if tasks:
            await asyncio.wait(tasks)

    def _read_nodes(self) -> None:
        if not self.closed:
            self._discovery.read_nodes(partial(_post, self.bridge, self.graph.learn_nodes))

    def _close_owned(self) -> None:
        for thing in reversed(self._owned):
            thing.close()
        self._owned.clear()
        if not self.loop.is_closed():
            self.graph.close()
            for task in self._tasks - {_current_task()}:
                task.cancel()
        self.participant.close()


def _post(bridge: LoopBridge, take: Callable[..., None], *values: Any) -> None:
    bridge.post(partial(take, *values))


def _running_loop() -> asyncio.AbstractEventLoop | None:
    try:
        return asyncio.get_running_loop()
    except RuntimeError:
        return None


def _current_task() -> asyncio.Task[Any] | None:
    return asyncio.current_task() if _running_loop() is not None else None

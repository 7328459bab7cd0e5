"""Live bridge: subscriptions for the displays of a session, and a thread that draws.

The memory is bounded even if a viewer is slow. A subscription keeps as many messages as its QoS allows, and a
display as many sets as its queue holds. One job at a time is drawn, and the canvas waits while too many bytes are
in flight to the outputs. Messages that do not fit are counted and dropped; other displays do not wait.
"""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack, closing, suppress
from dataclasses import replace
from typing import TYPE_CHECKING, Self

from sfglab.bus import (
    ClosedError,
    EndpointEvent,
    EndpointKind,
    EndpointRemoved,
    Node,
)
from sfglab.bus.api import OFFER_KEY, entries
from sfglab.bus.listing import requested
from sfglab.component import end_tasks
from sfglab.errors import SfglabError
from sfglab.qos import Durability, QoSProfile, Reliability
from sfglab.view.arrivals import Arrival
from sfglab.view.stage import Stage, Surface

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from sfglab.view.session import Session

_TICK_S = 0.05
_MOST_DISPLAYS = 500
"""Largest number of displays that are added automatically, as a protection against a flood of topics."""

_Key = tuple[str, str, QoSProfile]


def strongest(profiles: Iterable[QoSProfile]) -> QoSProfile:
    """Return the QoS of one subscription for several displays: the strictest policies and the largest depth."""
    first, *others = profiles
    for other in others:
        depth = max(first.depth, other.depth)
        if other.reliability is Reliability.RELIABLE:
            first = replace(first, reliability=other.reliability)
        if other.durability is Durability.TRANSIENT_LOCAL:
            first = replace(first, durability=other.durability)
        first = replace(first, depth=depth)
    return first


class Bridge:
    """Bridge that shows the displays of a session live, until closed.

    ```python
    async with Node("view", domain_id=0) as node, Bridge(node, session, open_canvas(["viewer"])):
        ...
    ```

    Args:
        node: Node in the displayed domain; the bridge does not close it.
        session: Displays to show; they may change at any time, on the loop's thread.
        surface: Canvas to draw on; closed with the bridge.
        follow: Prefixes of topic names. A display is added for each such topic that has a visualizer.
            ``("/",)`` means all topics, the empty tuple none.
    """

    def __init__(
        self, node: Node, session: Session, surface: Surface, *, follow: tuple[str, ...] = ()
    ) -> None:
        self._node = node
        self._session = session
        self._surface = surface
        self._follow = follow
        self._stage = Stage(session)
        self._readers: dict[_Key, asyncio.Task[None]] = {}
        self._types: dict[str, str] = {}
        self._offered: set[tuple[str, str]] = set()
        self._changed = asyncio.Event()
        self._received = asyncio.Event()
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="sfglab-view")
        self._ends = AsyncExitStack()

    async def __aenter__(self) -> Self:
        self._ends.callback(self._thread.shutdown, wait=False)
        self._ends.push_async_callback(self._in_thread, self._surface.close)
        self._ends.callback(self._stage.close)
        self._drawing = asyncio.create_task(self._draw())
        self._arranging = asyncio.create_task(self._arrange_on_change())
        self._ends.push_async_callback(self._end_tasks)
        self._ends.callback(self._node.graph.listen(self._heard))
        self._ends.callback(self._session.listen(self._changed.set))
        return self

    async def __aexit__(self, *_: object) -> None:
        await self.close()

    async def failed(self) -> None:
        """Wait for the error that ends the bridge, and raise it; the method never returns.

        Raises:
            SinkError: The output no longer accepts data.
        """
        tasks = self._drawing, self._arranging
        ended, _ = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        for task in ended:
            task.result()

    async def close(self) -> None:
        """End subscriptions and drawing, send the remaining data and close the surface; idempotent."""
        await self._ends.aclose()

    async def _in_thread(self, job: Callable[..., None], *arguments: Surface) -> None:
        """Run a function in the drawing thread, after the thread's present job."""
        await asyncio.get_running_loop().run_in_executor(self._thread, job, *arguments)

    async def _end_tasks(self) -> None:
        await end_tasks(self._arranging, self._drawing, *self._readers.values())

    def _heard(self, event: EndpointEvent) -> None:
        endpoint = event.endpoint
        if endpoint.kind is not EndpointKind.PUBLISHER or isinstance(event, EndpointRemoved):
            return
        # Topics that are only advertised are not followed, because a subscription would start their decoders.
        offered = OFFER_KEY in entries(endpoint.user_data)
        if endpoint.type and endpoint.topic.startswith(self._follow) and not offered:
            self._types[endpoint.topic] = endpoint.type
        self._changed.set()

    def _add_offers(self) -> None:
        """Add each offer once: a display that was removed is not added again."""
        for offer in self._session.offers(self._types):
            key = offer.kind, next(iter(offer.topics.values()))
            if key not in self._offered and len(self._session.displays) < _MOST_DISPLAYS:
                self._offered.add(key)
                self._session.add_offer(offer)

    async def _arrange_on_change(self) -> None:
        """Keep exactly one subscription for each wanted topic, type and QoS, after every change of the displays.

        Changes that come together are handled together, because thousands of endpoints may be discovered at once.
        """
        while True:
            await self._changed.wait()
            self._add_offers()
            self._changed.clear()
            wanted = set(self._wanted())
            for key in self._readers.keys() - wanted:
                self._readers.pop(key).cancel()
            for key in wanted - self._readers.keys():
                self._readers[key] = asyncio.create_task(self._read(*key))

    def _wanted(self) -> Iterable[_Key]:
        """Yield one subscription per topic and type, for all displays of the topic together."""
        profiles: dict[tuple[str, str], list[QoSProfile]] = {}
        for display in self._session.displays:
            for given, topic, profile in display.inputs if display.enabled else ():
                offers = [e.qos for e in self._node.graph.publishers(topic) if e.type == given.type]
                adapted = profile if given.role in display.qos else requested(profile, offers)
                profiles.setdefault((topic, given.type), []).append(adapted)
        for (topic, type_name), asked in profiles.items():
            yield topic, type_name, strongest(asked)

    async def _read(self, topic: str, type_name: str, qos: QoSProfile) -> None:
        try:
            subscription = self._node.create_subscription(type_name, topic, qos=qos, raw=True)
        except SfglabError as error:
            self._complain(topic, type_name, str(error))
            return
        with closing(subscription), suppress(ClosedError):
            while True:
                cdr, info = await subscription.take_with_info()
                self._stage.deliver(Arrival(topic, type_name, info.received_timestamp_ns, cdr))
                self._received.set()

    def _complain(self, topic: str, type_name: str, why: str) -> None:
        for display in self._session.displays:
            if any((bound, given.type) == (topic, type_name) for given, bound, _ in display.inputs):
                display.fail(why)

    async def _draw(self) -> None:
        while True:
            with suppress(TimeoutError):
                async with asyncio.timeout(_TICK_S):
                    await self._received.wait()
            self._received.clear()
            for job in self._stage.jobs(self._node.get_clock().now_ns()):
                await self._in_thread(job, self._surface)

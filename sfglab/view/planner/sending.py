"""Sending of a trajectory from the inspector to an action server. Paper A, section 4.5.

The bus needs an asyncio event loop, which has a thread of its own. Node and thread begin with the first goal,
so that an editor that sends nothing joins no DDS domain.
"""

from __future__ import annotations

import asyncio
import contextlib
import threading
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.spatial.execution.client import Execution, trajectory_order
from sfglab.spatial.execution.orders import action_name

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine

    from sfglab.bus import Node
    from sfglab.spatial.execution.orders import Feedback, Order
    from sfglab.spatial.scene.tree import Scene

_CLOSE_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Sending:
    """State of a trajectory that was sent, or that can be."""

    running: bool = False  #: Whether the goal is on its way.
    share: float = 0.0  #: Share of the trajectory's duration that is over, 0 to 1.
    text: str = "not sent"  #: Feedback or result, in words.


class Sender:
    """Sends trajectories and keeps the state of each, by the id of the trajectory.

    Args:
        node: Function that makes the node of the client.
        on_state: Called with the id of a trajectory when its state changed, from another thread.
    """

    def __init__(self, node: Callable[[], Node], on_state: Callable[[int], None]) -> None:
        self.states: dict[int, Sending] = {}  #: Last states.
        self._make_node = node
        self._on_state = on_state
        self._node: Node | None = None
        self._joining = asyncio.Lock()  # two goals at once join the domain once
        self._executions: dict[int, Execution] = {}
        self._tasks: set[asyncio.Task[None]] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._thread: threading.Thread | None = None

    def send(self, id_: int, order: Order, action: str) -> None:
        """Send an order to an action server; nothing happens while the trajectory is on its way."""
        if self.states.get(id_, Sending()).running:
            return
        self._tell(id_, Sending(running=True, text=f"waiting for {action}"))
        self._run(self._carry_out(id_, order, action))

    def cancel(self, id_: int) -> None:
        """Cancel the goal of a trajectory; its agent brakes."""
        if id_ in self._executions:
            self._run(self._cancel(id_))

    def close(self) -> None:
        """Cancel all goals, wait some seconds until their agents stand, and leave the bus."""
        if self._loop is None or self._thread is None:
            return
        asyncio.run_coroutine_threadsafe(self._close(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()
        self._loop = self._thread = None

    def _run(self, work: Coroutine[Any, Any, None]) -> None:
        if self._loop is None:
            self._loop = asyncio.new_event_loop()
            self._thread = threading.Thread(
                target=self._loop.run_forever, name="planner-bus", daemon=True
            )
            self._thread.start()
        self._loop.call_soon_threadsafe(self._start, work)

    def _start(self, work: Coroutine[Any, Any, None]) -> None:
        task = asyncio.ensure_future(work)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)

    async def _carry_out(self, id_: int, order: Order, action: str) -> None:
        def on_feedback(feedback: Feedback) -> None:
            text = f"{feedback.share:.0%}, {feedback.error_m:.2f} m from the plan"
            self._tell(id_, Sending(running=True, share=feedback.share, text=text))

        try:
            async with self._joining:
                if self._node is None:
                    self._node = await self._make_node().__aenter__()
            execution = Execution(self._node, order.agent, action=action, on_feedback=on_feedback)
            self._executions[id_] = execution
            try:
                await execution.begin(order)
                text = str(await execution.result())
            finally:
                execution.close()
                del self._executions[id_]
        except SfglabError as error:
            text = str(error)
        self._tell(id_, replace(self.states[id_], running=False, text=text))

    async def _cancel(self, id_: int) -> None:
        if id_ in self._executions:
            with contextlib.suppress(SfglabError):  # the goal ends with the same error
                await self._executions[id_].cancel()

    async def _close(self) -> None:
        running = list(self._tasks)
        for id_ in list(self._executions):
            self._start(self._cancel(id_))
        if running:
            await asyncio.wait(running, timeout=_CLOSE_S)
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._tasks, return_exceptions=True)
        if self._node is not None:
            await self._node.close()

    def _tell(self, id_: int, state: Sending) -> None:
        self.states[id_] = state
        self._on_state(id_)


def usual_action(scene: Scene, trajectory: int) -> str:
    """Return the default action of a trajectory's agent; empty if it has none with a name of ROS 2."""
    order = trajectory_order(scene, trajectory)
    if order is None:
        return ""
    try:
        return action_name(order.agent)
    except SfglabError:
        return ""

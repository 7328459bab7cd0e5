"""Sending of a trajectory from the inspector to an action server. Paper A, section 4.5.

The node starts with the first goal, so that an editor that sends nothing joins no DDS domain.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from sfglab.errors import SfglabError
from sfglab.spatial.execution.client import Execution, trajectory_order
from sfglab.spatial.execution.orders import action_name

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus import Node
    from sfglab.spatial.execution.orders import Feedback, Order
    from sfglab.spatial.scene.tree import Scene

_log = logging.getLogger(__name__)
_CLOSE_S = 5.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Sending:
    """State of the execution of one trajectory, as sent to an agent's action server."""

    running: bool = False  #: Whether a goal was sent and has not ended.
    share: float = 0.0  #: Share of the trajectory's duration that is over, 0 to 1.
    text: str = "not sent"  #: Feedback or result, in words.


class Sender:
    """Sends trajectories and keeps the state of each, by the id of the trajectory; used in one event loop.

    Args:
        node: Function that makes the node of the client.
        on_state: Called with the id of a trajectory when its state changed.
    """

    def __init__(self, node: Callable[[], Node], on_state: Callable[[int], None]) -> None:
        self.states: dict[int, Sending] = {}  #: Last states.
        self._make_node = node
        self._on_state = on_state
        self._node: Node | None = None
        self._goals: dict[int, asyncio.Task[None]] = {}
        self._executions: dict[int, Execution] = {}  # of the goals that are sent
        self._cancellations: set[asyncio.Task[None]] = set()

    def send(self, id_: int, order: Order, action: str) -> None:
        """Send an order to an action server; without effect while a goal of the trajectory has not ended."""
        if id_ not in self._goals:
            self._show(id_, Sending(running=True, text=f"waiting for {action}"))
            self._goals[id_] = asyncio.ensure_future(self._carry_out(id_, order, action))
            self._goals[id_].add_done_callback(lambda _: self._goals.pop(id_))

    def cancel(self, id_: int) -> None:
        """Cancel the goal of a trajectory, if any; its agent brakes."""
        if id_ in self._executions:
            task = asyncio.ensure_future(self._cancel(self._executions[id_]))
            self._cancellations.add(task)
            task.add_done_callback(self._cancellations.discard)

    async def close(self) -> None:
        """Cancel all goals, wait some seconds until their agents stand, and leave the bus."""
        goals = dict(self._goals)
        for id_, goal in goals.items():
            if id_ in self._executions:
                self.cancel(id_)
            else:
                goal.cancel()
        if goals:
            await asyncio.wait(goals.values(), timeout=_CLOSE_S)
        left = [*goals.values(), *self._cancellations]
        for task in left:
            task.cancel()
        await asyncio.gather(*left, return_exceptions=True)
        if self._node is not None:
            await self._node.close()

    async def _carry_out(self, id_: int, order: Order, action: str) -> None:
        def on_feedback(feedback: Feedback) -> None:
            text = f"{feedback.share:.0%}, {feedback.error_m:.2f} m from the plan"
            self._show(id_, Sending(running=True, share=feedback.share, text=text))

        try:
            node = self._joined()
            execution = Execution(node, order.agent, action=action, on_feedback=on_feedback)
            self._executions[id_] = execution
            try:
                await execution.begin(order)
                text = str(await execution.result())
            finally:
                execution.close()
                del self._executions[id_]
        except SfglabError as error:
            text = str(error)
        except Exception as error:  # noqa: BLE001 - Send must be enabled again
            _log.exception("the scene editor failed to send a trajectory")
            text = repr(error)
        self._show(id_, replace(self.states[id_], running=False, text=text))

    def _joined(self) -> Node:
        """Return the node, which joins the domain with the first goal; after an error the next goal tries again."""
        if self._node is None:
            node = self._make_node()
            node.start()
            self._node = node
        return self._node

    async def _cancel(self, execution: Execution) -> None:
        with contextlib.suppress(SfglabError):  # the goal ends with the same error
            await execution.cancel()

    def _show(self, id_: int, state: Sending) -> None:
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

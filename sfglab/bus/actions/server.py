"""An action's server as its user holds it: three services and two topics around `Goals`."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.bus.actions.engine import Goals
from sfglab.bus.actions.wire import CANCEL_GOAL, FEEDBACK_QOS, STATUS, STATUS_QOS, action_topics
from sfglab.bus.service import Service
from sfglab.messages import action_type

if TYPE_CHECKING:
    from typing import Unpack

    from sfglab.bus.actions.engine import ActionServerOptions, ExecuteCallback
    from sfglab.bus.core import Core
    from sfglab.bus.publisher import Publisher


class ActionServer:
    """An action's server; made by `Node.create_action_server`.

    Goals run beside each other, each in a task of its own. The execute callback is given a
    `ServerGoalHandle`, says by `succeed`, `abort` or `canceled` how the goal ends, and returns the result. One
    that raises is reported; then, and when it says nothing, the goal is aborted. None stands for a result of
    zeros.
    """

    def __init__(
        self,
        node: Any,
        core: Core,
        type_: str,
        *,
        name: str,
        execute: ExecuteCallback,
        **options: Unpack[ActionServerOptions],
    ) -> None:
        action, topics = action_type(type_), action_topics(name)
        self._name = name
        self._core = core
        self._goals = Goals(core, node.get_clock(), action, execute)
        # Without the node, as they are reachable from what its core holds.
        feedback = node.create_publisher(action.feedback_message, topics.feedback, FEEDBACK_QOS).without_node()
        status = node.create_publisher(STATUS, topics.status, STATUS_QOS).without_node()
        self._goals.open(feedback, status, options)
        service, goals = partial(Service, node, core), self._goals
        self._endpoints: tuple[Service | Publisher, ...] = (
            service(CANCEL_GOAL, name=topics.cancel_goal, handler=goals.on_cancel_goal),
            service(action.get_result.name, name=topics.get_result, handler=goals.on_get_result),
            service(
                action.send_goal.name,
                name=topics.send_goal,
                handler=goals.on_send_goal,
                answered=goals.on_answered,
            ),
            feedback,
            status,
        )
        core.own(self._goals)

    @property
    def action_name(self) -> str:
        """The fully resolved ROS action."""
        return self._name

    @property
    def last_error(self) -> BaseException | None:
        """The latest exception of a callback, None if there was none."""
        return self._goals.calls.last_error

    def close(self) -> None:
        """Abort the goals that run and end the server; again is harmless."""
        if self._goals.closed:
            return
        self._core.disown(self._goals)
        self._goals.close()
        for endpoint in self._endpoints:
            endpoint.close()

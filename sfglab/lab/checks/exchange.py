"""Checks of exports and imports: every nanosecond and every bit comes back, also over the wire."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.checks import Checks
from sfglab.lab.checks.trajectories import random_trajectory
from sfglab.messages import deserialize, serialize
from sfglab.spatial.execution.orders import Order, goal_message, order_from_goal
from sfglab.spatial.trajectory import exchange
from sfglab.spatial.trajectory.path import Interpolation, Trajectory

if TYPE_CHECKING:
    from collections.abc import Callable

    import numpy as np

    Trial = Callable[[np.random.Generator], str]

checks = Checks("exchange")


def _sent(message: Any) -> Any:
    """Return a message as it arrives: through bytes as they are on the wire."""
    return deserialize(serialize(message), type(message))


def _same(name: str, there_and_back: Callable[[Trajectory], Trajectory]) -> Trial:
    def trial(rng: np.random.Generator) -> str:
        path = random_trajectory(rng)
        return "" if there_and_back(path) == path else f"{name} of {len(path.waypoints)} waypoints"

    return trial


def _by_path(path: Trajectory) -> Trajectory:
    message = _sent(
        exchange.path_from_trajectory(path, frame_id="map", start_ns=1_700_000_000_000_000_007)
    )
    return exchange.trajectory_from_path(message, interpolation=path.interpolation)


def _by_multi_dof(path: Trajectory) -> Trajectory:
    message = _sent(exchange.multi_dof_from_trajectory(path, "go2", frame_id="map", start_ns=5))
    return exchange.trajectory_from_multi_dof(message, "go2", interpolation=path.interpolation)


def _by_csv(path: Trajectory) -> Trajectory:
    return exchange.trajectory_from_csv(
        exchange.csv_from_trajectory(path), interpolation=path.interpolation
    )


checks.trial("nav_msgs/Path gives back every bit")(_same("a path", _by_path))
checks.trial("trajectory_msgs/MultiDOFJointTrajectory gives back every bit")(
    _same("a trajectory", _by_multi_dof)
)
checks.trial("CSV gives back every bit")(_same("a text", _by_csv))


@checks.trial("the action's goal gives back every bit")
def _by_goal(rng: np.random.Generator) -> str:
    path = random_trajectory(rng, kinds=(Interpolation.POLYLINE,))
    order = Order(
        agent="go2", trajectory=path, frame_id="hall", start_ns=int(rng.integers(1, 10**18))
    )
    return (
        ""
        if order_from_goal(_sent(goal_message(order))) == order
        else f"{len(path.waypoints)} waypoints"
    )

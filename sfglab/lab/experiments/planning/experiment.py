"""Configuration, tables and parts of the experiment on planning."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from dataclasses import dataclass
from functools import partial
from itertools import count
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus import Node
from sfglab.bus.sim import World, run_simulated
from sfglab.lab.bench import TableRow
from sfglab.lab.checks import ALL, CheckRow
from sfglab.lab.experiment import PROFILES, Actor, Experiment, Link, Profiled
from sfglab.lab.experiments.planning.facts import FACTS
from sfglab.lab.paths import find_project
from sfglab.messages import ns_from_stamp
from sfglab.spatial import Pose
from sfglab.spatial.execution.client import Execution, scene_orders
from sfglab.spatial.execution.server import AgentSetup, TrajectoryServer
from sfglab.spatial.scene.files import load_scene, scene_text
from sfglab.spatial.scene.model import AgentObject
from sfglab.spatial.trajectory.motion import pose_at
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.lab.bench import Bench
    from sfglab.spatial.execution.orders import Feedback, Order
    from sfglab.spatial.scene.tree import Scene

POSE = "geometry_msgs/msg/PoseStamped"
OWN_GOAL = "the scene's trajectory"  #: Reason of the goals; earlier logs have further ones.
_SIMULATED_LIMIT_S = 3600.0
_LEAD_S = 3.0  # from the start of the nodes, which discover each other meanwhile
_LOGGED_EVERY = 5  # of 50 poses per second


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """Number of random cases, and the scene whose agents are sent along their trajectories."""

    cases: int = 100  #: Random cases of each fact.
    #: Whether the action runs over DDS, on the loopback interface; otherwise on the simulated bus.
    live: bool = True
    domain: int = 57  #: DDS domain.
    scene_file: str = "scenes/hall.yaml"  #: File of the scene, in the data folder.
    seed: int = 0  #: Seed of the random cases.


exp = Experiment(
    "planning",
    Config,
    where="A 4.5",
    smoke={"cases": 8, "live": False},
    paper={"cases": 2000},
    actors=(
        Actor("planner", "one process", "sends each agent its trajectory"),
        Actor("agent", "one process", "simulates a robot that follows it", count="two in the hall"),
        Actor("viewer", "one process", "subscribes to the poses"),
    ),
    links=(
        Link("planner", "agent", "goals, cancel requests"),
        Link("agent", "planner", "feedback, results"),
        Link("agent", "viewer", "poses"),
    ),
    removed={
        "edit_cases": {"smoke": 4, "quick": 40, "paper": 500},
        "kills": {"smoke": 1, "quick": 4, "paper": 30},
        # Parameters of the explorer.
        "segment_s": dict.fromkeys(PROFILES, 1.0),
        "speed_m_s": dict.fromkeys(PROFILES, 1.0),
        "acceleration_m_s2": dict.fromkeys(PROFILES, 1.0),
    },
)
exp.table("check")(CheckRow)


@exp.table("goal")
class PlanningGoalRow(TableRow):
    """A trajectory of the scene that was sent as a goal."""

    case: str  #: Reason of the goal.
    agent: str  #: Name of the agent.
    outcome: str  #: Outcome of the goal.
    said: str  #: Text of the result.
    feedbacks: int  #: Number of feedback messages.
    share: float  #: Share of the trajectory's duration that is over, by the last feedback.
    left_m: float  #: Distance from the last pose at the end, m; NaN where the result has no pose.
    seconds: float  #: Time from sending to the result, s.


@exp.table("track")
class PlanningTrackRow(TableRow):
    """A pose of an agent."""

    agent: str  #: Name of the agent.
    t_s: float  #: Time since the scene's time 0, s.
    x_m: float  #: Position along x, m.
    y_m: float  #: Position along y, m.
    z_m: float  #: Position along z, m.
    error_m: float  #: Distance from the planned position, m.


@exp.part("facts", total=len(FACTS), timed=False)
def try_facts(bench: Bench[Config]) -> None:
    """Try each fact on random cases, from a generator of its own."""
    for number, (name, problem_of) in enumerate(FACTS.items()):
        rng = np.random.default_rng([bench.config.seed, number])
        for _ in range(bench.config.cases):
            problem = problem_of(rng)
            bench.cases[name].append((problem or ALL, not problem))
        bench.advance(name)


@exp.part("agents on their way", timed=False)
async def drive(bench: Bench[Config]) -> None:
    """Send all agents of the scene along their trajectories; write goals and poses."""
    config = bench.config
    scene = load_scene(find_project().data / config.scene_file)
    bench.metadata("scene", {"text": scene_text(scene)})
    if config.live:
        await drive_scene(
            bench, partial(Node, domain_id=config.domain, interface="lo", lease_s=1.0), scene
        )
        return

    async def simulated(world: World) -> None:
        await drive_scene(bench, lambda name: world.node(name, host=name), scene)

    # The simulated bus has an event loop of its own, which needs a thread of its own.
    await asyncio.to_thread(run_simulated, simulated, seed=config.seed, limit_s=_SIMULATED_LIMIT_S)


async def drive_scene(bench: Bench[Config], node: Callable[[str], Any], scene: Scene) -> None:
    """Send all agents of a scene along their trajectories at once, from nodes that `node` makes by name."""
    async with AsyncExitStack() as stack:
        for agent in scene.all_of(AgentObject):
            home = await stack.enter_async_context(node(agent.name))
            setup = AgentSetup.of_scene(scene, agent)
            await stack.enter_async_context(TrajectoryServer(home, agent.name, setup=setup))
        viewer = await stack.enter_async_context(node("viewer"))
        planner = await stack.enter_async_context(node("planner"))
        start_ns = planner.get_clock().now_ns() + round(_LEAD_S * NS_PER_S)
        driven = []
        for order in scene_orders(scene, start_ns=start_ns):
            record = partial(_record, bench, order, count())
            viewer.create_subscription(POSE, _topic(order), record)
            driven.append(_carried_out(planner, order))
        for row in await asyncio.gather(*driven):
            bench.write(row)


async def _carried_out(planner: Node, order: Order) -> PlanningGoalRow:
    """Send an order, wait for its end, and return the row."""
    feedbacks: list[Feedback] = []
    clock = planner.get_clock()
    begun_ns = clock.now_ns()
    execution = Execution(planner, order.agent, on_feedback=feedbacks.append)
    await execution.begin(order)
    ended = await execution.result()
    execution.close()
    last = order.trajectory.waypoints[-1].pose
    return PlanningGoalRow(
        case=OWN_GOAL,
        agent=order.agent,
        outcome=ended.outcome.value,
        said=ended.text,
        feedbacks=len(feedbacks),
        share=feedbacks[-1].share if feedbacks else 0.0,
        left_m=last.distance_m(ended.pose) if ended.pose else np.nan,
        seconds=(clock.now_ns() - begun_ns) / NS_PER_S,
    )


def _topic(order: Order) -> str:
    return f"/global/{order.agent}/pose"


def _record(bench: Bench[Config], order: Order, numbers: count[int], message: Any) -> None:
    """Write every fifth pose of an agent from the scene's time 0 on, as a row and as a message."""
    time_ns = ns_from_stamp(message.header.stamp) - order.start_ns
    if next(numbers) % _LOGGED_EVERY or time_ns < 0:
        return
    pose = Pose.from_msg(message.pose, place="pose")
    planned = pose_at(order.trajectory, time_ns / NS_PER_S)
    x_m, y_m, z_m = pose.position_m
    row = PlanningTrackRow(
        agent=order.agent,
        t_s=time_ns / NS_PER_S,
        x_m=x_m,
        y_m=y_m,
        z_m=z_m,
        error_m=pose.distance_m(planned),
    )
    bench.write(row, at_ns=time_ns)
    bench.log.write(_topic(order), message, log_time_ns=time_ns)

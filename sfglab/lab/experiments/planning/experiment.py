"""Configuration, tables and parts of the experiment on planning."""

from __future__ import annotations

import asyncio
from contextlib import AsyncExitStack
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus import Node
from sfglab.lab.bench import TableRow
from sfglab.lab.checks import CheckRow
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.experiments.planning.facts import FACTS
from sfglab.lab.paths import find_project
from sfglab.messages import ns_from_stamp
from sfglab.spatial.execution.client import Execution, scene_orders
from sfglab.spatial.execution.server import AgentSetup, TrajectoryServer
from sfglab.spatial.scene.files import load_scene, scene_text
from sfglab.spatial.scene.model import AgentObject
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.lab.bench import Bench
    from sfglab.spatial.execution.orders import Feedback, Order

POSE = "geometry_msgs/msg/PoseStamped"
_ALL = "all of them"  #: Example of a fact that always held.
_LEAD_S = 3.0  # from the start of the nodes, which discover each other meanwhile


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """Number of random cases, and the scene whose agents are sent along their trajectories."""

    cases: int = 100  #: Random cases of each fact.
    domain: int = 57  #: DDS domain of the agents, on the loopback interface.
    scene_file: str = "scenes/hall.yaml"  #: File of the scene, in the data folder.
    seed: int = 0  #: Seed of the random cases.


exp = Experiment(
    "planning",
    Config,
    where="A 4.5",
    smoke={"cases": 8},
    paper={"cases": 2000},
    actors=(
        Actor("planner", "one process", "sends each agent its trajectory"),
        Actor("agent", "one process", "simulates a robot that follows it", count="two in the hall"),
    ),
    links=(
        Link("planner", "agent", "goals, cancel requests"),
        Link("agent", "planner", "feedback, results, poses"),
    ),
)
exp.table("check")(CheckRow)


@exp.table("goal")
class PlanningGoalRow(TableRow):
    """A trajectory of the scene that was sent as a goal."""

    agent: str  #: Name of the agent.
    outcome: str  #: Outcome of the goal.
    feedbacks: int  #: Number of feedback messages.
    left_m: float  #: Distance from the last pose at the end, m; NaN where the result has no pose.


@exp.part("facts", total=len(FACTS), timed=False)
def try_facts(bench: Bench[Config]) -> None:
    """Try each fact on random cases; each fact has its own random generator."""
    for number, (name, problem_of) in enumerate(FACTS.items()):
        rng = np.random.default_rng([bench.config.seed, number])
        for _ in range(bench.config.cases):
            problem = problem_of(rng)
            bench.cases[name].append((problem or _ALL, not problem))
        bench.advance(name)


@exp.part("agents on their way", timed=False)
async def drive(bench: Bench[Config]) -> None:
    """Send all agents of the scene along their trajectories at once; write their goals, and their poses as messages."""
    scene = load_scene(find_project().data / bench.config.scene_file)
    bench.metadata("scene", {"text": scene_text(scene)})
    node = partial(Node, domain_id=bench.config.domain, interface="lo", lease_s=1.0)
    async with AsyncExitStack() as stack:
        for agent in scene.all_of(AgentObject):
            home = await stack.enter_async_context(node(agent.name))
            setup = AgentSetup.of_scene(scene, agent)
            await stack.enter_async_context(TrajectoryServer(home, agent.name, setup=setup))
        planner = await stack.enter_async_context(node("planner"))
        start_ns = planner.get_clock().now_ns() + round(_LEAD_S * NS_PER_S)
        driven = []
        for order in scene_orders(scene, start_ns=start_ns):
            planner.create_subscription(
                POSE, pose_topic(order.agent), partial(_record, bench, order)
            )
            driven.append(_carried_out(planner, order))
        bench.write_all("goal", await asyncio.gather(*driven))


async def _carried_out(planner: Node, order: Order) -> PlanningGoalRow:
    """Send an order, wait for its end, and return the row."""
    feedbacks: list[Feedback] = []
    execution = Execution(planner, order.agent, on_feedback=feedbacks.append)
    await execution.begin(order)
    ended = await execution.result()
    execution.close()
    last = order.trajectory.waypoints[-1].pose
    return PlanningGoalRow(
        agent=order.agent,
        outcome=ended.outcome.value,
        feedbacks=len(feedbacks),
        left_m=last.distance_m(ended.pose) if ended.pose else np.nan,
    )


def pose_topic(agent: str) -> str:
    """Return the global topic of an agent's poses."""
    return f"/global/{agent}/pose"


def _record(bench: Bench[Config], order: Order, message: Any) -> None:
    """Write a pose of an agent, if it is not before the scene's time 0, which is the log's time 0."""
    time_ns = ns_from_stamp(message.header.stamp) - order.start_ns
    if time_ns >= 0:
        bench.log.write(pose_topic(order.agent), message, log_time_ns=time_ns)

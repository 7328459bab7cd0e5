"""Runs of driving: laps by seeds, the chain frame by frame, and what the memory model adds.

Node times are processor time here with OpenCV in one thread: what a node works, not what it waits. The chain is
timed with no other lap beside it, at the image size of the graph.

Across processes every node of Fig. 9 is one, on this host's bus. A gateway's saved crossings are there, as one
copy in shared memory in place of one for each reader by DDS; that it takes the chain out of the scheduler's
hands is not: nodes that are hardware in the paper are processes here.
"""

from __future__ import annotations

import math
import time
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.address import BusAddress
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled, SkippedPartError, seeded
from sfglab.lab.paths import find_project
from sfglab.lab.sweep import Workers
from sfglab.lab.testbed import held_domains
from sfglab.lab.workers.driving import NAMES, DrivingNodeConfig
from sfglab.processes import Member, ProcessGroup
from sfglab.soc import load_graph
from sfglab.soc.driving import CHAIN, SHARED_TOPIC, Camera, Chain, Rules, Stack, make_town, run_lap
from sfglab.soc.driving.loop import Verdict
from sfglab.soc.memory import CUT_THROUGH, STORED

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.lab.bench import Bench

MAPPINGS = ("software", "gateway")  #: What topic A is mapped to, in the paper's two versions.

PAPER_MS = {"software": (28.264, 3.21), "gateway": (20.270, 0.239)}
"""Mean and standard deviation of the chain's time, as stated."""

READINGS = {
    "hardware": "node times in hardware, assumed",
    "software": "node times in software, measured",
}
"""What the chain's nodes take. The first answers the claim: the paper's nodes run in hardware, and what it
compares is how topic A travels between them. That was decided before either was computed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LapPoint:
    """What every seed drives."""

    limit_s: float  #: Time in the town after which a lap has failed.


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainPoint:
    """What the chain is timed by."""

    limit_s: float  #: Time in the town after which it ends, at the latest.
    #: Of the camera's images, whose size is that of topic A's messages in the graph.
    width: int = 640
    height: int = 480  #: The same.
    graph_file: str = "graphs/driving.yaml"  #: The graph, in the data folder.


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    laps: int = 20  #: How many towns are driven round.
    lap: LapPoint = LapPoint(limit_s=150.0)  #: What is driven in each.
    chain: ChainPoint = ChainPoint(limit_s=150.0)  #: What the chain is timed by.
    live_s: float = 10.0  #: How long the chain runs across processes, seconds; 0: not.
    live_hz: float = 15.0  #: Of its camera.
    seed: int = 0  #: The first town's.


exp = Experiment(
    "driving",
    Config,
    where="C 6",
    smoke={
        "laps": 1,
        "lap": LapPoint(limit_s=8.0),
        "chain": ChainPoint(limit_s=2.0),
        "live_s": 1.0,
    },
    paper={"laps": 100, "live_s": 120.0},
    actors=(
        Actor("town", "simulation", "draws what the camera sees, moves the car, judges the lap"),
        Actor("stack", "application", "every node of Fig. 9, timed one by one"),
        Actor("chain", "memory model", "adds what messages take over topic A, by either mapping"),
        Actor("compensation", "Linux", "a process, as all other nodes, live"),
        Actor("reader of A", "Linux", "blur, detections of lights, odometry", count="4"),
    ),
    links=(
        Link("town", "stack", "an image", "calls"),
        Link("stack", "town", "speed and turn", "calls"),
        Link("stack", "chain", "node times of each frame", "calls", "software and hardware"),
        Link("compensation", "reader of A", "a copy for each (software)"),
        Link("compensation", "reader of A", "one copy (gateway)", over="shared memory"),
    ),
)


@exp.table("lap")
class DrivingLapRow(Verdict):
    """One lap. Node times are means over its frames, in seconds."""

    seed: int  #: Of the town.
    lane_m: float  #: Length of the lap.
    frames: int  #: Images.
    lanes_missed: int  #: Of them, those without a lane found.
    odometry_error_m: float  #: Between where the odometry ends and where the car is.
    odometry_lost: int  #: Frames that the odometry could not match.
    camera_s: float  #: What drawing an image takes; no node's.
    compensation_s: float  #: Node time.
    gaussian_blur_s: float  #: Node time.
    lane_planner_s: float  #: Node time.
    polyfit_s: float  #: Node time.
    red_light_detection_s: float  #: Node time, asleep or not.
    green_light_detection_s: float  #: Node time, asleep or not.
    visual_odometry_s: float  #: Node time.
    lane_control_s: float  #: Node time.


@exp.table("chain")
class DrivingChainRow:
    """The chain in one frame: its nodes as measured in software, and how topic A travels by the model."""

    compensation_ns: int  #: Node time.
    gaussian_blur_ns: int  #: Node time.
    lane_planner_ns: int  #: Node time.
    polyfit_ns: int  #: Node time.
    lane_control_ns: int  #: Node time.
    order: int  #: Drawn order of deliveries, as its place in `Chain.orders`.
    place: int  #: Which of topic A's readers the blur is in that order, from 1.
    smt_s: float  #: From the compensation to the blur over main memory.
    gateway_s: float  #: The same through a gateway.


@exp.table("node")
class DrivingNodeRow:
    """What the graph assumes of one of the chain's nodes."""

    node: str  #: Its name.
    in_hardware: bool  #: Whether it is placed there.
    hardware_s: float  #: Its time there; NaN where it is not there.


@exp.table("transfer")
class DrivingTransferRow:
    """A topic's way along the chain by the memory model, over every order of deliveries."""

    #: Which set of constants: the gateway core stores chunks, or passes them on as they come.
    forwarding: str
    topic: str  #: The topic.
    mapping: str  #: One of `MAPPINGS` for topic A; ``as placed`` for the others.
    mean_s: float  #: Mean.
    deviation_s: float  #: Standard deviation.
    shortest_s: float  #: The best order.
    longest_s: float  #: The worst.


@exp.table("track")
@dataclass(frozen=True, slots=True, kw_only=True)
class DrivingTrackRow:
    """A moment of the lap that is drawn."""

    t_s: float  #: Since its start.
    x_m: float  #: The car's true place: east.
    y_m: float  #: North.
    yaw_rad: float  #: Its heading.
    speed_mps: float  #: Its speed.
    left_m: float  #: Its distance to the left of the lane's middle.
    red: str  #: Of each light, 1 for red and 0 for green.
    held: bool  #: Whether the lane control is held by a red light.
    lane_seen: bool  #: Whether the polyfit found a lane.
    lane_offset_m: float  #: Of that lane, in the car's frame; NaN without one.
    lane_slope: float  #: The same.
    lane_bend_per_m: float  #: The same.
    odometry_x_m: float  #: Where the odometry believes to be, from the start pose.
    odometry_y_m: float  #: The same.
    odometry_yaw_rad: float  #: The same.
    command_mps: float  #: Commanded speed.
    command_rps: float  #: Commanded yaw rate.
    pictured: bool  #: Whether the log holds the image of that moment.


@exp.sweep(
    "lap", over=lambda config: [config.lap], seeds=lambda config: seeded(config, config.laps)
)
def drive_lap(point: LapPoint, seed: int) -> dict[str, Any]:
    """Drive one lap in the town of a seed; all but the node times depends on the arguments alone."""
    with _one_thread():
        lap = run_lap(
            seed, stack=Stack(Camera(), time.thread_time_ns), rules=Rules(timeout_s=point.limit_s)
        )
    own = ("frames", "lanes_missed", "odometry_error_m", "odometry_lost")
    return {
        **asdict(lap.verdict),
        "lane_m": make_town(np.random.default_rng(seed)).lane.length_m,
        **{name: getattr(lap, name) for name in own},
        **{f"{node}_s": mean_s for node, mean_s in lap.node_s.items()},
    }


def chain_of(point: ChainPoint) -> Chain:
    """Return the chain in the graph's file."""
    return Chain(load_graph(find_project().data / point.graph_file))


@exp.sweep("chain", over=lambda c: [c.chain], seeds=lambda c: [c.seed], workers=Workers(count=1))
def time_chain(point: ChainPoint, seed: int) -> tuple[dict[str, Any], ...]:
    """Drive with images of the graph's size; return each frame's node times and its drawn way over topic A.

    The seed is that of the town, and of the orders of deliveries.
    """
    chain = chain_of(point)
    stack = Stack(Camera(width=point.width, height=point.height), time.thread_time_ns)
    with _one_thread():
        frames = run_lap(seed, stack=stack, rules=Rules(timeout_s=point.limit_s)).frames
    rows = []
    for frame, order in enumerate(chain.draw(frames, np.random.default_rng((seed, 1)))):
        served = chain.orders[order]
        nodes = {f"{node}_ns": stack.timed.frames_ns[node][frame] for node in CHAIN}
        row = {
            "order": int(order),
            "place": served.index(CHAIN[1]) + 1,
            "smt_s": chain.smt_s[served],
        }
        rows.append({**nodes, **row, "gateway_s": chain.gateway_s})
    return tuple(rows)


def nodes_of(chain: Chain) -> Iterator[dict[str, Any]]:
    """Yield what the graph assumes of the chain's nodes."""
    for node in map(chain.graph.node, CHAIN):
        hardware_s = node.hardware.time_s if node.in_hardware and node.hardware else math.nan
        yield {"node": node.name, "in_hardware": node.in_hardware, "hardware_s": hardware_s}


def transfers_of(chain: Chain) -> Iterator[dict[str, Any]]:
    """Yield every transfer along the chain, by both sets of the model's constants."""
    for costs in (STORED, CUT_THROUGH):
        other = Chain(chain.graph, costs)
        ways = {(SHARED_TOPIC, MAPPINGS[0]): [*other.smt_s.values()]}
        ways |= {(SHARED_TOPIC, MAPPINGS[1]): [other.gateway_s]}
        ways |= {(topic, "as placed"): [seconds] for topic, seconds in other.fixed_s.items()}
        for (topic, mapping), times_s in ways.items():
            yield {
                "forwarding": costs.memory.forwarding.value,
                "topic": topic,
                "mapping": mapping,
                "mean_s": float(np.mean(times_s)),
                "deviation_s": float(np.std(times_s)),
                "shortest_s": min(times_s),
                "longest_s": max(times_s),
            }


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let OpenCV work in this thread alone."""
    import cv2

    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


_MODULE = "sfglab.lab.workers.driving"
_SLACK_S = 60.0


@exp.table("live")
class DrivingLiveRow:
    """A picture's way along the chain across processes."""

    mapping: str  #: What topic A was mapped to.
    started_s: float  #: When the compensation had it, from the first one's.
    chain_s: float  #: From there to the command; NaN: it was lost.


@exp.part("live", timed=False)
async def drive_live(bench: Bench[Config]) -> None:
    """Run the chain's nodes as processes."""
    config = bench.config
    if not config.live_s:
        raise SkippedPartError("live: no time was asked for (live_s)")
    with held_domains() as (domain,):
        address = BusAddress(domain_id=domain, interface="lo")
        told: dict[str, Any] = {
            "width": config.chain.width,
            "height": config.chain.height,
            "seed": config.seed,
        }
        told |= {"address": address, "rate_hz": config.live_hz, "live_s": config.live_s}
        configs = [DrivingNodeConfig(node=name, **told) for name in NAMES]
        members = [Member(name=each.node, module=_MODULE, config=each) for each in configs]
        async with ProcessGroup(members) as nodes:
            await nodes.ask("over", NAMES[:1], timeout_s=config.live_s + _SLACK_S, do="go")
            ends = await nodes.ask("stopped", [CHAIN[0], CHAIN[-1]], timeout_s=_SLACK_S, do="stop")
    done_ns = dict(ends[CHAIN[-1]]["frames"])
    began = ends[CHAIN[0]]["frames"]
    for at_ns, mapping in began:
        chain_s = (done_ns[at_ns] - at_ns) / 1e9 if at_ns in done_ns else float("nan")
        bench.write(
            "live",
            {"mapping": mapping, "started_s": (at_ns - began[0][0]) / 1e9, "chain_s": chain_s},
        )

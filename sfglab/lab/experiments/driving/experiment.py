"""The module `driving.experiment` has the parts of the experiment: laps, timed frames, model, and a live chain.

Execution times of nodes are processor times on this machine, with OpenCV in one thread.

In the live part each node of Fig. 9 is a process on this host. Topic A goes to its subscribers over DDS with one
copy per subscriber, or over shared memory with one copy, as through a gateway. All nodes wait for the Linux
scheduler, also the nodes that are hardware in the paper.
"""

from __future__ import annotations

import math
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pandas as pd

from sfglab.bus.address import BusAddress
from sfglab.lab.bench import TableRow
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled, SkippedPartError, seeded
from sfglab.lab.paths import find_project
from sfglab.lab.sweep import Workers
from sfglab.lab.testbed import held_domains
from sfglab.lab.workers.driving import CAMERA, HEIGHT, WIDTH, DrivingNodeConfig
from sfglab.messages import default_message, message_type
from sfglab.processes import Member, ProcessGroup
from sfglab.soc import Topic, load_graph
from sfglab.soc.driving import (
    CHAIN,
    Camera,
    Chain,
    Frame,
    Moment,
    Stack,
    make_town,
    run_lap,
)
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.poses import header_msg
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.lab.bench import Bench

IMAGE_TOPIC = "/image/compressed"


@dataclass(frozen=True, slots=True, kw_only=True)
class DrivePoint:
    """A `DrivePoint` is a drive of the car."""

    limit_s: float  #: Time on the town's clock after which the drive ends.


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The `Config` has the settings of a run."""

    laps: int = 20  #: Number of towns.
    lap: DrivePoint = DrivePoint(limit_s=150.0)  #: Drive in each town.
    chain: DrivePoint = DrivePoint(limit_s=150.0)  #: Drive whose frames time the chain.
    live_s: float = 10.0  #: Duration of the live part, s; 0 skips it.
    live_hz: float = 15.0  #: Frame rate of the live part, Hz.
    seed: int = 0  #: Seed of the first town.


exp = Experiment(
    "driving",
    Config,
    where="C 6",
    smoke={
        "laps": 1,
        "lap": DrivePoint(limit_s=8.0),
        "chain": DrivePoint(limit_s=2.0),
        "live_s": 1.0,
    },
    paper={"laps": 100, "live_s": 120.0},
    actors=(
        Actor("town", "simulation", "renders the camera's images, moves the car, judges the lap"),
        Actor("stack", "application", "all nodes of Fig. 9, each one timed"),
        Actor("chain", "memory model", "adds the transfer times of topic A for both mappings"),
        Actor("compensation", "Linux", "a process, as all other nodes of the live part"),
        Actor("reader of A", "Linux", "blur, detection of lights, odometry", count="4"),
    ),
    links=(
        Link("town", "stack", "an image", "calls"),
        Link("stack", "town", "speed and yaw rate", "calls"),
        Link("stack", "chain", "node times of each frame", "calls", "software and hardware"),
        Link("compensation", "reader of A", "one copy per reader (software)"),
        Link("compensation", "reader of A", "one copy (gateway)", over="shared memory"),
    ),
)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Compute with OpenCV in one thread."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)


@exp.table("lap")
class DrivingLapRow(TableRow):
    """A `DrivingLapRow` is one lap."""

    seed: int  #: Seed of the town.
    passed: bool  #: Whether the lap met all rules of the judge.
    lap_s: float  #: Duration of the lap on the town's clock.
    lane_m: float  #: Length of the lane, m.
    red_lights_obeyed: int  #: Number of red lights that the car stopped at.
    largest_lateral_m: float  #: Largest distance from the lane's middle, m.
    odometry_error_m: float  #: Distance between the odometry's position and the car at the end, m.


@exp.sweep(
    "lap", over=lambda config: [config.lap], seeds=lambda config: seeded(config, config.laps)
)
def drive_lap(point: DrivePoint, seed: int) -> DrivingLapRow:
    """Drive one lap in the town of a seed."""
    with _one_thread():  # the sweep has one process per core
        lap = run_lap(seed, timeout_s=point.limit_s)
    return DrivingLapRow(
        seed=seed,
        passed=lap.verdict.passed,
        lap_s=lap.verdict.lap_s,
        lane_m=lap.lane_m,
        red_lights_obeyed=lap.verdict.red_lights_obeyed,
        largest_lateral_m=lap.verdict.largest_lateral_m,
        odometry_error_m=lap.odometry_error_m,
    )


@exp.table("chain")
class DrivingChainRow(TableRow):
    """A `DrivingChainRow` has the times of one frame: execution in software, and the model's transfers of topic A."""

    compensation_ns: int  #: Execution time of compensation, ns.
    gaussian_blur_ns: int  #: Execution time of Gaussian blur, ns.
    lane_planner_ns: int  #: Execution time of the lane planner, ns.
    polyfit_ns: int  #: Execution time of polyfit, ns.
    lane_control_ns: int  #: Execution time of lane control, ns.
    #: Time from compensation to blur through main memory, s; the order of deliveries is random.
    smt_s: float
    gateway_s: float  #: Time from compensation to blur through a gateway, s.


@exp.sweep("chain", over=lambda c: [c.chain], seeds=lambda c: [c.seed], workers=Workers(count=1))
def time_chain(point: DrivePoint, seed: int) -> tuple[dict[Any, Any], ...]:
    """Drive with images of the graph's size, and return the chain's times in each frame.

    The seed selects the town and the orders in which topic A is delivered.
    """
    stack = Stack(Camera(width=WIDTH, height=HEIGHT))
    with _one_thread():  # as the only executor of a node does
        run_lap(seed, stack=stack, timeout_s=point.limit_s)
    chain = load_chain()
    times_ns = {f"{node}_ns": stack.times_ns[node] for node in CHAIN}
    frames = len(stack.times_ns[CHAIN[0]])
    sampled = np.random.default_rng((seed, 1)).integers(0, len(chain.orders), frames)
    smt_s = [chain.software_s[chain.orders[index]] for index in sampled]
    table = pd.DataFrame({**times_ns, "smt_s": smt_s, "gateway_s": chain.gateway_s})
    return tuple(table.to_dict("records"))


def load_chain() -> Chain:
    """Return the chain of the driving application's graph."""
    return Chain(load_graph(find_project().data / "graphs/driving.yaml"))


@exp.table("node")
class DrivingNodeRow(TableRow):
    """A `DrivingNodeRow` is one node of the chain in the graph."""

    node: str  #: Name of the node.
    hardware_s: float  #: Assumed execution time in hardware, s; NaN for a node in software.


@exp.table("transfer")
class DrivingTransferRow(TableRow):
    """A `DrivingTransferRow` is the transfer time of a topic of the chain, except topic A, by the memory model."""

    topic: str  #: Name of the topic.
    mean_s: float  #: Transfer time, s.


@exp.part("model", timed=False)
def write_model(bench: Bench[Config]) -> None:
    """Write the node times that the graph assumes for the chain, and the transfer times of the memory model."""
    chain = load_chain()
    for node in map(chain.graph.node, CHAIN):
        hardware_s = node.hardware.time_s if node.in_hardware and node.hardware else math.nan
        bench.write(DrivingNodeRow(node=node.name, hardware_s=hardware_s))
    for topic, time_s in chain.fixed_s.items():
        bench.write(DrivingTransferRow(topic=topic, mean_s=time_s))


@exp.table("track")
class DrivingTrackRow(TableRow):
    """A `DrivingTrackRow` is one moment of the logged lap."""

    t_s: float  #: Time since the start of the lap, s.
    x_m: float  #: True position of the car, east, m.
    y_m: float  #: True position of the car, north, m.
    speed_mps: float  #: True speed.


@exp.part("drawn lap", timed=False)
def log_lap(bench: Bench[Config]) -> None:
    """Drive the first lap again, and write the lap's town, track and messages."""
    config = bench.config
    town = make_town(np.random.default_rng(config.seed))
    lines = [town.lane.at(light.stop_m) for light in town.lights]
    lights = [(line.x_m, line.y_m) for line in lines]
    bench.metadata("town", {"road": town.road.points_xy[::4].tolist(), "lights": lights})
    recorder = Recorder(bench)
    run_lap(config.seed, timeout_s=config.lap.limit_s, watch=recorder.record)


_TRACK_FRAMES = 3  #: Frames per row of the track.
_IMAGE_FRAMES = 6  #: Frames per logged image.
_IMAGE_SIZE = (240, 180)  #: Width and height of logged images.
_JPEG_QUALITY = 25
#: Distances from the car at which a logged lane has its points.
_PATH_M = (0.6, 0.9, 1.2, 1.5, 1.8, 2.1, 2.4)


class Recorder:
    """A `Recorder` writes a lap into a log, as rows and as ROS messages that MCAP viewers show.

    The TF frame ``map`` is the town, ``odom`` is the start of the odometry, and ``car`` is the true pose of the car.
    """

    def __init__(self, bench: Bench[Config]) -> None:
        self._bench = bench
        self._frames = 0

    def record(self, moment: Moment) -> None:
        """Write the rows and messages that are due in a frame of `run_lap`."""
        number = self._frames
        self._frames += 1
        if number % _TRACK_FRAMES:
            return
        car = moment.car
        now_ns = round(moment.now_s * NS_PER_S)
        row = DrivingTrackRow(
            t_s=moment.now_s,
            x_m=car.x_m,
            y_m=car.y_m,
            speed_mps=car.speed_mps,
        )
        self._bench.write(row, at_ns=now_ns)
        children = ("car",) if number else ("car", "odom")
        true_pose = Pose.from_yaw((car.x_m, car.y_m, 0.0), car.yaw_rad)
        transforms = []
        for child in children:
            moved = StampedTransform(parent="map", child=child, stamp_ns=now_ns, pose=true_pose)
            transforms.append(moved.to_msg())
        self._write("/tf", message_type("tf2_msgs/msg/TFMessage")(transforms=transforms), now_ns)
        seen = moment.frame.pose
        estimate = _stamped("geometry_msgs/msg/PoseStamped", "odom", now_ns)
        estimate.pose = Pose.from_yaw((seen.x_m, seen.y_m, 0.0), seen.yaw_rad).to_pose_msg()
        self._write("/pose", estimate, now_ns)
        if number % _IMAGE_FRAMES == 0:
            self._write_images(moment.frame, now_ns)

    def _write_images(self, frame: Frame, now_ns: int) -> None:
        small = cv2.resize(frame.image, _IMAGE_SIZE, interpolation=cv2.INTER_AREA)
        image = _stamped("sensor_msgs/msg/CompressedImage", "camera", now_ns)
        image.format = "jpeg"
        image.data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
        self._write(IMAGE_TOPIC, image, now_ns)
        mask = _stamped("sensor_msgs/msg/CompressedImage", "car", now_ns)
        mask.format = "png"
        mask.data = cv2.imencode(".png", frame.mask)[1]
        self._write("/lane_mask/compressed", mask, now_ns)
        path = _stamped("nav_msgs/msg/Path", "car", now_ns)
        if frame.lane is not None:
            for x in _PATH_M:
                point = _stamped("geometry_msgs/msg/PoseStamped", "car", now_ns)
                point.pose.position.x = x
                point.pose.position.y = frame.lane.y_m(x)
                path.poses.append(point)
        self._write("/lane/path", path, now_ns)

    def _write(self, topic: str, message: Any, now_ns: int) -> None:
        self._bench.log.write(topic, message, log_time_ns=now_ns)


def _stamped(name: str, frame: str, now_ns: int) -> Any:
    return default_message(name, header=header_msg(frame, now_ns))


_SLACK_S = 60.0  #: Time that the live nodes have in addition to the duration of the live part.


@exp.table("live")
class DrivingLiveRow(TableRow):
    """A `DrivingLiveRow` is one image of the live part."""

    mapping: str  #: Mapping of topic A for this image.
    chain_s: float  #: Time from the compensation's start to the command; NaN if the image was lost.


def live_nodes(config: Config, address: BusAddress) -> list[DrivingNodeConfig]:
    """Return the configurations of the graph's nodes, except the car, as processes, each with its first topics."""
    graph = load_chain().graph
    processed: dict[str, str] = {}
    results: dict[str, Topic] = {}
    for topic in graph.topics:
        for name in topic.subscribers:
            processed.setdefault(name, topic.name)
        for name in topic.publishers:
            results[name] = topic
    found = []
    for name, topic in results.items():
        node = DrivingNodeConfig(
            node=name,
            subscribes=processed.get(name, ""),
            publishes=topic.name,
            readers=len(topic.subscribers),
            address=address,
            rate_hz=config.live_hz,
            live_s=config.live_s,
            seed=config.seed,
        )
        found.append(node)
    return found


@exp.part("live", timed=False)
async def drive_live(bench: Bench[Config]) -> None:
    """Run the application's nodes as processes, and sample the mapping of topic A for each image."""
    config = bench.config
    if not config.live_s:
        raise SkippedPartError("live: no time was asked for (live_s)")
    with held_domains() as (domain,):
        members = []
        for node in live_nodes(config, BusAddress(domain_id=domain, interface="lo")):
            module = "sfglab.lab.workers.driving"
            members.append(Member(name=node.node, module=module, config=node))
        async with ProcessGroup(members) as nodes:
            await nodes.ask("over", [CAMERA], timeout_s=config.live_s + _SLACK_S, do="go")
            ends = await nodes.ask("stopped", [CHAIN[0], CHAIN[-1]], timeout_s=_SLACK_S, do="stop")
    done_ns = dict(ends[CHAIN[-1]]["frames"])
    for start_ns, mapping in ends[CHAIN[0]]["frames"]:
        chain_ns = done_ns.get(start_ns, math.nan) - start_ns
        bench.write(DrivingLiveRow(mapping=mapping, chain_s=chain_ns / NS_PER_S))

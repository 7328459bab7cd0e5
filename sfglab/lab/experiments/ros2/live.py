"""Parts: the tests in ``tests/ros2``, and nodes of rclpy in comparison with the surrogate nodes of sfglab.

Fleets of agents start as in the experiment on discovery. A camera of rclpy on the edge host sends raw images, and
subscribers on the consumer host read every pixel.
"""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import sys
import time
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sfglab.bus.address import BusAddress
from sfglab.codecs import COMPRESSED_IMAGE
from sfglab.lab.experiment import SkippedPartError
from sfglab.lab.experiments.discovery.experiment import STANDARD, Cell, host_names
from sfglab.lab.experiments.discovery.live import NODES, LiveFleet
from sfglab.lab.experiments.ros2.experiment import (
    REAL,
    STAND_IN,
    TABLE,
    BesideRow,
    Config,
    FeatureRow,
    Raw,
    exp,
)
from sfglab.lab.meters import measure
from sfglab.lab.ros2 import RosMember, distribution
from sfglab.lab.streams import FIRST_PICTURE_S, GLOBAL_DOMAIN
from sfglab.lab.testbed import Testbed
from sfglab.lab.workers.viewer import ViewerConfig
from sfglab.processes import Member, ProcessGroup
from sfglab.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from sfglab.lab.bench import Bench

TESTS = Path(__file__).parents[4] / "tests" / "ros2"
#: Environment variables of a surrounding test run, which do not concern this one.
FOREIGN = ("PYTEST_", "SFGLAB_SKIPS", "SFGLAB_ROOT")
TOPIC = "/camera_front/image_raw"
PICTURE = {"width": 640, "height": 360, "hz": 30.0}


# --- Features ---------------------------------------------------------------------------------


@exp.part("tests", total=lambda config: len(config.distributions))
async def run_tests(bench: Bench[Config]) -> None:
    """Run the tests with each distribution, and write a row for each feature that a test shows."""
    if not TESTS.is_dir():
        raise SkippedPartError("the tests beside ROS 2 are in the repository only (tests/ros2)")
    for name in bench.config.distributions:
        outcomes = bench.folder(name) / "features"
        chosen = f"{name} and ({bench.config.only or name})"
        printed = await run_pytest(chosen, outcomes)
        bench.attach(f"{name}.txt", printed, "text/plain")
        lines = outcomes.read_text(encoding="utf-8").splitlines() if outcomes.exists() else []
        # Several processes run the tests: their rows are in the order of the tests' ends.
        for row in sorted(map(json.loads, lines), key=itemgetter("place")):
            del row["place"]
            bench.write(FeatureRow(**row))
        bench.advance(name)


async def run_pytest(chosen: str, outcomes: Path) -> bytes:
    """Run the tests that an expression selects, and return what pytest printed.

    Args:
        chosen: Expression of pytest's option ``-k``.
        outcomes: File that the tests append their rows to.
    """
    argv = [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--color=no"]
    argv += ["-k", chosen, "--numprocesses=auto", "--dist=worksteal", str(TESTS)]
    own = {name: value for name, value in os.environ.items() if not name.startswith(FOREIGN)}
    process = await asyncio.create_subprocess_exec(
        *argv,
        cwd=TESTS.parents[1],
        env={**own, "SFGLAB_FEATURES": str(outcomes)},
        stdout=asyncio.subprocess.PIPE,
        stderr=asyncio.subprocess.STDOUT,
    )
    try:
        return (await process.communicate())[0]
    finally:
        if process.returncode is None:
            process.terminate()
            await process.wait()


# --- Baselines --------------------------------------------------------------------------------


def separate_hosts(bench: Bench[Config], *names: str) -> Testbed:
    """Return hosts that exist until the end of the run.

    Raises:
        RosMissingError: There is no ROS 2.
        SkippedPartError: Hosts are not separate.
    """
    testbed = bench.stack.enter_context(Testbed(*names, separate=bench.options.separate))
    if not testbed.separate:
        raise SkippedPartError(
            "needs network namespaces: real ROS 2 would discover other nodes of this network"
        )
    return testbed


def peer_on(host: str, name: str, *arguments: str) -> RosMember:
    """Return a process with a node of rclpy on a host, of the first installed distribution.

    Raises:
        RosMissingError: No distribution is installed.
    """
    return RosMember(name=name, host=host, config=arguments)


class RawStream(ProcessGroup):
    """A camera of rclpy, and subscribers of rclpy and of sfglab."""

    def __init__(self, testbed: Testbed, most: int) -> None:
        config = ViewerConfig(
            remote=BusAddress(domain_id=GLOBAL_DOMAIN, interface=testbed.interface("consumer")),
            local=BusAddress(domain_id=GLOBAL_DOMAIN + 1, interface="lo"),
            remote_topic=TOPIC,
            remote_type=COMPRESSED_IMAGE,
            codec="",
            local_topic=TOPIC,
            joined=True,
        )
        module = "sfglab.lab.workers.viewer"
        members: list[Member] = [peer_on("edge", "camera", "camera")]
        for number in range(most):
            name = f"{STAND_IN} {number}"
            members.append(peer_on("consumer", f"{REAL} {number}", f"viewer_{number}"))
            members.append(Member(name=name, host="consumer", module=module, config=config))
        super().__init__(members, wrap_command=testbed.argv)

    async def settle(self) -> None:
        """Start the camera, and let one subscriber of each kind receive, which is not measured."""
        order = {"do": "shoot", "topic": TOPIC, **PICTURE}
        await self.ask("shooting", ["camera"], timeout_s=FIRST_PICTURE_S, **order)
        for kind in (REAL, STAND_IN):
            await self.measure(kind, 1, 0.2)

    async def measure(self, kind: str, count: int, look_s: float) -> dict[str, list[float]]:
        """Let subscribers of a kind receive for some seconds; return values by quantity."""
        names = [f"{kind} {number}" for number in range(count)]
        order = {"do": "look", "mode": "raw", "topic": TOPIC}
        firsts = await self.ask("first", names, timeout_s=FIRST_PICTURE_S, **order)
        pids = [self[name].pid for name in names]
        [reading] = await measure(look_s, look_s, cpu={"subscribers": pids})
        seen = await self.ask("seen", names, timeout_s=FIRST_PICTURE_S, do="stop")
        now_ns = time.time_ns()
        waits_ms, ages_ms = [], []
        sent = received = 0.0
        for name, first in firsts.items():
            waits_ms.append((first["seen_ns"] - first["ordered_ns"]) / NS_PER_MS)
            ages_ms.append(float(np.median(seen[name]["ages_ns"])) / NS_PER_MS)
            sent += 1 + PICTURE["hz"] * (now_ns - first["seen_ns"]) / NS_PER_S
            received += seen[name]["frames"]
        return {
            "first picture (ms)": waits_ms,
            "capture to picture in hand (ms)": ages_ms,
            "CPU of a subscriber (% of a core)": [(reading.cpu_percent or 0.0) / count],
            "pictures received (%)": [100 * received / sent],
        }


async def measure_raw(bench: Bench[Config], raw: Raw, quantities: Sequence[str]) -> None:
    """Measure quantities of subscribers, of rclpy and of sfglab in random order.

    Raises:
        SkippedPartError: Hosts are not separate.
        RosMissingError: There is no ROS 2.
    """
    rng = np.random.default_rng(bench.config.seed)
    testbed = separate_hosts(bench, "edge", "consumer")
    async with RawStream(testbed, max(raw.counts)) as stream:
        for repeat in range(raw.repeats):
            for count in raw.counts:
                for kind in rng.permutation([REAL, STAND_IN]).tolist():
                    values = await stream.measure(kind, count, raw.look_s)
                    wanted = {quantity: values[quantity] for quantity in quantities}
                    bench.write_all(TABLE, rows_of(wanted, f"{count}", kind, repeat))
                    bench.advance(f"{kind} {count}")


def rows_of(
    values: Mapping[str, Sequence[float]], setting: str, kind: str, repeat: int
) -> Iterator[BesideRow]:
    """Yield the rows of a measurement, whose values are given by quantity."""
    for quantity, of_quantity in values.items():
        for value in of_quantity:
            yield BesideRow(
                setting=setting, quantity=quantity, kind=kind, repeat=repeat, value=value
            )


def steps(raw: Raw) -> int:
    """Return the number of measurements."""
    return 2 * raw.repeats * len(raw.counts)


@exp.part("decode_once", total=lambda config: steps(config.decode_once))
async def measure_decode_once(bench: Bench[Config]) -> None:
    """Measure CPU load and received images by number of subscribers."""
    quantities = ("CPU of a subscriber (% of a core)", "pictures received (%)")
    await measure_raw(bench, bench.config.decode_once, quantities)


@exp.part("latency", total=lambda config: steps(config.latency))
async def measure_latency(bench: Bench[Config]) -> None:
    """Measure the age of images and the time to the first image."""
    quantities = ("capture to picture in hand (ms)", "first picture (ms)", "pictures received (%)")
    await measure_raw(bench, bench.config.latency, quantities)


class RosFleet(LiveFleet):
    """A fleet whose nodes are of rclpy."""

    def processes_of(self, _: int, host: str) -> list[Member]:
        """Return the only process of an agent."""
        return [peer_on(host, host + NODES, host, "crowd")]


def cells_of(config: Config) -> list[Cell]:
    """Return all starts in the order of the run: sizes of fleets are shuffled, and the starts of each."""
    rng = np.random.default_rng(config.seed)
    cells = []
    for place in rng.permutation(len(config.fleets)):
        one = config.fleets[place]
        size = {"agents": one.agents, "talkers": one.nodes, "listeners": one.nodes}
        starts = list(itertools.product((REAL, STAND_IN), range(one.repeats)))
        rng.shuffle(starts)
        cells += [Cell(mode=kind, repeat=int(repeat), **size) for kind, repeat in starts]
    return cells


@exp.part("discovery", total=lambda config: len(cells_of(config)))
async def measure_discovery(bench: Bench[Config]) -> None:
    """Measure the discovery time of agents, and the bytes that they receive until then."""
    config = bench.config
    cells = cells_of(config)
    testbed = separate_hosts(bench, *host_names(max(cell.agents for cell in cells)))
    distribution()  # raises at once if ROS 2 is missing
    for cell in cells:
        kind = RosFleet if cell.mode == REAL else LiveFleet
        standard = replace(cell, mode=STANDARD)
        async with kind(standard, testbed, multicast=config.multicast) as fleet:
            hosts, load = await fleet.measure(config.timeout_s)
        values = {
            "until an agent knows its peers (s)": [host.resolved_s for host in hosts],
            "received until then (MB)": [host.own_bytes / 1e6 for host in hosts],
            "cores busy": [(load.cpu_percent or 0.0) / 100],
        }
        setting = f"{cell.agents} x {cell.talkers + cell.listeners}"
        bench.write_all(TABLE, rows_of(values, setting, cell.mode, cell.repeat))
        bench.advance(f"{cell.mode} {cell.agents}")

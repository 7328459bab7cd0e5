"""Runs of latency: looks at all paths, interleaved, at phases drawn over the group of pictures."""

from __future__ import annotations

import asyncio
import time
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from sfglab.fields import between
from sfglab.lab.baselines import PART, declare, measure_raw
from sfglab.lab.bench import Bench, as_row
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.experiments.latency.stage import PATHS, Running
from sfglab.lab.meters import measure
from sfglab.lab.ros2 import RosMissingError
from sfglab.units import BITS_PER_BYTE, BITS_PER_MBIT

GLASS_PATHS = ("standard", "decoder", "agent", "container")
"""Those whose steady state is measured as well; the fifth differs from the fourth in its beginning only."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    #: How often every path is subscribed to; that by a new process half as often.
    repeats: int = 20
    look_s: float = 0.5  #: How long the viewer looks on after its first picture, seconds.
    skipped: int = 3  #: Pictures at the beginning of a look that do not count for glass-to-glass.
    idle_s: float = 3.0  #: How long the idle load is measured, seconds.
    ros2: int = 6  #: How often a subscriber of real ROS 2 looks at raw images, beside ours.
    source: str = "photos"  #: Where frames come from, as `open_source` takes it.
    encoder: str = "auto"  #: H.264 encoder by FFmpeg's name, or ``auto``.
    gop: int = between(30, 1, 300, log=True)  #: Frames from key frame to key frame.
    bitrate_mbit_s: float = between(4.0, 0.5, 20.0, log=True)  #: Of the stream [Mbit/s].
    #: Of the network in the computed budget; the live one is as fast as it is [Mbit/s].
    link_mbit_s: float = between(50.0, 5.0, 1000.0, log=True)
    #: How far DDS uses multicast between hosts: ``spdp`` (discovery only, as Cyclone DDS does on Wi-Fi, the
    #: paper's network) or ``default`` (data too, on a wired link).
    multicast: str = "spdp"
    seed: int = 0  #: Seed of the frames' path, the phases and the order of paths.


exp = Experiment(
    "latency",
    Config,
    where="A 5.4",
    smoke={"repeats": 2, "look_s": 0.4, "idle_s": 0.5, "ros2": 1},
    paper={"repeats": 120, "look_s": 1.0, "idle_s": 30.0, "ros2": 120},
    hosts=("edge", "consumer"),
    actors=(
        Actor("camera", "edge", "encodes once, publishes on four topics"),
        Actor(
            "keeper",
            "edge",
            "keeps the last group of pictures",
            count="2: own domain, global domain",
        ),
        Actor("router", "edge", "own domain to the global one"),
        Actor("router 2", "consumer", "global domain to the own one"),
        Actor(
            "decoder", "consumer", "decodes once", count="4: decoder, agent, container, on_demand"
        ),
        Actor("viewer", "consumer", "looks along one path at a time"),
    ),
    links=(
        Link("camera", "viewer", "compressed (standard)", boundary="network"),
        Link("camera", "decoder", "compressed (decoder)", boundary="network"),
        Link("camera", "keeper", "compressed"),
        Link("keeper", "decoder", "replay (decoder)", boundary="network"),
        Link("camera", "router", "compressed (agent, container, on_demand)"),
        Link("keeper", "router", "replay (agent)"),
        Link("router", "router 2", "compressed, replay", boundary="network"),
        Link("router 2", "decoder", "compressed, replay"),
        Link("decoder", "viewer", "pictures (decoder, agent)", over="shared memory"),
        Link("decoder", "viewer", "pictures (container, on_demand)"),
    ),
)


@exp.table("look")
class LookRow:
    """One subscription: from the order to subscribe to the order to stop."""

    look: int  #: Counter from 0.
    repeat: int  #: Which repetition.
    path: str  #: One of `PATHS`.
    #: When the order was to be given, as a share of the group of pictures, 0 at its key frame.
    phase: float
    ordered_ns: int  #: When the viewer had the order to subscribe (Unix time).
    first_ns: int  #: When it had its first picture in hand (Unix time).
    pictures: int  #: Pictures it saw.
    unreadable: int  #: Pictures with a stamp that the camera did not send.
    missed: int  #: Numbers skipped between two pictures.
    disordered: int  #: Pictures that were not newer than the one before.
    broken: int  #: Messages that the viewer could not decode.
    replay_packets: int  #: Packets in the keepers' bursts for this look; 0 without a replay.
    replay_bytes: int  #: Their size.


@exp.table("sight")
class SightRow:
    """A picture in the viewer's hands."""

    look: int  #: The look.
    number: int  #: Number of the frame.
    seen_ns: int  #: When it was in hand (Unix time).


@exp.table("camera")
class ShotRow:
    """A frame that the camera sent."""

    number: int  #: Counter from 0.
    stamp_ns: int  #: Capture stamp (Unix time).
    size_bytes: int  #: Compressed size.


@exp.table("idle")
class IdleRow:
    """What something costs on the camera's host while nobody looks, in one window."""

    #: ``camera``, ``keeper`` or ``router``; ``keeper`` is the one in the agent's own domain.
    label: str
    cpu_percent: float  #: CPU of its process, per cent of one core.
    tx_mbit_s: float  #: Sent at the host's interface by everybody, Mbit/s.
    loopback_mbit_s: float  #: Carried by the host's loopback for everybody, Mbit/s.
    window_s: float  #: Length of the window, seconds.


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """One subscription to be made."""

    repeat: int  #: Which repetition.
    path: str  #: One of `PATHS`.
    phase: float  #: When in the group of pictures, 0 to 1.


def looks_of(config: Config, *, rng: np.random.Generator) -> list[Look]:
    """Return all looks in the order in which they are made.

    Every repetition subscribes to all paths in random order at one phase of the group of pictures; phases are
    drawn from equal shares of the group (stratified). What takes long and is judged by nothing, a new process
    for each look, is asked in every second repetition.
    """
    shares = (rng.permutation(config.repeats) + rng.uniform(size=config.repeats)) / config.repeats
    return [
        Look(repeat=repeat, path=str(path), phase=float(phase))
        for repeat, phase in enumerate(shares)
        for path in rng.permutation(PATHS)
        if path != "on_demand" or repeat % 2 == 0
    ]


def _all_looks(config: Config) -> list[Look]:
    return looks_of(config, rng=np.random.default_rng(config.seed))


@exp.part("looks", total=lambda config: len(_all_looks(config)))
async def measure_looks(bench: Bench[Config]) -> None:
    """Measure the idle load, then all looks."""
    looks = _all_looks(bench.config)
    async with Running(bench.config, bench.testbed) as running:
        bench.metadata("stream", {"encoder": running.encoder, "gop_s": running.gop_s})
        for path in PATHS:
            # Unmeasured: what only the first time of a process costs is not asked here.
            await running.look(path)
            await running.stop(path)
        await _measure_idle(running, bench)
        for number, look in enumerate(looks):
            await _measure_look(number, look, running, bench)
            bench.advance(look.path)
    for number, stamp_ns, size_bytes in running.sent:
        row = {"number": number, "stamp_ns": stamp_ns, "size_bytes": size_bytes}
        bench.write("camera", row, at_ns=stamp_ns)


declare(
    exp, "Raw images, one subscriber: a real one (rclpy) is later than our stand-in, and loses some"
)


@exp.part(PART, total=lambda config: 2 * config.ros2, skips=(RosMissingError,))
async def look_beside_ros2(bench: Bench[Config]) -> None:
    """Let subscribers of raw images look, real ones beside ours."""
    quantities = ("capture to picture in hand (ms)", "first picture (ms)", "pictures received (%)")
    await measure_raw(
        bench, quantities, counts=(1,), repeats=bench.config.ros2, look_s=bench.config.look_s
    )


async def _measure_idle(running: Running, bench: Bench[Config]) -> None:
    """Measure what the edge pays while nobody looks."""
    before, started = running.loopback_bytes(), time.monotonic()
    readings = await measure(
        bench.config.idle_s,
        bench.config.idle_s,
        cpu=running.pids,
        interfaces=dict.fromkeys(running.pids, bench.testbed.meter("edge")),
        clock_ns=time.time_ns,
    )
    carried_bps = (running.loopback_bytes() - before) * BITS_PER_BYTE / (time.monotonic() - started)
    for reading in readings:
        assert reading.cpu_percent is not None, "every label has a process"
        assert reading.tx_bps is not None, "every label has an interface"
        rates_bps = {"tx_mbit_s": reading.tx_bps, "loopback_mbit_s": carried_bps}
        row = {name: rate_bps / BITS_PER_MBIT for name, rate_bps in rates_bps.items()}
        bench.write("idle", as_row(IdleRow, row, reading), at_ns=reading.t_ns)


async def _measure_look(number: int, look: Look, running: Running, bench: Bench[Config]) -> None:
    await running.wait_for_phase(look.phase)
    running.replays.clear()
    first = await running.look(look.path)
    if look.path in GLASS_PATHS:
        await asyncio.sleep(bench.config.look_s)
    seen = await running.stop(look.path)
    now_ns = time.time_ns()
    for picture, seen_ns in seen["sightings"]:
        bench.write("sight", {"look": number, "number": picture, "seen_ns": seen_ns}, at_ns=seen_ns)
    row: dict[str, Any] = {
        "look": number,
        **asdict(look),
        "ordered_ns": first["ordered_ns"],
        "first_ns": first["seen_ns"],
        "pictures": seen["frames"],
        **{name: seen[name] for name in ("unreadable", "missed", "disordered", "broken")},
        "replay_packets": sum(packets for packets, _ in running.replays),
        "replay_bytes": sum(size for _, size in running.replays),
    }
    # Last, so that a look that is in the log is complete.
    bench.write("look", row, at_ns=now_ns)

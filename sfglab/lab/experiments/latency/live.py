"""Live part: a camera on the edge host, routers on both hosts, decoders and one viewer on the consumer host.

The camera encodes each frame once and publishes it on four topics, which belong to these paths:

standard   camera - global domain - viewer, which decodes. There is no router and no decoder.
decoder    camera - global domain - decoder - shared memory - viewer. It has a GOP cache and a standby process.
agent      camera - edge's domain - router - global domain - router - consumer's domain - decoder - shared
           memory - viewer. It has a GOP cache and a standby process: the sfglab variant.
container  Like agent, but as in the paper: the decoder is loaded on demand into a running process, its component
           container. It does not use the GOP cache, and publishes images over DDS.
on_demand  Like container, but the decoder is loaded into a process that is started for it.

As in the paper, the edge agent has been discovered before: the viewer runs, and its nodes are in their domains.
"""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.codecs import TABLE_2
from sfglab.fleet.decoder.config import DecoderConfig
from sfglab.fleet.decoder.streams import routes_of_topic
from sfglab.fleet.gop_config import GopCacheConfig
from sfglab.fleet.router.config import RouterConfig
from sfglab.lab.bench import as_row
from sfglab.lab.cells import run_cells
from sfglab.lab.experiments.latency.experiment import (
    GOP_S,
    NUMBERS,
    PATHS,
    STEADY_PATHS,
    Config,
    Group,
    LookRow,
    ShotRow,
    SightRow,
    exp,
    groups_of,
)
from sfglab.lab.streams import FIRST_PICTURE_S, LINGER_S, StreamProcesses
from sfglab.processes import Member
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.component import Report
    from sfglab.lab.bench import Bench
    from sfglab.lab.testbed import Testbed

DECODER_PATHS = PATHS[1:]  #: Paths with a decoder.
PAPER_PATHS = ("container", "on_demand")  #: Paths as in the paper.
MODES = {"standard": "standard", "decoder": "proxy", "agent": "proxy"} | dict.fromkeys(
    PAPER_PATHS, "dds"
)
"""Mode of the viewer, by path."""
TOPICS = {
    "standard": "/global/edge/camera_direct/color/ffmpeg",
    "decoder": "/global/edge/camera_direct/color/ffmpeg",
    "agent": "/global/edge/camera_front/color/ffmpeg",
    "container": "/global/edge/camera_paper/color/ffmpeg",
    "on_demand": "/global/edge/camera_process/color/ffmpeg",
}
"""Topic of the camera's compressed stream, by path."""
ROUTERS = {"router": ("edge", "outward"), "router 2": ("consumer", "inward")}
"""Host of each router, and the direction of the camera's topics.

In the other direction a path is always open, because the GOP cache subscribes to a topic that routers forward.
"""
DOMAINS = {"edge": 41, "consumer": 42}


class Processes(StreamProcesses):
    """The processes of the experiment, which all subscriptions share."""

    def __init__(self, config: Config, testbed: Testbed) -> None:
        self._open_paths: dict[str, int] = {}  # number of open paths of the camera, by router
        self.replayed = 0  #: Number of packets that the GOP caches replayed in this subscription.
        super().__init__(config, testbed)

    def first_members(self) -> list[Member]:
        """Return the processes of camera, GOP caches, routers, viewer and decoders."""
        own = self._own
        places = [(own("edge"), TOPICS[path]) for path in ("agent", *PAPER_PATHS)]
        members = [self.camera((self.shared("edge"), TOPICS["standard"]), *places)]
        started: list[tuple[str, str, str, Any]] = []
        caches = {"agent": own("edge"), "decoder": self.shared("edge")}
        for path, address in caches.items():
            cache = GopCacheConfig(address=address, streams=(TOPICS[path],))
            started.append((f"GOP cache of {path}", "edge", "sfglab.fleet.gop_cache", cache))
        for name, (host, _) in ROUTERS.items():
            router = RouterConfig(
                agent=host, local=own(host), remote=self.shared(host), idle_timeout_s=LINGER_S
            )
            started.append((name, host, "sfglab.fleet.router.node", router))
        viewer = self.viewer_config(TOPICS["standard"], own("consumer"), joined=True)
        started.append(("viewer", "consumer", "sfglab.lab.workers.viewer", viewer))
        for path in DECODER_PATHS:
            decoder = self._decoder(path)
            started.append((path, "consumer", "sfglab.fleet.decoder.node", decoder))
        for name, host, module, config in started:
            members.append(Member(name=name, host=host, module=module, config=config))
        return members

    def _own(self, host: str) -> BusAddress:
        return BusAddress(domain_id=DOMAINS[host], interface="lo")

    def _decoder(self, path: str) -> DecoderConfig:
        own, is_ours = self._own("consumer"), path not in PAPER_PATHS
        return DecoderConfig(
            remote=self.shared("consumer") if path == "decoder" else own,
            local=own,
            streams=(TOPICS[path],),
            idle_timeout_s=LINGER_S,
            replay=is_ours,
            spare=path != "on_demand",
            refill=is_ours,
        )

    async def settle(self) -> None:
        """Wait for a frame and the standby processes, and subscribe once on each path."""
        await self["camera"].expect("sent", timeout_s=FIRST_PICTURE_S)
        for path in DECODER_PATHS:
            await self.warm(path)
        for path in PATHS:
            # The first subscription of a process is not measured, because it takes longer.
            await self.subscribe(path)
            await self.stop(path)

    def note(self, name: str, report: Report) -> None:
        """Process a report about frames, replays or open paths."""
        super().note(name, report)
        if report["is"] == "replayed":
            self.replayed += report["packets"]
        elif report["is"] == "status" and name in ROUTERS:
            _, direction = ROUTERS[name]
            ways = [path["direction"] for path in report["paths"] if "camera_" in path["topic"]]
            self._open_paths[name] = ways.count(direction)

    async def wait_for_phase(self, phase: float) -> None:
        """Wait until a share of a GOP, 0 to 1, has passed since a key frame.

        The camera has an absolute schedule, so the time of all key frames follows from any frame.
        """
        number, stamp_ns, _ = self.sent[0]
        gop_ns = GOP_S * NS_PER_S
        key_ns = stamp_ns - number * gop_ns / TABLE_2.gop
        now = (time.time_ns() - key_ns) / gop_ns % 1.0
        await asyncio.sleep((phase - now) % 1.0 * GOP_S)

    async def subscribe(self, path: str) -> Report:
        """Order the viewer to subscribe on a path, and return its report of the first image.

        Raises:
            ProcessFailedError: The viewer received no image in time, or a process failed.
        """
        image, _ = routes_of_topic(TOPICS[path])
        topic = image.source_topic if path == "standard" else image.local_topic
        order = {"do": "look", "mode": MODES[path], "topic": topic}
        first = await self.ask("first", ["viewer"], timeout_s=FIRST_PICTURE_S, **order)
        return first["viewer"]

    async def stop(self, path: str) -> Report:
        """Order the viewer to stop, wait until the routers and decoders have closed the path, and return its report."""
        seen = await self.seen(["viewer"])
        if path != "standard":
            await self.released(path)
            await self.warm(path)
        async with asyncio.timeout(FIRST_PICTURE_S):
            while any(self._open_paths.values()):
                self.check()
                await asyncio.sleep(0.01)
        return seen["viewer"]

    async def measure(self, group: Group) -> dict[str, list[Any]]:
        """Subscribe on each path of a group, and return rows by table."""
        # A replay begins with the key frame before the subscription.
        del self.sent[: -TABLE_2.gop]
        base = group.repeat * NUMBERS
        looks, sights = [], []
        for look, path in enumerate(group.paths, start=group.first):
            await self.wait_for_phase(group.phase)
            self.replayed = 0
            first = await self.subscribe(path)
            if path in STEADY_PATHS:
                await asyncio.sleep(self._config.look_s)
            seen = await self.stop(path)
            for number, seen_ns in seen["sightings"]:
                sights.append(SightRow(look=look, number=base + number, seen_ns=seen_ns))
            row = {
                "look": look,
                "repeat": group.repeat,
                "path": path,
                "first_ns": first["seen_ns"],
                "pictures": seen["frames"],
                "replay_packets": self.replayed,
            }
            looks.append(as_row(LookRow, row, first, seen))
        # `seen` has waited for the camera's reports of all frames that the viewer saw.
        shots = [
            ShotRow(number=base + number, stamp_ns=stamp_ns) for number, stamp_ns, _ in self.sent
        ]
        return {"camera": shots, "sight": sights, "look": looks}


@exp.part("looks", total=lambda config: config.repeats)
async def measure_groups(bench: Bench[Config]) -> None:
    """Measure all repetitions one after the other with the same processes."""
    config = bench.config
    encoders = set()

    async def play(processes: Processes, group: Group, _: int) -> dict[str, list[Any]]:
        encoders.add(processes.encoder)
        return await processes.measure(group)

    await run_cells(
        bench,
        "looks",
        dict.fromkeys(groups_of(config), 1),
        stage_of=lambda _: "all",
        start=lambda _: Processes(config, bench.testbed),
        play=play,
    )
    bench.metadata("stream", {"encoder": ", ".join(sorted(encoders)), "gop_s": GOP_S})

"""Hosts and processes: a camera with keeper and router at the edge, decoders and one viewer at the consumer.

Each frame is encoded once and published on four topics; who listens to which decides the path:

standard   camera - D_0 - viewer, which decodes for itself. No router, no decoder: standard ROS 2.
decoder    camera - D_0 - decoder - shared memory - viewer. With keeper (in D_0) and warm spare.
agent      camera - D_1 - router - D_0 - router - D_2 - decoder - shared memory - viewer. With keeper (in D_1)
           and warm spare: the whole of an agent's path.
container  the paper's way: as agent, but the decoder is loaded on demand into a process that is there, its
           component container; no keeper is asked, and pictures go out by DDS instead of shared memory.
on_demand  as container, but the decoder is loaded into a process that is started for it.

Streams are known beforehand ("while the edge agent is already discovered"); the viewer's process runs and its
nodes are in their domains, as a display's are.
"""

from __future__ import annotations

import asyncio
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.fleet.decoder.config import DecoderConfig
from sfglab.fleet.decoder.streams import routes_of_topic
from sfglab.fleet.gop_config import GopCacheConfig
from sfglab.fleet.router.config import RouterConfig
from sfglab.lab.hosts.host import interface_bytes
from sfglab.lab.streams import FIRST_PICTURE_S, LINGER_S, StreamProcesses
from sfglab.lab.workers.camera import CameraConfig
from sfglab.names import Component, Resource, RosFqnBuilder, Scope, Stream
from sfglab.processes import Member, ProcessFailedError
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.component import Report
    from sfglab.lab.testbed import Testbed

#: The ways from camera to viewer.
PATHS = ("standard", "decoder", "agent", "container", "on_demand")
DECODERS = PATHS[1:]  #: Those with a decoder.
PAPERS = ("container", "on_demand")  #: Those in the paper's manner.

EDGE_DOMAIN, CONSUMER_DOMAIN = 41, 42

_CAMERAS = {
    "standard": "direct",
    "decoder": "direct",
    "agent": "front",
    "container": "paper",
    "on_demand": "process",
}
"""The component's suffix in the stream's name, by path."""


def stream_topic(path: str) -> str:
    """Return the name of the stream that a path begins with."""
    builder = (
        RosFqnBuilder()
        .scope(Scope.GLOBAL)
        .agent("edge")
        .component(Component.CAMERA, _CAMERAS[path])
    )
    return str(builder.stream(Stream.COLOR).resource(Resource.FFMPEG).build())


def _member(name: str, host: str, module: str, config: Any, *, ready: str = "ready") -> Member:
    return Member(name=name, host=host, module=module, config=config, ready=ready)


class Running(StreamProcesses):
    """The experiment's processes."""

    def __init__(self, config: Any, testbed: Testbed) -> None:
        self._open_paths: dict[str, int] = {}
        #: Packets and bytes of every burst that a keeper reported.
        self.replays: list[tuple[int, int]] = []
        super().__init__(config, testbed)
        camera = self._camera()
        self._gop = camera.gop
        self.gop_s = camera.gop / camera.fps  #: Time from key frame to key frame, seconds.

    async def settle(self) -> None:
        """Wait for the first frame, and until every decoder is warm."""
        await self["camera"].expect("sent", timeout_s=FIRST_PICTURE_S)
        for path in DECODERS:
            await self.warm(path)

    def first_members(self) -> list[Member]:
        """Return camera, keepers, routers, viewer and decoders."""
        keepers = {
            "keeper": (self._own("edge"), "agent"),
            "keeper 0": (self.shared("edge"), "decoder"),
        }
        routers = {"router": "edge", "router 2": "consumer"}
        keeping = {
            name: GopCacheConfig(address=where, streams=(stream_topic(path),))
            for name, (where, path) in keepers.items()
        }
        viewer = self.viewer_config(stream_topic("standard"), self._own("consumer"), joined=True)
        return [
            _member("camera", "edge", "sfglab.lab.workers.camera", self._camera(), ready="running"),
            *(
                _member(name, "edge", "sfglab.fleet.gop_cache", config)
                for name, config in keeping.items()
            ),
            *(
                _member(n, host, "sfglab.fleet.router.node", self._router(host))
                for n, host in routers.items()
            ),
            _member("viewer", "consumer", "sfglab.lab.workers.viewer", viewer),
            *(
                _member(n, "consumer", "sfglab.fleet.decoder.node", self._decoder(n))
                for n in DECODERS
            ),
        ]

    def note(self, name: str, report: Report) -> None:
        """Take a member's report."""
        super().note(name, report)
        if report["is"] == "replayed":
            self.replays.append((report["packets"], report["size_bytes"]))
        elif report["is"] == "status" and name in ("router", "router 2"):
            # The other way a path stays open all the time: the keeper subscribes to a name that may cross.
            way = "outward" if name == "router" else "inward"
            ways = [path["direction"] for path in report["paths"] if "camera_" in path["topic"]]
            self._open_paths[name] = ways.count(way)

    def _own(self, host: str) -> BusAddress:
        return BusAddress(
            domain_id=EDGE_DOMAIN if host == "edge" else CONSUMER_DOMAIN, interface="lo"
        )

    def _camera(self) -> CameraConfig:
        return CameraConfig(
            places=(
                (self.shared("edge"), stream_topic("standard")),
                *((self._own("edge"), stream_topic(path)) for path in ("agent", *PAPERS)),
            ),
            source=self._config.source,
            seed=self._config.seed,
            encoder=self._config.encoder,
            gop=self._config.gop,
            bitrate_bps=round(self._config.bitrate_mbit_s * 1e6),
        )

    def _router(self, host: str) -> RouterConfig:
        return RouterConfig(
            agent=host, local=self._own(host), remote=self.shared(host), idle_timeout_s=LINGER_S
        )

    def _decoder(self, path: str) -> DecoderConfig:
        own = self._own("consumer")
        return DecoderConfig(
            remote=self.shared("consumer") if path == "decoder" else own,
            local=own,
            streams=(stream_topic(path),),
            idle_timeout_s=LINGER_S,
            replay=path not in PAPERS,
            spare=path != "on_demand",
            refill=path not in PAPERS,
        )

    @property
    def pids(self) -> dict[str, tuple[int, ...]]:
        """Process ids of what runs at the edge for an agent, by label."""
        return {name: (self[name].pid,) for name in ("camera", "keeper", "router")}

    def loopback_bytes(self) -> int:
        """Return what the edge's loopback has carried so far."""
        table = Path(f"/proc/{self['camera'].pid}/net/dev").read_text(encoding="ascii")
        return interface_bytes(table, "lo").rx_bytes

    async def wait_for_phase(self, phase: float) -> None:
        """Return when a group of pictures has come that far, as a share of it.

        The camera keeps its rate by an absolute schedule, so that any of its frames tells all key frames.
        """
        number, stamp_ns, _ = self.sent[0]
        gop_ns = self.gop_s * NS_PER_S
        key_ns = stamp_ns - number * gop_ns / self._gop
        now = (time.time_ns() - key_ns) / gop_ns % 1.0
        await asyncio.sleep((phase - now) % 1.0 * self.gop_s)

    async def look(self, path: str) -> dict[str, Any]:
        """Let the viewer subscribe, and return its report of the first picture.

        Raises:
            ProcessFailedError: It saw none in time, or a process failed.
        """
        mode = "standard" if path == "standard" else "dds" if path in PAPERS else "proxy"
        image, _ = routes_of_topic(stream_topic(path))
        topic = image.source_topic if mode == "standard" else image.local_topic
        self["viewer"].order(do="look", mode=mode, topic=topic)
        return await self["viewer"].expect("first", timeout_s=FIRST_PICTURE_S)

    async def stop(self, path: str) -> dict[str, Any]:
        """Let the viewer stop, wait until nothing of the path is left open, and return what it has seen."""
        seen = (await self.seen(["viewer"]))["viewer"]
        if path != "standard":
            await self.released(path)
            await self.warm(path)
        await self._closed()
        return seen

    async def _closed(self) -> None:
        for _ in range(round(FIRST_PICTURE_S / 0.01)):
            self.check()
            if not any(self._open_paths.values()):
                return
            await asyncio.sleep(0.01)
        raise ProcessFailedError("routers: a stream's path is still open although nobody looks")

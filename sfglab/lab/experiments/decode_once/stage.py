"""One stream's hosts and processes: camera on the edge host, decoder and viewers on the consumer host.

Knows how to start, order and end them; refuses to know what is measured.
"""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.fleet.decoder.node import DecoderConfig
from sfglab.fleet.decoder.streams import routes_of_topic
from sfglab.lab.streams import FIRST_PICTURE_S, LINGER_S, StreamProcesses
from sfglab.lab.workers.camera import CameraConfig
from sfglab.names import Component, Resource, RosFqnBuilder, Scope, Stream
from sfglab.processes import Member

if TYPE_CHECKING:
    from pathlib import Path

    from sfglab.component import Report
    from sfglab.lab.testbed import Testbed

MBIT = 1e6
HANDED_ON = ("dds", "proxy")
"""Modes in which one decoder hands pictures on: by DDS, the paper's way, and by shared memory, ours."""
LOCAL_DOMAIN = 7


def stream_topic(codec: str) -> str:
    """Return the name of the camera's compressed stream in the global scope."""
    camera = RosFqnBuilder().scope(Scope.GLOBAL).agent("edge").component(Component.CAMERA, "front")
    colour, depth = (Stream.COLOR, Resource.FFMPEG), (Stream.DEPTH, Resource.COMPRESSED_DEPTH)
    stream, resource = colour if codec == "h264" else depth
    return str(camera.stream(stream).resource(resource).build())


class Running(StreamProcesses):
    """The processes of one of the configuration's stages."""

    def __init__(self, config: Any, stage: Any, testbed: Testbed) -> None:
        self._stage = stage
        self._decoder_pids: tuple[int, ...] = ()
        self._topic = stream_topic(stage.codec)
        most = max(stage.counts + stage.dds_counts + stage.network_counts)
        self._viewers = [f"viewer {i}" for i in range(most)]
        super().__init__(config, testbed)

    async def settle(self) -> None:
        """Wait until the decoder's spare is warm."""
        self._decoder_pids = await self.warm("decoder")

    @property
    def stream(self) -> dict[str, str]:
        """Topic, type, encoder and source of the stream."""
        return {
            "topic": self._topic,
            "type": routes_of_topic(self._topic)[0].source_type,
            "encoder": self.encoder,
            "source": self._stage.source,
        }

    @property
    def edge_pids(self) -> tuple[int, ...]:
        """Process ids of the camera."""
        return (self["camera"].pid,)

    def consumer_pids(self, mode: str) -> tuple[int, ...]:
        """Process ids that a mode needs on the consumer host."""
        viewers = tuple(self[name].pid for name in self._viewers)
        return viewers + self._decoder_pids if mode in HANDED_ON else viewers

    def first_members(self) -> list[Member]:
        """Return camera, decoder and viewers."""
        local = BusAddress(domain_id=LOCAL_DOMAIN, interface="lo")
        camera = CameraConfig(
            places=((self.shared("edge"), self._topic),),
            codec=self._stage.codec,
            source=self._stage.source,
            seed=self._config.seed,
            encoder=self._config.encoder,
        )
        # One process is lent to one cell after the other, as a component container is: none starts in between.
        decoder = DecoderConfig(
            remote=self.shared("consumer"),
            local=local,
            streams=(self._topic,),
            linger_s=LINGER_S,
            refill=False,
        )
        viewer = self.viewer_config(self._topic, local)
        looks = "sfglab.lab.workers.viewer"
        return [
            *(
                Member(name=name, host="consumer", module=looks, config=viewer)
                for name in self._viewers
            ),
            Member(
                name="decoder", host="consumer", module="sfglab.fleet.decoder.node", config=decoder
            ),
            Member(
                name="camera",
                host="edge",
                module="sfglab.lab.workers.camera",
                config=camera,
                ready="running",
            ),
        ]

    async def look(self, mode: str, count: int) -> float:
        """Let the first viewers look, and return how long it took until each had a frame, in seconds."""
        started = time.monotonic()
        await self.ask(
            "first", self._viewers[:count], timeout_s=FIRST_PICTURE_S, do="look", mode=mode
        )
        return time.monotonic() - started

    async def record(self, path: Path, duration_s: float) -> None:
        """Let the first viewer write the stream's messages, as they arrive, into a log of its own."""
        order = {"do": "look", "mode": "network", "path": str(path)}
        await self.ask("first", self._viewers[:1], timeout_s=FIRST_PICTURE_S, **order)
        await asyncio.sleep(duration_s)
        await self.stop(1)

    async def stop(self, count: int) -> list[Report]:
        """Let them stop, and return what each has seen."""
        seen = await self.ask("seen", self._viewers[:count], timeout_s=FIRST_PICTURE_S, do="stop")
        return list(seen.values())

    async def released(self, decoder: str) -> None:
        """Return when a decoder has its pipeline's process back."""
        await super().released(decoder)
        assert await self.warm(decoder) == self._decoder_pids, "no process more, and none less"

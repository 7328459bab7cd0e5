"""One stream's hosts and processes: camera on the edge host, decoder and viewers on the consumer host.

Knows how to start, order and end them; refuses to know what is measured.
"""

from __future__ import annotations

import asyncio
import sys
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.component import argument_of
from sfglab.fleet.decoder.node import DecoderConfig
from sfglab.fleet.decoder.streams import routes_of_topic
from sfglab.lab.staging import Staged
from sfglab.lab.workers.camera import CameraConfig
from sfglab.lab.workers.viewer import ViewerConfig
from sfglab.names import Component, Resource, RosFqnBuilder, Scope, Stream
from sfglab.processes import LineProcess, ProcessFailedError

if TYPE_CHECKING:
    from pathlib import Path

    from sfglab.lab.experiments.decode_once.config import Config, Stage
    from sfglab.lab.testbed import Testbed


REMOTE_DOMAIN = 0
LOCAL_DOMAIN = 7
START_S = 30.0
FIRST_FRAME_S = 10.0
LINGER_S = 0.1


def stream_topic(codec: str) -> str:
    """Return the name of the camera's compressed stream in the global scope."""
    stream, resource = (
        (Stream.COLOR, Resource.FFMPEG) if codec == "h264" else (Stream.DEPTH, Resource.COMPRESSED_DEPTH)
    )
    return str(
        RosFqnBuilder()
        .scope(Scope.GLOBAL)
        .agent("edge")
        .component(Component.CAMERA, "front")
        .stream(stream)
        .resource(resource)
        .build()
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """What one viewer reports after a cell, as its process says it."""

    viewer: int
    report: dict[str, Any]


class Running(Staged):
    """A stage whose processes run; an async context manager that ends them.

    Args:
        config: The experiment.
        stage: The stream.
        testbed: Hosts.

    Attributes:
        topic: The compressed topic.
        type: Its ROS type.
        encoder: The encoder that the camera opened.
        sent: Number, stamp and size of every frame that the camera has reported.
    """

    def __init__(self, config: Config, stage: Stage, testbed: Testbed) -> None:
        super().__init__()
        self._config = config
        self._stage = stage
        self._testbed = testbed
        self._viewers: list[LineProcess] = []
        self._decoder: LineProcess
        self._camera: LineProcess
        self._decoder_pids: tuple[int, ...] = ()
        self.topic = stream_topic(stage.codec)
        self.type = routes_of_topic(self.topic)[0].source_type
        self.encoder = ""
        self.sent: list[tuple[int, int, int]] = []

    @property
    def edge_pids(self) -> tuple[int, ...]:
        """Process ids of the camera."""
        return (self._camera.pid,)

    def consumer_pids(self, mode: str) -> tuple[int, ...]:
        """Process ids that a mode needs on the consumer host."""
        viewers = tuple(v.pid for v in self._viewers)
        return viewers + self._decoder_pids if mode == "proxy" else viewers

    async def _start(self) -> None:
        count = max(self._stage.counts + self._stage.network_counts)
        starts = [self._launch(f"viewer {i}", "consumer", self._viewer_argv()) for i in range(count)]
        decoder = self._launch("decoder", "consumer", self._decoder_argv())
        camera = self._launch("camera", "edge", self._camera_argv(), on_report=self._note_sent)
        self._decoder, self._camera, *self._viewers = await asyncio.gather(decoder, camera, *starts)
        running = await self._camera.expect("running", timeout_s=START_S)
        self.encoder = running["encoder"]
        await self._decoder.expect("ready", timeout_s=START_S)
        for viewer in self._viewers:
            await viewer.expect("ready", timeout_s=START_S)
        await self._settle_decoder()

    async def _launch(self, name: str, host: str, argv: list[str], **options: Any) -> LineProcess:
        process = await LineProcess.start(name, self._testbed.argv(host, argv), **options)
        self._stack.push_async_callback(process.close)
        return process

    def _note_sent(self, report: dict[str, Any]) -> None:
        if report["is"] == "sent":
            self.sent += [(n, s, b) for n, s, b in report["frames"]]

    def _remote(self, host: str) -> BusAddress:
        return BusAddress(
            domain_id=REMOTE_DOMAIN,
            interface=self._testbed.interface(host),
            multicast=self._config.multicast,
        )

    def _local(self) -> BusAddress:
        return BusAddress(domain_id=LOCAL_DOMAIN, interface="lo")

    def _camera_argv(self) -> list[str]:
        config = CameraConfig(
            places=((self._remote("edge"), self.topic),),
            codec=self._stage.codec,
            source=self._stage.source,
            seed=self._config.seed,
            encoder=self._config.encoder,
        )
        return [sys.executable, "-m", "sfglab.lab.workers.camera", argument_of(config)]

    def _decoder_argv(self) -> list[str]:
        config = DecoderConfig(
            remote=self._remote("consumer"), local=self._local(), streams=(self.topic,), linger_s=LINGER_S
        )
        return [sys.executable, "-m", "sfglab.fleet.decoder.node", argument_of(config)]

    def _viewer_argv(self) -> list[str]:
        image, _ = routes_of_topic(self.topic)
        config = ViewerConfig(
            remote=self._remote("consumer"),
            local=self._local(),
            remote_topic=image.source_topic,
            remote_type=image.source_type,
            codec=image.codec,
            local_topic=image.local_topic,
        )
        return [sys.executable, "-m", "sfglab.lab.workers.viewer", argument_of(config)]

    async def look(self, mode: str, count: int) -> float:
        """Let the first viewers look, and return how long it took until each had a frame, in seconds."""
        started = time.monotonic()
        for viewer in self._viewers[:count]:
            viewer.order(do="look", mode=mode)
        for viewer in self._viewers[:count]:
            await viewer.expect("first", timeout_s=FIRST_FRAME_S)
        elapsed_s = time.monotonic() - started
        if mode == "proxy":
            await self._settle_decoder()
        return elapsed_s

    async def record(self, path: Path, duration_s: float) -> None:
        """Let the first viewer write the stream's messages, as they arrive, into a log of its own."""
        self._viewers[0].order(do="look", mode="network", path=str(path))
        await self._viewers[0].expect("first", timeout_s=FIRST_FRAME_S)
        await asyncio.sleep(duration_s)
        await self.stop(1)

    async def stop(self, count: int) -> list[View]:
        """Let them stop, and return what each has seen."""
        for viewer in self._viewers[:count]:
            viewer.order(do="stop")
        return [
            View(viewer=i, report=await viewer.expect("seen", timeout_s=FIRST_FRAME_S))
            for i, viewer in enumerate(self._viewers[:count])
        ]

    async def wait_for_release(self) -> None:
        """Return when the decoder has released its pipeline."""
        while True:
            status = await self._decoder.expect("status", timeout_s=FIRST_FRAME_S)
            if status["state"] == "IDLE":
                return

    async def _settle_decoder(self) -> None:
        """Wait until the decoder's spare is warm, so that its start does not fall into a reading."""
        for _ in range(200):
            self._decoder.order(do="list")
            processes = await self._decoder.expect("processes", timeout_s=START_S)
            self._decoder_pids = (self._decoder.pid, *processes["pids"])
            if processes["warm"]:
                return
            await asyncio.sleep(0.05)
        raise ProcessFailedError("decoder: its spare pipeline process did not become ready")

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
from sfglab.lab.workers.camera import CameraConfig
from sfglab.lab.workers.viewer import ViewerConfig
from sfglab.names import Component, Resource, RosFqnBuilder, Scope, Stream
from sfglab.processes import Member, ProcessFailedError, ProcessGroup

if TYPE_CHECKING:
    from pathlib import Path
    from typing import Self

    from sfglab.component import Report
    from sfglab.lab.testbed import Testbed

MBIT = 1e6
REMOTE_DOMAIN = 0
LOCAL_DOMAIN = 7
FIRST_FRAME_S = 60.0
LINGER_S = 0.1


def stream_topic(codec: str) -> str:
    """Return the name of the camera's compressed stream in the global scope."""
    camera = RosFqnBuilder().scope(Scope.GLOBAL).agent("edge").component(Component.CAMERA, "front")
    colour, depth = (Stream.COLOR, Resource.FFMPEG), (Stream.DEPTH, Resource.COMPRESSED_DEPTH)
    stream, resource = colour if codec == "h264" else depth
    return str(camera.stream(stream).resource(resource).build())


class Running(ProcessGroup):
    """A stage's processes.

    Args:
        config: The experiment's configuration.
        stage: The stream, one of its stages.
        testbed: Hosts.

    Attributes:
        sent: Number, stamp and size of every frame that the camera has reported.
    """

    def __init__(self, config: Any, stage: Any, testbed: Testbed) -> None:
        self._config, self._stage, self._testbed = config, stage, testbed
        self._decoder_pids: tuple[int, ...] = ()
        self._topic = stream_topic(stage.codec)
        self._viewers = [f"viewer {i}" for i in range(max(stage.counts + stage.network_counts))]
        super().__init__(testbed.argv, self._first_members(), on_report=self._note_sent)
        self.sent: list[tuple[int, int, int]] = []

    async def __aenter__(self) -> Self:
        await super().__aenter__()
        try:
            await self._settle_decoder()
        except BaseException:
            await self.close()
            raise
        return self

    @property
    def stream(self) -> dict[str, str]:
        """Topic, type, encoder and source of the stream."""
        return {
            "topic": self._topic,
            "type": routes_of_topic(self._topic)[0].source_type,
            "encoder": self["camera"].readiness["encoder"],
            "source": self._stage.source,
        }

    @property
    def edge_pids(self) -> tuple[int, ...]:
        """Process ids of the camera."""
        return (self["camera"].pid,)

    def consumer_pids(self, mode: str) -> tuple[int, ...]:
        """Process ids that a mode needs on the consumer host."""
        viewers = tuple(self[name].pid for name in self._viewers)
        return viewers + self._decoder_pids if mode == "proxy" else viewers

    def _note_sent(self, name: str, report: Report) -> None:
        if name == "camera" and report["is"] == "sent":
            self.sent += [(n, s, b) for n, s, b in report["frames"]]

    def _remote(self, host: str) -> BusAddress:
        interface = self._testbed.interface(host)
        return BusAddress(domain_id=REMOTE_DOMAIN, interface=interface, multicast=self._config.multicast)

    def _first_members(self) -> list[Member]:
        local, image = BusAddress(domain_id=LOCAL_DOMAIN, interface="lo"), routes_of_topic(self._topic)[0]
        camera = CameraConfig(
            places=((self._remote("edge"), self._topic),),
            codec=self._stage.codec,
            source=self._stage.source,
            seed=self._config.seed,
            encoder=self._config.encoder,
        )
        decoder = DecoderConfig(
            remote=self._remote("consumer"), local=local, streams=(self._topic,), linger_s=LINGER_S
        )
        viewer = ViewerConfig(
            remote=self._remote("consumer"),
            local=local,
            remote_topic=image.source_topic,
            remote_type=image.source_type,
            codec=image.codec,
            local_topic=image.local_topic,
        )
        viewers = dict.fromkeys(self._viewers, ("consumer", "sfglab.lab.workers.viewer", viewer, "ready"))
        others = {
            "decoder": ("consumer", "sfglab.fleet.decoder.node", decoder, "ready"),
            "camera": ("edge", "sfglab.lab.workers.camera", camera, "running"),
        }
        return [
            Member(name=name, host=host, module=module, config=config, ready=ready)
            for name, (host, module, config, ready) in (viewers | others).items()
        ]

    async def look(self, mode: str, count: int) -> float:
        """Let the first viewers look, and return how long it took until each had a frame, in seconds."""
        started = time.monotonic()
        await self.ask("first", self._viewers[:count], timeout_s=FIRST_FRAME_S, do="look", mode=mode)
        elapsed_s = time.monotonic() - started
        if mode == "proxy":
            await self._settle_decoder()
        return elapsed_s

    async def record(self, path: Path, duration_s: float) -> None:
        """Let the first viewer write the stream's messages, as they arrive, into a log of its own."""
        order = {"do": "look", "mode": "network", "path": str(path)}
        await self.ask("first", self._viewers[:1], timeout_s=FIRST_FRAME_S, **order)
        await asyncio.sleep(duration_s)
        await self.stop(1)

    async def stop(self, count: int) -> list[Report]:
        """Let them stop, and return what each has seen."""
        seen = await self.ask("seen", self._viewers[:count], timeout_s=FIRST_FRAME_S, do="stop")
        return list(seen.values())

    async def wait_for_release(self) -> None:
        """Return when the decoder has released its pipeline."""
        decoder = self["decoder"]
        while (await decoder.expect("status", timeout_s=FIRST_FRAME_S))["state"] != "IDLE":
            pass

    async def _settle_decoder(self) -> None:
        """Wait until the decoder's spare is warm, so that its start does not fall into a reading."""
        decoder = self["decoder"]
        for _ in range(200):
            decoder.order(do="list")
            processes = await decoder.expect("processes", timeout_s=FIRST_FRAME_S)
            self._decoder_pids = (decoder.pid, *processes["pids"])
            if processes["warm"]:
                return
            await asyncio.sleep(0.05)
        raise ProcessFailedError("decoder: its spare pipeline process did not become ready")

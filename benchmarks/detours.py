"""Files that an H.264 frame passes from camera to callback, shapes of a heartbeat until it is an event.

Both run live, over DDS and shared memory on this host, in one process whose calls are traced. A frame: from
the camera's encoder through DDS, pipeline and shared memory to a subscription's callback, once the stream is
followed; files count that every traced frame passes. A heartbeat: from its arrival at a discoverer to the
published event; shapes are classes of `sfglab.fleet` whose values are handed from function to function, and the
two messages, but not the state that the discoverer keeps. Runs on older versions too:

    PYTHONPATH=<checkout> python benchmarks/detours.py
"""

from __future__ import annotations

import argparse
import asyncio
import dataclasses
import enum
import inspect
import sys
import threading
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import sfglab
from sfglab.bus import Node
from sfglab.codecs import FFMPEG_PACKET
from sfglab.messages import default_message, message_type, service_type
from sfglab.qos import LATCHED, SENSOR_DATA

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from types import CodeType, FrameType

ROOT = Path(sfglab.__file__).parent
STREAM = "/global/edge/camera_front/color/ffmpeg"
LOCAL = "/local/edge/camera_front/color/image_raw"
FPS, FRAMES = 4.0, 8
HEARTBEAT, EVENT, SERVICE = (
    f"sfglab_interfaces/{n}"
    for n in ("msg/AgentHeartbeat", "msg/AgentDiscoveryEvent", "srv/GetMetadata")
)
LIMIT_S = 60


def file_of(code: CodeType) -> str | None:
    """Return a function's file below the package; None for what is not ours."""
    path = Path(code.co_filename)
    return path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else None


@contextmanager
def traced(note: Callable[[FrameType, str, Any], None]) -> Iterator[None]:
    """Hear every call and return of Python functions in this thread and in those that begin within."""
    threading.setprofile(note)
    sys.setprofile(note)
    try:
        yield
    finally:
        sys.setprofile(None)
        threading.setprofile(None)


# --- A frame --------------------------------------------------------------------------------------------------


class FrameTrace:
    """Files between the camera's encoder and the callback, frame by frame."""

    def __init__(self) -> None:
        self.frames: list[set[str]] = []
        self._open: set[str] | None = None

    def note(self, frame: FrameType, event: str, _: Any) -> None:
        """Take an event of the profiler."""
        if event != "call" or (path := file_of(frame.f_code)) is None:
            return
        if path == "lab/workers/camera.py" and frame.f_code.co_name == "messages":
            self._open = set()
        if self._open is not None:
            self._open.add(path)

    def seen(self, _: Any) -> None:
        """Take a picture in the viewer's callback."""
        if self._open is not None:
            self.frames.append(self._open)
            self._open = None


async def trace_frames(remote: dict[str, Any], local: dict[str, Any], trace: FrameTrace) -> None:
    """Let a camera shoot, a pipeline decode and a viewer see."""
    from sfglab.fleet.decoder.pipeline import Outputs
    from sfglab.fleet.decoder.streams import IMAGE_TYPE
    from sfglab.lab.workers import camera

    async with Node("camera_pipeline", **remote) as far, Node("viewer", **local) as near:
        near.create_subscription(IMAGE_TYPE, LOCAL, trace.seen, SENSOR_DATA, transport="shm")
        decoding = asyncio.create_task(pipeline(far, Outputs(near, IMAGE_TYPE, LOCAL)))
        async with camera._camera(  # noqa: SLF001
            camera_config(camera.CameraConfig, remote), lambda _: None
        ) as opened:
            shooting = asyncio.create_task(opened.shoot)
            async with asyncio.timeout(LIMIT_S):
                while len(trace.frames) < FRAMES:  # noqa: ASYNC110 - the profiler has no events
                    await asyncio.sleep(0.1)
            for task in (shooting, decoding):
                task.cancel()
            await asyncio.gather(shooting, decoding, return_exceptions=True)


def camera_config(config_class: type[Any], remote: dict[str, Any]) -> Any:
    """Return a camera's configuration in this version's form."""
    settings = {"source": "photos", "fps": FPS, "gop": 2, "encoder": "libx264"}
    if "places" not in inspect.signature(config_class).parameters:
        return config_class(**remote, multicast="default", topic=STREAM, **settings)
    from sfglab.bus.address import BusAddress

    return config_class(places=((BusAddress(**remote), STREAM),), **settings)


async def pipeline(remote: Node, outputs: Any) -> None:
    """Run a pipeline with this version's arguments; nobody replays the stream."""
    from sfglab.fleet.decoder import pipeline as module

    stream = {
        "source_topic": STREAM,
        "source_type": FFMPEG_PACKET,
        "codec": "h264",
        "local_topic": LOCAL,
        "replay_topic": f"{STREAM}_replay",
    }
    if "order" in inspect.signature(module.run_pipeline).parameters:
        from sfglab.fleet.decoder.protocol import Open

        order = Open(**stream, transports=("shm",))
        await module.run_pipeline(order, remote=remote, outputs=outputs, counters=module.Counters())
    else:
        from sfglab.fleet.decoder.streams import Route

        counts, route = module.Statistics(), Route(agent="edge", **stream)
        await module.run_pipeline(route, ("shm",), remote=remote, outputs=outputs, counts=counts)


# --- A heartbeat ----------------------------------------------------------------------------------------------


class ShapeTrace:
    """Shapes of a heartbeat, in the order in which they are met."""

    def __init__(self) -> None:
        self.shapes: dict[str, None] = {}
        self._messages = {message_type(HEARTBEAT), message_type(EVENT)}
        self._on = False

    def note(self, frame: FrameType, event: str, value: Any) -> None:
        """Take an event of the profiler."""
        path = file_of(frame.f_code) if event in {"call", "return"} else None
        if path is None or not path.startswith(("fleet/", "bus/")):
            return
        values = (
            [value] if event == "return" else [frame.f_locals[n] for n in arguments(frame.f_code)]
        )
        for item in values:
            many = isinstance(item, tuple | list) and not is_value(type(item))
            for part in item if many else (item,):
                self._meet(type(part))

    def _meet(self, class_: type[Any]) -> None:
        self._on |= class_ is message_type(HEARTBEAT)
        if self._on and (class_ in self._messages or is_value(class_)):
            self.shapes[class_.__name__] = None


def arguments(code: CodeType) -> tuple[str, ...]:
    """Return the names of a function's arguments."""
    return code.co_varnames[: code.co_argcount + code.co_kwonlyargcount]


def is_value(class_: type[Any]) -> bool:
    """Return whether a class of the fleet is a value, not something that keeps a state."""
    from sfglab.fleet.discovery.lifecycle import Asking, State, Told

    if not class_.__module__.startswith("sfglab.fleet") or class_ in {State, Told, Asking}:
        return False
    frozen = dataclasses.is_dataclass(class_) and class_.__dataclass_params__.frozen
    return bool(frozen or issubclass(class_, enum.Enum) or hasattr(class_, "_fields"))


async def trace_heartbeat(address: dict[str, Any]) -> None:
    """Let an agent beat and answer, and a discoverer announce it."""
    from sfglab.fleet.discovery.node import AgentDiscoverer, DiscoverySettings

    told = asyncio.Event()
    async with Node("agent", **address) as agent, Node("discoverer", **address) as node:
        agent.create_service(SERVICE, "/global/go2/get_metadata", lambda _: answer())
        publisher = agent.create_publisher(HEARTBEAT, "/global/agent_heartbeat", LATCHED)
        discoverer = AgentDiscoverer(
            node, DiscoverySettings(agent="station"), on_event=lambda _: told.set()
        )
        running = asyncio.create_task(discoverer.run())
        beat = default_message(HEARTBEAT)
        beat.agent, beat.incarnation, beat.period_s, beat.version = "go2", 1, 10.0, "1"
        publisher.publish(beat)
        async with asyncio.timeout(LIMIT_S):
            await told.wait()
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)


def answer() -> Any:
    """Return what the agent is."""
    metadata = default_message("sfglab_interfaces/msg/AgentMetadata")
    metadata.agent, metadata.incarnation = "go2", 1
    return service_type(SERVICE).response(success=True, message="", metadata=metadata)


def main() -> None:
    """Trace both and print what was counted."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--domain", type=int, default=91, help="the first of two DDS domains that nobody uses"
    )
    domain = parser.parse_args().domain
    remote, local = ({"domain_id": domain + i, "interface": "lo"} for i in range(2))
    frames, shapes = FrameTrace(), ShapeTrace()
    with traced(frames.note):
        asyncio.run(trace_frames(remote, local, frames))
    with traced(shapes.note):
        asyncio.run(trace_heartbeat(local))
    files = sorted(set.intersection(*frames.frames[FRAMES // 2 :]))
    print(f"a frame passes {len(files)} files:", *files, sep="\n  ")
    print(f"a heartbeat has {len(shapes.shapes)} shapes:", *shapes.shapes, sep="\n  ")


if __name__ == "__main__":
    main()

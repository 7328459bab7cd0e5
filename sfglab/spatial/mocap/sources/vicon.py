"""Captures from a Vicon Tracker, through `pyvicon-datastream`, which brings Vicon's DataStream SDK.

The library gives millimetres, quaternions as w, x, y, z, None for what is occluded, and the latency from the
cameras to its own hands in seconds; receipt less that latency is when the cameras saw it. It blocks until the
next frame, so it runs in a thread of its own. Installed only where it is needed, as it is compiled there.

Source: pyvicon_datastream/pyvicon_datastream.py of pyvicon-datastream 0.2; Vicon DataStream SDK 1.11 manual.
"""

from __future__ import annotations

import asyncio
import importlib
from concurrent.futures import ThreadPoolExecutor
from contextlib import aclosing, asynccontextmanager
from typing import TYPE_CHECKING, Any

from sfglab.spatial.mocap.capture import Capture, Lapse, MocapError
from sfglab.spatial.poses import Pose, PoseError

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator, AsyncIterator

    from sfglab.bus.api import Clock
    from sfglab.spatial.mocap.capture import Sight


_MODULE = "pyvicon_datastream"
_NO_FRAME_PAUSE_S = 0.002


class ViconError(MocapError, ConnectionError):
    """A Vicon Tracker that does not answer as it should."""


class ViconMissingError(MocapError, ImportError):
    """The library for Vicon is not installed."""

    def __init__(self) -> None:
        super().__init__(
            f"the Vicon source needs {_MODULE!r}, which is not installed: pip install pyvicon-datastream"
        )


class ViconSource:
    """Captures of all subjects that a Vicon Tracker has, each by its root segment.

    Objects are called ``subject/segment``, or ``subject`` where both have the same name.

    Args:
        host: The Tracker's address, as "192.168.10.1:801".
        clock: The node's clock, for the times of receipt.

    Raises:
        ViconMissingError: `pyvicon-datastream` is not installed; says how to install it.
    """

    def __init__(self, host: str, *, clock: Clock) -> None:
        try:
            self._library: Any = importlib.import_module(_MODULE)
        except ImportError as error:
            raise ViconMissingError from error
        self._host, self._clock = host, clock

    @asynccontextmanager
    async def captures(self) -> AsyncIterator[AsyncIterator[Capture]]:
        """Connect.

        Raises:
            ViconError: The Tracker does not answer, or refuses a setting; also later, when the connection ends.
        """
        client = self._library.PyViconDatastream()
        loop = asyncio.get_running_loop()
        with ThreadPoolExecutor(1, thread_name_prefix="vicon") as thread:
            try:
                await loop.run_in_executor(thread, self._connect, client)
                async with aclosing(self._frames(client, thread)) as captures:
                    yield captures
            finally:
                await loop.run_in_executor(thread, client.disconnect)

    def _connect(self, client: Any) -> None:
        library = self._library
        self._demand("connect", client.connect(self._host))
        self._demand("enable segment data", client.enable_segment_data())
        self._demand("set the stream mode", client.set_stream_mode(library.StreamMode.ServerPush))
        axes = (library.Direction.Forward, library.Direction.Left, library.Direction.Up)
        self._demand("set the axes", client.set_axis_mapping(*axes))

    def _demand(self, what: str, result: Any) -> None:
        if result != self._library.Result.Success:
            raise ViconError(f"Vicon Tracker at {self._host}: asked to {what}, it answered {result.name}")

    async def _frames(self, client: Any, thread: ThreadPoolExecutor) -> AsyncGenerator[Capture, None]:
        loop = asyncio.get_running_loop()
        while True:
            capture = await loop.run_in_executor(thread, self._frame, client)
            if capture is not None:
                yield capture
            else:
                await asyncio.sleep(_NO_FRAME_PAUSE_S)

    def _frame(self, client: Any) -> Capture | None:
        result = client.get_frame()
        receipt_ns = self._clock.now_ns()
        if result == self._library.Result.NoFrame:
            return None
        self._demand("send a frame", result)
        subjects = [client.get_subject_name(i) for i in range(client.get_subject_count())]
        sights = dict(self._sight(client, subject) for subject in subjects if subject is not None)
        latency_ns = round(client.get_latency_total() * 1e9)
        return Capture(
            number=int(client.get_frame_number()),
            capture_ns=receipt_ns - latency_ns,
            receipt_ns=receipt_ns,
            sights=sights,
        )

    @staticmethod
    def _sight(client: Any, subject: str) -> tuple[str, Sight]:
        segment = client.get_subject_root_segment_name(subject) or subject
        object_id = subject if segment == subject else f"{subject}/{segment}"
        position_mm = client.get_segment_global_translation(subject, segment)
        quat_wxyz = client.get_segment_global_quaternion(subject, segment)
        if position_mm is None or quat_wxyz is None:
            return object_id, Lapse.OCCLUDED
        w, x, y, z = quat_wxyz
        try:
            return object_id, Pose.at((v / 1000.0 for v in position_mm), (x, y, z, w), place=object_id)
        except PoseError:
            return object_id, Lapse.INVALID

"""The Rerun side: a canvas over a recording, and the places that a recording can go to.

Two timelines: `capture` is the sender's stamp, `received` this host's or the log's clock. Refuses to know
messages. What is on its way is bounded: a canvas waits when `WINDOW_BYTES` were drawn that no sink has taken.
"""

from __future__ import annotations

import socket
from contextlib import closing, suppress
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab.errors import MissingExtraError
from sfglab.view.errors import SettingError, SinkError, ViewError
from sfglab.view.sdk import rerun

if TYPE_CHECKING:
    from collections.abc import Sequence


NOTEBOOK = "notebook"
"""The place that is the running cell."""

CAPTURE, RECEIVED = "capture", "received"
"""The timelines."""

WINDOW_BYTES = 32 * 2**20
"""How much may be drawn before the sinks have to have taken it."""

_PLACES = "<path>.rrd, viewer, rerun+http://<host>:<port>/proxy, serve[[:<address>]:<port>], notebook"
_TAKE_LIMIT_S = 10.0
_NS_PER_S = 1_000_000_000
_IMAGE_BYTES = 128 * 1024
"""A batch of this size leaves at once: a picture does not wait for company."""


class RerunCanvas:
    """A recording to draw on, from one thread; made by `open_canvas`.

    Args:
        recording: A Rerun recording with its sinks.
        where: Its sinks, for messages.
    """

    def __init__(self, recording: Any, where: str) -> None:
        self._rerun = rerun()
        self._recording = recording
        self._where = where
        self._pending_bytes = 0
        self._now_ns = self._flushed_ns = 0
        self._frames: dict[str, str] = {}
        self._closed = False

    @property
    def recording(self) -> Any:
        """The ``rerun.RecordingStream``, for what only Rerun can do."""
        return self._recording

    @property
    def pending_bytes(self) -> int:
        """What was drawn since the sinks last had everything: of messages, as they arrived; below a window."""
        return self._pending_bytes

    def at(self, *, stamp_ns: int, received_ns: int) -> None:
        """Set the time of what is drawn next."""
        import numpy as np

        self._now_ns = received_ns
        self._recording.set_time(CAPTURE, timestamp=np.datetime64(stamp_ns, "ns"))
        self._recording.set_time(RECEIVED, timestamp=np.datetime64(received_ns, "ns"))

    def place(self, entity: str, frame: str) -> None:
        """Say in which coordinate frame an entity's geometry is given; said again only when it changes."""
        frame = frame.strip("/")  # a leading slash is what ROS 1 wrote
        if frame and self._frames.get(entity) != frame:
            self._frames[entity] = frame
            self.log(entity, self._rerun.CoordinateFrame(frame), static=True)

    def log(self, entity: str, *what: Any, static: bool = False) -> None:
        """Draw archetypes at an entity."""
        first, *more = what
        self._recording.log(entity, first, *more, static=static, strict=True)

    def show_blueprint(self, blueprint: Any) -> None:
        """Lay the viewer out."""
        self._recording.send_blueprint(blueprint)

    def show_in_notebook(self, *, width: int = 950, height: int = 600) -> None:
        """Show the recording below the running cell, and keep it up to date while the notebook's kernel lives.

        Args:
            width: Pixels.
            height: Pixels.

        Raises:
            MissingExtraError: The notebook's part of Rerun is not installed.
        """
        if find_spec("rerun_notebook") is None:
            raise MissingExtraError("rerun_notebook", extra="view", purpose="the view in a notebook")
        self._recording.notebook_show(width=width, height=height)

    def settle(self, size_bytes: int) -> None:
        """Wait until the sinks have taken everything, if much is on its way or the last time was a second ago.

        A viewer that is gone is so noticed within seconds, also when little is drawn.

        Raises:
            SinkError: They do not take it.
        """
        self._pending_bytes += size_bytes
        if self._pending_bytes >= WINDOW_BYTES or abs(self._now_ns - self._flushed_ns) >= _NS_PER_S:
            self.flush()

    def flush(self) -> None:
        """Wait until the sinks have taken everything.

        Raises:
            SinkError: They do not take it within ten seconds.
        """
        try:
            self._recording.flush(timeout_sec=_TAKE_LIMIT_S)
        except (RuntimeError, ValueError, OSError) as error:
            raise SinkError(f"{self._where} does not take what is shown: {error}") from error
        self._pending_bytes, self._flushed_ns = 0, self._now_ns

    def close(self) -> None:
        """Send what is left and disconnect; again is harmless."""
        if self._closed:
            return
        self._closed = True
        try:
            self.flush()
        finally:
            with suppress(RuntimeError):
                self._recording.disconnect()


def open_canvas(to: Sequence[str], *, title: str = "sfglab", memory: str = "25%") -> RerunCanvas:
    """Open a recording that goes to one or several places at once.

    Args:
        to: ``<path>.rrd`` for a file; ``viewer`` to start a viewer on this host; ``rerun+http://<host>:<port>/proxy``
            for one that runs; ``serve``, ``serve:<port>`` or ``serve:<address>:<port>`` to wait for viewers, on
            this host unless an address says otherwise; ``notebook`` for the cell that calls
            `RerunCanvas.show_in_notebook`.
        title: What the viewer calls it.
        memory: How much a viewer or server that is started here may keep, as a share of the host's memory or
            as ``4GB``; the oldest goes first.

    Raises:
        MissingExtraError: Rerun is not installed.
        SettingError: There is no such kind of place, or no place at all.
        SinkError: It cannot be opened.
    """
    sdk = rerun()
    if not to:
        raise SettingError("to", given=to, allowed="at least one place")
    if NOTEBOOK in to and len(to) > 1:
        raise SettingError("to", given=to, allowed="the notebook alone, or other places")
    config = sdk.ChunkBatcherConfig.LOW_LATENCY()
    config.flush_num_bytes = _IMAGE_BYTES
    recording = sdk.RecordingStream(title, batcher_config=config)
    sdk.set_log_time_enabled(False, recording=recording)
    sdk.set_log_tick_enabled(False, recording=recording)
    where = " and ".join(to)
    try:
        sinks = [sink for place in to if (sink := _sink(place, recording, memory)) is not None]
        if sinks:
            recording.set_sinks(*sinks)
    except ViewError:
        raise
    except (RuntimeError, ValueError, OSError) as error:
        raise SinkError(f"{where} cannot be opened: {error}") from error
    return RerunCanvas(recording, where)


def _sink(place: str, recording: Any, memory: str) -> Any:
    """Return a sink; None for the notebook, which takes the recording as it is."""
    sdk = rerun()
    kind, _, rest = place.partition(":")
    if place.endswith(".rrd"):
        return _file_sink(Path(place))
    if place == "viewer":
        recording.spawn(connect=False, memory_limit=memory)
        return sdk.GrpcSink()
    if kind.startswith("rerun"):
        return sdk.GrpcSink(place)
    if kind == "serve":
        return sdk.GrpcServerSink(*_bound(place, rest), server_memory_limit=memory)
    if place == NOTEBOOK:
        return None
    raise SettingError("to", given=place, allowed=_PLACES)


def _bound(place: str, rest: str) -> tuple[str, int]:
    """Return address and port to wait at; only this host is served unless another address is given."""
    address, _, port = rest.rpartition(":")
    if not (port or "9876").isdecimal():
        raise SettingError("to", given=place, allowed=_PLACES)
    bound = address or "127.0.0.1", int(port or 9876)
    with closing(socket.socket()) as probe:  # the server itself would tell only its log
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        probe.bind(bound)
    return bound


def _file_sink(path: Path) -> Any:
    if not path.parent.is_dir():
        raise SinkError(f"{path} cannot be opened: there is no directory {path.parent}")
    return rerun().FileSink(path)

"""Canvas over a Rerun recording, its outputs, and the layout of the viewer.

Only this module imports Rerun. A recording has two timelines: `capture` is the stamp of the sender, `received`
the clock of this host or of the log. A canvas waits when `WINDOW_BYTES` were drawn that no output has taken.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError, MissingExtraError, SfglabError
from sfglab.fleet.status.heartbeat import AGENT_HEARTBEAT
from sfglab.units import NS_PER_S
from sfglab.view.visualizer import AGENTS, SinkError, camera_name, entity_of_topic

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from sfglab.fleet.fleet_file import Fleet
    from sfglab.view.cell import CellViewer


def rerun() -> Any:
    """Return the Rerun SDK.

    Raises:
        MissingExtraError: Rerun is not installed.
    """
    try:
        import rerun
    except ImportError as error:
        raise MissingExtraError("rerun", extra="view", purpose="the view") from error
    return rerun


class _Rerun:
    """The Rerun SDK, which is imported at the first access to an attribute."""

    def __getattr__(self, name: str) -> Any:
        return getattr(rerun(), name)


rr: Any = _Rerun()


CAPTURE, RECEIVED = "capture", "received"  #: The timelines.

WINDOW_BYTES = 32 * 2**20  #: Bytes that may be drawn before the outputs have taken them.

_PLACES = "FILE.rrd, viewer"
_MEMORY = "25%"  #: Share of the memory above which a viewer removes its oldest data.
_TAKE_LIMIT_S = 10.0
#: Size of a batch that is sent at once, bytes, so that an image does not wait for further data.
_IMAGE_BYTES = 128 * 1024


class RerunCanvas:
    """A recording to draw on, from one thread; made by `open_canvas`."""

    def __init__(self, recording: Any, to: Sequence[str]) -> None:
        #: Rerun's recording, for functions that the canvas does not have.
        self.recording = recording
        self._to = to
        self._pending_bytes = 0  # of the messages that were drawn since the last flush
        self._now_ns = self._flushed_ns = 0
        self._frames: dict[str, str] = {}
        self._closed = False

    def at(self, *, stamp_ns: int, received_ns: int) -> None:
        """Set the capture time and the reception time, ns, of everything drawn next."""
        import numpy as np

        self._now_ns = received_ns
        self.recording.set_time(CAPTURE, timestamp=np.datetime64(stamp_ns, "ns"))
        self.recording.set_time(RECEIVED, timestamp=np.datetime64(received_ns, "ns"))

    def place(self, entity: str, frame: str) -> None:
        """Set the coordinate frame of an entity's geometry; only a change of the frame is logged."""
        frame = frame.strip("/")  # a leading slash is what ROS 1 wrote
        if frame and self._frames.get(entity) != frame:
            self._frames[entity] = frame
            self.log(entity, rr.CoordinateFrame(frame), static=True)

    def log(self, entity: str, *what: Any, static: bool = False) -> None:
        """Draw Rerun archetypes at an entity; see `Canvas.log`."""
        first, *more = what
        self.recording.log(entity, first, *more, static=static, strict=True)

    def settle(self, size_bytes: int) -> None:
        """Wait for the outputs if `WINDOW_BYTES` are in flight, and once per second, to detect a closed output.

        Args:
            size_bytes: Size of the last update, bytes.

        Raises:
            SinkError: An output no longer accepts data.
        """
        self._pending_bytes += size_bytes
        if self._pending_bytes >= WINDOW_BYTES or abs(self._now_ns - self._flushed_ns) >= NS_PER_S:
            self.flush()

    def flush(self) -> None:
        """Wait until the outputs have accepted everything.

        Raises:
            SinkError: An output no longer accepts data, or takes more than ten seconds.
        """
        try:
            self.recording.flush(timeout_sec=_TAKE_LIMIT_S)
        except (RuntimeError, ValueError, OSError) as error:
            raise SinkError(
                f"{' and '.join(self._to)} does not accept data any more: {error}"
            ) from error
        self._pending_bytes, self._flushed_ns = 0, self._now_ns

    def close(self) -> None:
        """Send the remaining data and disconnect; further calls have no effect."""
        if self._closed:
            return
        self._closed = True
        try:
            self.flush()
        except SinkError:
            _discard(self._to)
            raise
        finally:
            with suppress(RuntimeError):
                self.recording.disconnect()


def new_recording(title: str) -> Any:
    """Return a recording of Rerun that sends small batches at once, and has only the two timelines of this module."""
    config = rr.ChunkBatcherConfig.LOW_LATENCY()
    config.flush_num_bytes = _IMAGE_BYTES
    recording = rr.RecordingStream(title, batcher_config=config)
    rr.set_log_time_enabled(False, recording=recording)
    rr.set_log_tick_enabled(False, recording=recording)
    return recording


def open_canvas(to: Sequence[str], *, title: str = "sfglab") -> RerunCanvas:
    """Open a recording with one or several outputs.

    Args:
        to: ``FILE.rrd`` for a file; ``viewer`` for a viewer that is started on this host.
        title: Title in the viewer.

    Raises:
        MissingExtraError: Rerun is not installed.
        InvalidValueError: There is no such kind of output, or none is given.
        SinkError: An output cannot be opened.
    """
    if not to:
        raise InvalidValueError("--to", to, "at least one of FILE.rrd, viewer")
    recording = new_recording(title)
    try:
        recording.set_sinks(*(_sink(place, recording) for place in to))
    except SfglabError:
        raise
    except (RuntimeError, ValueError, OSError) as error:
        _discard(to, emptied=True)
        cause = str(error).partition("\n")[0].removesuffix(".")
        raise SinkError(
            f"{' and '.join(to)} cannot be opened ({cause}); give --to FILE.rrd instead"
        ) from error
    return RerunCanvas(recording, to)


def cell_canvas(title: str) -> tuple[RerunCanvas, CellViewer]:
    """Return a canvas, and the viewer that shows it in a cell of a notebook while the kernel runs.

    Raises:
        MissingExtraError: Rerun, or its part for notebooks, is not installed.
    """
    from sfglab.view.cell import CellViewer

    recording, viewer = new_recording(title), CellViewer()
    rr.bindings.set_callback_sink(recording=recording.to_native(), callback=viewer.send)
    return RerunCanvas(recording, ["the cell"]), viewer


def _sink(place: str, recording: Any) -> Any:
    if place.endswith(".rrd"):
        path = Path(place)
        if not path.parent.is_dir():
            raise SinkError(
                f"{path} cannot be opened, because there is no folder {path.parent}; create it first"
            )
        return rr.FileSink(path)
    if place == "viewer":
        recording.spawn(connect=False, memory_limit=_MEMORY)
        return rr.GrpcSink()
    raise InvalidValueError("--to", place, _PLACES)


def _discard(to: Sequence[str], *, emptied: bool = False) -> None:
    """Remove incomplete files; with `emptied` only empty ones."""
    for path in (Path(place) for place in to if place.endswith(".rrd")):
        if path.is_file() and not (emptied and path.stat().st_size):
            path.unlink()


_PICTURES = (
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket",
    "foxglove_msgs/msg/CompressedVideo",
)
_CAMERA_INFO = "sensor_msgs/msg/CameraInfo"


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """Description of the viewer's views."""

    frame: str = ""  #: The frame in which space is drawn; empty leaves the choice to the viewer.
    #: Entity of each camera's view, by title.
    cameras: Mapping[str, str] = field(default_factory=dict)
    #: Entities of images without a CameraInfo, which the 3D view cannot show.
    flat: tuple[str, ...] = ()
    heartbeats: bool = False  #: Whether the age of heartbeats and the agents' states are shown.


def layout_of_fleet(fleet: Fleet, *, frame: str = "map") -> Layout:
    """Return the layout of a fleet in a frame, with one view per image stream that its agents announce."""
    cameras = {
        f"{agent.name} {sensor.name} {stream.codec}": entity_of_topic(stream.topic)
        for agent in fleet.agents
        for sensor in agent.sensors
        for stream in sensor.streams
    }
    return Layout(frame=frame, cameras=cameras, heartbeats=True)


def layout_of_topics(topics: Mapping[str, str], *, frame: str = "") -> Layout:
    """Return the layout in a frame for topics without a fleet file, given the ROS type by topic."""
    pictures = sorted(topic for topic, type_name in topics.items() if type_name in _PICTURES)
    cameras = {topic: entity_of_topic(topic) for topic in pictures}
    placed = {camera_name(topic) for topic, kind in topics.items() if kind == _CAMERA_INFO}
    flat = tuple(cameras[topic] for topic in pictures if camera_name(topic) not in placed)
    heartbeats = AGENT_HEARTBEAT in topics.values()
    return Layout(frame=frame, cameras=cameras, flat=flat, heartbeats=heartbeats)


def blueprint(layout: Layout) -> Any:
    """Return Rerun's blueprint of a layout.

    Raises:
        MissingExtraError: Rerun is not installed.
    """
    rerun()
    import rerun.blueprint as rrb

    space = rrb.Spatial3DView(
        origin="/", contents=_contents(layout), name="space", **_space(layout.frame)
    )
    views: list[Any] = [space]
    if layout.cameras:
        cameras = (
            rrb.Spatial2DView(origin=entity, contents=entity, name=name)  # no points
            for name, entity in layout.cameras.items()
        )
        views.append(rrb.Grid(*cameras, name="cameras"))
    upper = rrb.Horizontal(*views, column_shares=[3, 2][: len(views)])
    parts: Any = upper
    if layout.heartbeats:
        parts = rrb.Vertical(upper, rrb.Horizontal(*_heartbeats()), row_shares=[2, 1])
    return rrb.Blueprint(parts, rrb.TimePanel(timeline="received"), collapse_panels=False)


def _contents(layout: Layout) -> list[str]:
    """Return the contents of the 3D view: all entities except images without a place, and depth images.

    The 3D view shows depth images as points.
    """
    rules = ["/**", *(f"- {entity}" for entity in layout.flat)]
    for entity in layout.cameras.values():
        if "depth" in entity:
            rules += [f"- {entity}", f"+ {entity}/cloud"]
    return rules


def _space(frame: str) -> dict[str, Any]:
    """Return the camera of the 3D view: obliquely from above for a known frame, otherwise the viewer's default."""
    import rerun.blueprint as rrb

    if not frame:
        return {}
    eye = rrb.EyeControls3D(
        position=(-5.0, -5.0, 4.0), look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0)
    )
    return {
        "spatial_information": rrb.SpatialInformation(frame, show_axes=True),
        "eye_controls": eye,
    }


def _heartbeats() -> list[Any]:
    """Return the views of the age of heartbeats and of the agents' states."""
    import rerun.blueprint as rrb

    above = rrb.PlotLegend(rrb.Corner2D.LeftTop)  # growing ages would cover a legend on the right
    everything = f"{AGENTS}/**"
    ages = rrb.TimeSeriesView(
        origin=AGENTS, contents=everything, name="age of heartbeats (s)", plot_legend=above
    )
    return [ages, rrb.StateTimelineView(origin=AGENTS, contents=everything, name="agents")]

"""The viewer's layout for a fleet, made from its file: space, every camera, heartbeats, who hears whom.

`Layout` is a value and pure; `blueprint` turns it into Rerun's.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.fleet.status.heartbeat import AGENT_HEARTBEAT
from sfglab.view.entities import AGENTS, agent_root, entity_of_topic
from sfglab.view.sdk import rerun

if TYPE_CHECKING:
    from collections.abc import Mapping

    from sfglab.fleet.fleet_file import Fleet


_PICTURES = (
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/CompressedImage",
    "ffmpeg_image_transport_msgs/msg/FFMPEGPacket",
    "foxglove_msgs/msg/CompressedVideo",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A view of one stream of pictures."""

    name: str  #: For people.
    entity: str  #: What it shows.


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """What a viewer shows side by side."""

    frame: str = ""  #: The frame in which space is drawn; empty leaves the choice to the viewer.
    agents: tuple[str, ...] = ()  #: Whose heartbeats and states are drawn.
    cameras: tuple[Camera, ...] = ()  #: One view each.
    #: Whether heartbeats and states are drawn; without `agents` those of all that turn up.
    communication: bool = False


def layout_of_fleet(fleet: Fleet, *, frame: str = "map") -> Layout:
    """Return the layout of a fleet: a view for every stream that its agents announce.

    Args:
        fleet: As the fleet file has it.
        frame: The frame in which space is drawn.
    """
    cameras = [
        Camera(name=f"{agent.name} {sensor.name} {stream.codec}", entity=entity_of_topic(stream.topic))
        for agent in fleet.agents
        for sensor in agent.sensors
        for stream in sensor.streams
    ]
    agents = tuple(agent.name for agent in fleet.agents)
    return Layout(frame=frame, agents=agents, cameras=tuple(cameras), communication=True)


def layout_of_topics(topics: Mapping[str, str], *, frame: str = "") -> Layout:
    """Return a layout for topics alone.

    Args:
        topics: Type by topic.
        frame: The frame in which space is drawn.
    """
    pictures = sorted(topic for topic, type_name in topics.items() if type_name in _PICTURES)
    cameras = tuple(Camera(name=topic, entity=entity_of_topic(topic)) for topic in pictures)
    return Layout(frame=frame, cameras=cameras, communication=AGENT_HEARTBEAT in topics.values())


def blueprint(layout: Layout) -> Any:
    """Return Rerun's blueprint of a layout.

    Raises:
        MissingExtraError: Rerun is not installed.
    """
    rerun()
    import rerun.blueprint as rrb

    views: list[Any] = [
        rrb.Spatial3DView(origin="/", contents=_contents(layout), name="space", **_space(layout.frame))
    ]
    if layout.cameras:
        cameras = (
            rrb.Spatial2DView(origin=c.entity, contents=c.entity, name=c.name)
            for c in layout.cameras  # no points
        )
        views.append(rrb.Grid(*cameras, name="cameras"))
    upper = rrb.Horizontal(*views, column_shares=[3, 2][: len(views)])
    lower = _communication(layout.agents) if layout.communication else []
    parts = rrb.Vertical(upper, rrb.Horizontal(*lower), row_shares=[2, 1]) if lower else upper
    return rrb.Blueprint(parts, rrb.TimePanel(timeline="received"), collapse_panels=False)


def _contents(layout: Layout) -> list[str]:
    """Return what space holds: everything but pictures of depth, whose points it holds already, coloured."""
    depths = [camera.entity for camera in layout.cameras if "depth" in camera.entity]
    return ["/**", *(rule for depth in depths for rule in (f"- {depth}", f"+ {depth}/cloud"))]


def _space(frame: str) -> dict[str, Any]:
    """Return how space is looked at: from above one side of a known frame, else as the viewer likes."""
    import rerun.blueprint as rrb

    if not frame:
        return {}
    eye = rrb.EyeControls3D(position=(-5.0, -5.0, 4.0), look_target=(0.0, 0.0, 0.0), eye_up=(0.0, 0.0, 1.0))
    return {"spatial_information": rrb.SpatialInformation(frame, show_axes=True), "eye_controls": eye}


def _communication(agents: tuple[str, ...]) -> list[Any]:
    import rerun.blueprint as rrb

    roots = [f"{agent_root(agent)}/communication" for agent in agents]
    everything = [f"{AGENTS}/**"]
    ages = [f"{root}/heartbeat_age_s" for root in roots] or everything
    bands = [f"{root}/{what}" for root in roots for what in ("life", "decoders")] or everything
    drops = [f"{root}/{what}" for root in roots for what in ("dropped", "lost")] or everything
    return [
        rrb.Tabs(
            rrb.TimeSeriesView(origin=AGENTS, contents=ages, name="heartbeat age (s)"),
            rrb.TimeSeriesView(origin=AGENTS, contents=drops, name="dropped and lost"),
        ),
        rrb.StateTimelineView(origin=AGENTS, contents=bands, name="life and decoders"),
        rrb.GraphView(origin="/fleet/border", name="what crosses the border"),
    ]

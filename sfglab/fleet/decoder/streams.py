"""From what a remote agent says about its streams to the local topics that can be wanted.

A compressed stream ``/global/<agent>/<component>/<stream>/<resource>`` is offered on this device as
``/local/<agent>/<component>/<stream>/image_raw``, its camera info under the same name in the local scope
(paper A, section 4.3: "decoded or relayed topic"). Pure.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.fleet.gop_cache import FFMPEG_PACKET, replay_topic
from sfglab.names import FqnError, Resource, RosFqn, Scope, parse

if TYPE_CHECKING:
    from collections.abc import Iterable


CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
RELAY = "relay"
"""Codec hint of a stream whose messages pass on as they are."""

_TYPES = {
    Resource.FFMPEG: (FFMPEG_PACKET, "h264"),
    Resource.COMPRESSED_DEPTH: ("sensor_msgs/msg/CompressedImage", "rvl"),
    Resource.COMPRESSED: ("sensor_msgs/msg/CompressedImage", ""),
}


class StreamError(SfglabError, ValueError):
    """A stream that cannot be offered locally.

    Attributes:
        topic: The remote topic.
    """

    def __init__(self, topic: str, why: str) -> None:
        self.topic = topic
        super().__init__(f"stream {topic!r}: {why}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Route:
    """One remote topic and the local topic that offers it."""

    agent: str  #: The remote agent.
    source_topic: str  #: The remote topic.
    source_type: str  #: Its ROS type.
    codec: str  #: Codec hint, or `RELAY` for messages that pass unchanged.
    local_topic: str  #: The local topic.
    replay_topic: str = ""  #: Where its sender may replay the last group of pictures; empty: nowhere.


def routes_of_topic(topic: str) -> tuple[Route, Route]:
    """Return the routes of a stream of which only the schema's name is known: its image and camera info.

    Raises:
        StreamError: The name is no compressed image stream of a remote agent.
    """
    fqn = _remote_stream(topic)
    if fqn.resource not in _TYPES:
        allowed = ", ".join(sorted(resource.value for resource in _TYPES))
        raise StreamError(topic, f"its type does not follow from its name; known are the resources {allowed}")
    type_, codec = _TYPES[fqn.resource]
    image = Route(
        agent=str(fqn.agent),
        source_topic=topic,
        source_type=type_,
        codec=codec,
        local_topic=_local_image(fqn),
        replay_topic=_replay(topic, type_),
    )
    return image, _camera_info(image, str(replace(fqn, resource=Resource.CAMERA_INFO)))


def routes_of_agent(metadata: Any) -> tuple[tuple[Route, ...], tuple[StreamError, ...]]:
    """Return the routes of all streams that an agent's metadata lists, and what is wrong with the others.

    Args:
        metadata: A ``sfglab_interfaces/msg/AgentMetadata``.
    """
    routes: list[Route] = []
    errors: list[StreamError] = []
    for stream in (s for sensor in metadata.sensors for s in sensor.streams):
        try:
            routes += _routes_of_stream(metadata.agent, stream)
        except StreamError as error:
            errors.append(error)
    return tuple(routes), tuple(errors)


def _routes_of_stream(agent: str, stream: Any) -> Iterable[Route]:
    fqn = _remote_stream(stream.topic)
    if fqn.agent != agent:
        raise StreamError(stream.topic, f"agent {agent!r} lists it, but it bears another agent's name")
    image = Route(
        agent=agent,
        source_topic=stream.topic,
        source_type=stream.type,
        codec=stream.codec,
        local_topic=stream.decoded_topic or _local_image(fqn),
        replay_topic=_replay(stream.topic, stream.type),
    )
    yield image
    if stream.camera_info_topic:
        yield _camera_info(image, stream.camera_info_topic)


def _camera_info(image: Route, topic: str) -> Route:
    return Route(
        agent=image.agent,
        source_topic=topic,
        source_type=CAMERA_INFO,
        codec=RELAY,
        local_topic=str(replace(_remote_stream(topic), scope=Scope.LOCAL)),
    )


def _replay(topic: str, type_: str) -> str:
    return (replay_topic(topic) or "") if type_ == FFMPEG_PACKET else ""


def _remote_stream(topic: str) -> RosFqn:
    """Read a remote topic: a global name with an agent and a component."""
    try:
        fqn = parse(topic)
    except FqnError as error:
        raise StreamError(topic, str(error)) from error
    if not fqn.is_global or fqn.component is None:
        raise StreamError(topic, "needed is a name in the global scope with an agent and a component")
    return fqn


def _local_image(fqn: RosFqn) -> str:
    return str(replace(fqn, scope=Scope.LOCAL, resource=Resource.IMAGE_RAW))

"""Streams that can be decoded on this device, and the life cycle of a pipeline as a table.

A compressed stream ``/global/<agent>/<component>/<stream>/<resource>`` is offered on this device as
``/local/<agent>/<component>/<stream>/image_raw``, its camera info under the same name in the local scope
(paper A, section 4.3: "decoded or relayed topic"). A pipeline starts with the first local subscription and
ends after the last one (Fig. 4); the recovery from a crash is ours. The module is pure: the caller passes
`now_ns` and executes the actions.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum, auto
from typing import TYPE_CHECKING, Any

from sfglab.codecs.errors import MAX_PIXELS
from sfglab.errors import SfglabError
from sfglab.fleet.discovery.validation import validated_metadata
from sfglab.fleet.gop_config import FFMPEG_PACKET, replay_topic
from sfglab.machine import ProcessLife, ProcessTiming, transitions
from sfglab.names import FqnError, Resource, RosFqn, Scope, Suffixed, parse

if TYPE_CHECKING:
    from collections.abc import Iterable


CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
IMAGE_TYPE = "sensor_msgs/msg/Image"
_EDGE_PIXELS = 64  # the largest coding block of H.265
RELAY = "relay"  #: Codec hint of a stream whose messages are relayed unchanged.


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamKind:
    """Kind of compressed stream, by the resource in its name."""

    source_type: str  #: ROS type of the compressed messages.
    codec: str = ""  #: Codec hint; empty if only the messages name their codec.
    #: ROS type of the decoded messages; `sfglab.fleet.decoder.pipeline.CODECS` has its codec.
    decoded_type: str = IMAGE_TYPE
    decoded_resource: Resource = Resource.IMAGE_RAW  #: Resource in the name of the decoded topic.


KINDS = {
    Resource.FFMPEG: StreamKind(source_type=FFMPEG_PACKET, codec="h264"),
    Resource.COMPRESSED_DEPTH: StreamKind(
        source_type="sensor_msgs/msg/CompressedImage", codec="rvl"
    ),
    Resource.COMPRESSED: StreamKind(source_type="sensor_msgs/msg/CompressedImage"),
}
"""Kinds of streams that are decoded."""


class StreamError(SfglabError, ValueError):
    """A stream that cannot be decoded or relayed on this device."""

    def __init__(self, topic: str, why: str) -> None:
        self.topic = topic  #: Name of the remote topic.
        super().__init__(f"stream {topic!r}: {why}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Route:
    """One remote topic and the local topic that offers it."""

    agent: str  #: Name of the remote agent.
    source_topic: str  #: Name of the remote topic.
    source_type: str  #: ROS type of the remote topic.
    codec: str  #: Codec hint, or `RELAY` for messages that are relayed unchanged.
    local_topic: str  #: Name of the local topic.
    decoded_type: str = IMAGE_TYPE  #: ROS type of the decoded messages.
    #: Topic on which the stream's sender may replay the last group of pictures; empty for none.
    replay_topic: str = ""
    #: Maximum number of pixels of a frame, with what codecs add at the edges.
    most_pixels: int = MAX_PIXELS
    #: Number of the newest frame of an earlier pipeline that subscribers may have seen; -1 for none.
    after: int = -1

    @property
    def local_type(self) -> str:
        """ROS type of the local topic."""
        return self.source_type if self.codec == RELAY else self.decoded_type


def routes_of_topic(topic: str) -> tuple[Route, Route]:
    """Return the routes of a stream, its image and its camera info, from its name in the schema alone.

    Raises:
        StreamError: The name is no compressed image stream of a remote agent.
    """
    fqn = _remote_stream(topic)
    kind = KINDS.get(fqn.resource) if isinstance(fqn.resource, Resource) else None
    if kind is None:
        allowed = ", ".join(sorted(resource.value for resource in KINDS))
        raise StreamError(
            topic, f"its type does not follow from its name; allowed as its last part: {allowed}"
        )
    decoded = _decoded(fqn, topic, kind)
    return decoded, _camera_info(decoded, str(replace(fqn, resource=Resource.CAMERA_INFO)))


def routes_of_agent(metadata: Any) -> tuple[tuple[Route, ...], tuple[SfglabError, ...]]:
    """Return the routes of all streams in an ``AgentMetadata``, and an error for each other stream."""
    metadata, refused = validated_metadata(metadata)
    routes: dict[str, Route] = {}
    errors: list[SfglabError] = list(refused)
    for stream in (s for sensor in metadata.sensors for s in sensor.streams):
        try:
            for route in _routes_of_stream(stream):
                _take(route, routes)
        except StreamError as error:
            errors.append(error)
    return tuple(routes.values()), tuple(errors)


def _take(route: Route, routes: dict[str, Route]) -> None:
    if routes.setdefault(route.local_topic, route) != route:
        raise StreamError(
            route.source_topic,
            f"another stream is already decoded to {route.local_topic}; leave one out",
        )


def _routes_of_stream(stream: Any) -> Iterable[Route]:
    fqn = _remote_stream(stream.topic)
    resource = fqn.resource.base if isinstance(fqn.resource, Suffixed) else fqn.resource
    named = KINDS[resource] if resource in KINDS else StreamKind(source_type=stream.type)
    kind = replace(named, source_type=stream.type, codec=stream.codec or named.codec)
    decoded = _decoded(fqn, stream.topic, kind, stream.decoded_topic)
    if stream.width and stream.height:
        most = (stream.width + _EDGE_PIXELS) * (stream.height + _EDGE_PIXELS)
        decoded = replace(decoded, most_pixels=min(most, MAX_PIXELS))
    yield decoded
    if stream.camera_info_topic:
        yield _camera_info(decoded, stream.camera_info_topic)


def _camera_info(stream: Route, topic: str) -> Route:
    local = str(replace(_remote_stream(topic), scope=Scope.LOCAL))
    return Route(
        agent=stream.agent,
        source_topic=topic,
        source_type=CAMERA_INFO,
        codec=RELAY,
        local_topic=local,
    )


def _decoded(fqn: RosFqn, topic: str, kind: StreamKind, local: str = "") -> Route:
    replay = replay_topic(topic) if kind.source_type == FFMPEG_PACKET else None
    local = local or str(replace(fqn, scope=Scope.LOCAL, resource=kind.decoded_resource))
    return Route(
        agent=str(fqn.agent),
        source_topic=topic,
        source_type=kind.source_type,
        codec=kind.codec,
        local_topic=local,
        decoded_type=kind.decoded_type,
        replay_topic=replay or "",
    )


def _remote_stream(topic: str) -> RosFqn:
    """Read a remote topic: a global name with an agent and a component."""
    try:
        fqn = parse(topic)
    except FqnError as error:
        raise StreamError(topic, str(error)) from error
    if not fqn.is_global or fqn.component is None:
        raise StreamError(
            topic,
            "allowed: a global name with agent and component, as in /global/go2/camera_front/color/ffmpeg",
        )
    return fqn


class State(Enum):
    """State of a pipeline."""

    IDLE = auto()  #: The stream is known and has no subscriber; nothing runs.
    STARTING = auto()  #: A pipeline was started and has not reported yet.
    RUNNING = auto()  #: The pipeline runs.
    #: The last subscriber has just left; the pipeline is kept in case one returns.
    LINGERING = auto()
    STOPPING = auto()  #: The pipeline was told to end.
    RESTARTING = auto()  #: The pipeline was told to end, and is needed again.
    BACKING_OFF = auto()  #: The pipeline crashed while it was needed; the next start waits.
    LEAVING = auto()  #: The stream was withdrawn; the pipeline was told to end.
    GONE = auto()  #: The stream was withdrawn and nothing runs.


class Input(Enum):
    """Input of the life cycle: an event of a pipeline."""

    WANTED = auto()  #: The first local subscriber appeared.
    UNWANTED = auto()  #: The last local subscriber left.
    STARTED = auto()  #: The pipeline reports that it runs.
    ENDED = auto()  #: The pipeline is gone, as told or after a crash.
    TIMER = auto()  #: The armed timer ran out.
    WITHDRAWN = auto()  #: The remote agent or its stream is no longer known.


class Action(Enum):
    """Action that the caller executes after a transition."""

    START = auto()  #: Start the pipeline and arm the start timer.
    STOP = auto()  #: Tell the pipeline to end and arm the stop timer.
    KILL = auto()  #: End the pipeline by force, because it did not end when told to.
    LINGER = auto()  #: Arm the linger timer.
    BACK_OFF = auto()  #: Arm the back-off timer.
    CANCEL_TIMER = auto()  #: Disarm the timer.


TRANSITIONS = transitions(
    State,
    Input,
    Action,
    """
    IDLE         WANTED     STARTING     START
    IDLE         UNWANTED   IDLE
    IDLE         WITHDRAWN  GONE

    STARTING     STARTED    RUNNING      CANCEL_TIMER
    STARTING     UNWANTED   STOPPING     STOP
    STARTING     ENDED      BACKING_OFF  BACK_OFF
    STARTING     TIMER      RESTARTING   STOP
    STARTING     WITHDRAWN  LEAVING      STOP

    RUNNING      UNWANTED   LINGERING    LINGER
    RUNNING      ENDED      BACKING_OFF  BACK_OFF
    RUNNING      WITHDRAWN  LEAVING      STOP

    LINGERING    WANTED     RUNNING      CANCEL_TIMER
    LINGERING    TIMER      STOPPING     STOP
    LINGERING    ENDED      IDLE         CANCEL_TIMER
    LINGERING    WITHDRAWN  LEAVING      STOP

    STOPPING     WANTED     RESTARTING
    STOPPING     STARTED    STOPPING
    STOPPING     ENDED      IDLE         CANCEL_TIMER
    STOPPING     TIMER      STOPPING     KILL
    STOPPING     WITHDRAWN  LEAVING

    RESTARTING   UNWANTED   STOPPING
    RESTARTING   STARTED    RESTARTING
    RESTARTING   ENDED      STARTING     START
    RESTARTING   TIMER      RESTARTING   KILL
    RESTARTING   WITHDRAWN  LEAVING

    BACKING_OFF  TIMER      STARTING     START
    BACKING_OFF  UNWANTED   IDLE         CANCEL_TIMER
    BACKING_OFF  WITHDRAWN  GONE         CANCEL_TIMER

    LEAVING      STARTED    LEAVING
    LEAVING      WANTED     LEAVING
    LEAVING      UNWANTED   LEAVING
    LEAVING      ENDED      GONE         CANCEL_TIMER
    LEAVING      TIMER      LEAVING      KILL
    """,
)
"""State, input, next state, and the action; all other inputs are illegal and change nothing.

A pipeline that reports between the order to end and its end changes nothing.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing(ProcessTiming):
    """Time limits and delays of a pipeline, ns."""

    start_ns: int = 10_000_000_000
    stop_ns: int = 2_000_000_000
    backoff_ns: int = 100_000_000
    backoff_max_ns: int = 5_000_000_000
    #: Time that a pipeline is kept after its last subscriber left, ns.
    linger_ns: int = 1_000_000_000


class Lifecycle(ProcessLife[State, Input, Action]):
    """State, timer and number of crashes of one pipeline."""

    READY = Input.STARTED
    BACK_OFF = Action.BACK_OFF

    def __init__(self, timing: Timing) -> None:
        waits_ns = {
            Action.START: timing.start_ns,
            Action.STOP: timing.stop_ns,
            Action.LINGER: timing.linger_ns,
        }
        super().__init__("pipeline", TRANSITIONS, State.IDLE, waits_ns=waits_ns, timing=timing)

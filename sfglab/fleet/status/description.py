"""Description of an agent: sensors with their streams, accelerators and software, as frozen values.

The module checks which names and values an agent's description may contain, converts descriptions to messages,
and detects the accelerators and the software.
"""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from typing import Any

from sfglab import __version__
from sfglab.errors import SfglabError
from sfglab.fleet.status.heartbeat import AGENT_METADATA
from sfglab.names import FqnError, Scope, parse, validate_ros_name

#: Allowed codecs of a stream; empty: not stated.
CODECS = ("", "h264", "hevc", "jpeg", "png", "rvl")
MAX_EDGE = 16_384  #: Largest width and height of a stream's images, pixels.
MAX_RATE_HZ = 10_000.0  #: Highest rate of a stream, messages per second.
MAX_TEXT = 255  #: Longest name or line of text, characters.
_TYPE = re.compile(r"[A-Za-z]\w*/msg/[A-Za-z]\w*", re.ASCII)


class DescriptionError(SfglabError, ValueError):
    """An agent's description has an invalid part; the error names the part, the value and the allowed values."""

    def __init__(self, place: str, why: str) -> None:
        self.place = place  #: The invalid part.
        super().__init__(f"agent description, {place}: {why}")


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamDescription:
    """Stream of a sensor in the global scope; see ``StreamInfo.msg``."""

    topic: str  #: Global topic of the stream.
    type: str  #: ROS type of its messages.
    codec: str  #: ``h264``, ``rvl``, ``png`` or ``jpeg``.
    decoded_topic: str = ""  #: Local topic of the decoded stream; empty: derived from `topic`.
    camera_info_topic: str = ""  #: Global topic of the calibration; empty: there is none.
    width: int = 0  #: Width of the images, pixels.
    height: int = 0  #: Height of the images, pixels.
    rate_hz: float = 0.0  #: Nominal rate, messages per second.

    @classmethod
    def of(cls, stream: Any) -> StreamDescription:
        """Return the values of a ``StreamInfo``, or of an object with its fields, without a check."""
        return cls(**{name: getattr(stream, name) for name in cls.__dataclass_fields__})

    def check(self, agent: str) -> None:
        """Check the description of a stream of an agent.

        Raises:
            DescriptionError: A topic is not a name of this agent in its scope, or type, codec, size or rate
                are not allowed.
        """
        for topic in filter(None, (self.topic, self.camera_info_topic)):
            _check_topic(topic, agent)
        place = f"stream {_short(self.topic)}"
        if self.decoded_topic:
            _check_local(place, self.decoded_topic, agent)
        is_type = _TYPE.fullmatch(self.type) is not None and len(self.type) <= MAX_TEXT
        parts = (
            (is_type, f"type {_short(self.type)}", "names of messages"),
            (self.codec in CODECS, f"codec {_short(self.codec)}", ", ".join(CODECS[1:])),
            (0 <= self.width <= MAX_EDGE, f"width {self.width}", f"up to {MAX_EDGE} pixels"),
            (0 <= self.height <= MAX_EDGE, f"height {self.height}", f"up to {MAX_EDGE} pixels"),
            (0 <= self.rate_hz <= MAX_RATE_HZ, f"rate {self.rate_hz}", f"up to {MAX_RATE_HZ:g} Hz"),
        )
        for is_allowed, given, allowed in parts:
            if not is_allowed:
                raise DescriptionError(place, f"given the {given}, allowed: {allowed}")

    def to_message(self) -> Any:
        """Return the stream as a ``sfglab_interfaces/msg/StreamInfo``."""
        from sfglab.messages import message_type

        return message_type("sfglab_interfaces/msg/StreamInfo")(**asdict(self))


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorDescription:
    """Sensor of an agent; see ``SensorInfo.msg``."""

    name: str  #: Name, unique within its agent.
    model: str = ""  #: Manufacturer and model.
    streams: tuple[StreamDescription, ...] = ()  #: Streams in the global scope.

    def to_message(self) -> Any:
        """Return the sensor as a ``sfglab_interfaces/msg/SensorInfo``."""
        from sfglab.messages import message_type

        return message_type("sfglab_interfaces/msg/SensorInfo")(
            name=self.name,
            model=self.model,
            streams=[stream.to_message() for stream in self.streams],
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentDescription:
    """Description of an agent for the agents that discover it."""

    sensors: tuple[SensorDescription, ...] = ()  #: Sensors of the agent.
    accelerators: tuple[str, ...] = ()  #: Codecs that work in hardware, as FFmpeg names them.
    software: tuple[str, ...] = ()  #: Components and their versions.

    def check(self, agent: str) -> None:
        """Check the description of an agent.

        Raises:
            DescriptionError: Two sensors share a name, or a stream is invalid, see `StreamDescription.check`.
        """
        names = [sensor.name for sensor in self.sensors]
        if len(set(names)) < len(names):
            raise DescriptionError("sensors", f"given {names}, allowed: different names")
        for stream in (stream for sensor in self.sensors for stream in sensor.streams):
            stream.check(agent)

    def to_message(self, agent: str, *, incarnation: int, revision: int, stamp_ns: int) -> Any:
        """Return the ``AgentMetadata``.

        Args:
            agent: Name of the agent.
            incarnation: Incarnation, as in the heartbeats.
            revision: Revision of the description, as in the heartbeats.
            stamp_ns: Time of the description, nanoseconds since the epoch.
        """
        from sfglab.messages import message_type, stamp_from_ns

        return message_type(AGENT_METADATA)(
            agent=agent,
            incarnation=incarnation,
            revision=revision,
            sensors=[sensor.to_message() for sensor in self.sensors],
            accelerators=list(self.accelerators),
            software=list(self.software),
            stamp=stamp_from_ns(stamp_ns),
        )


def _check_topic(topic: str, agent: str) -> None:
    place = f"topic {_short(topic)}"
    try:
        fqn = parse(topic)
    except FqnError as error:
        raise DescriptionError(place, str(error)[:MAX_TEXT]) from error
    allowed = f"allowed: names of agent {agent!r} in the global scope"
    if fqn.agent != agent:
        raise DescriptionError(place, f"the name is of another agent or of none; {allowed}")
    if fqn.scope is not Scope.GLOBAL:
        raise DescriptionError(place, allowed)


def _check_local(place: str, topic: str, agent: str) -> None:
    """Refuse a topic on which decoded images of this agent could be mistaken for another agent's."""
    try:
        validate_ros_name(topic)
    except FqnError as error:
        raise DescriptionError(place, str(error)[:MAX_TEXT]) from error
    if not topic.startswith(f"/{Scope.LOCAL.value}/{agent}/"):
        allowed = f"allowed: names of agent {agent!r} in the local scope"
        raise DescriptionError(place, f"given the decoded topic {_short(topic)}; {allowed}")


def _short(text: str) -> str:
    """Return a remote agent's text in quotes, limited in length."""
    return repr(text if len(text) <= MAX_TEXT else text[:MAX_TEXT] + "...")


_LIBRARIES = ("cyclonedds", "av", "numpy")


def accelerators() -> tuple[str, ...]:
    """Return the H.264 codecs that work in hardware on this machine. The trials take up to a second."""
    from sfglab.codecs.probe import available_decoders, available_encoders

    probes = (*available_encoders(), *available_decoders())
    return tuple(dict.fromkeys(p.name for p in probes if p.hardware and p.works))


def software() -> tuple[str, ...]:
    """Return the versions of sfglab and of the libraries that determine its capabilities."""
    from importlib.metadata import version

    return (f"sfglab {__version__}", *(f"{name} {version(name)}" for name in _LIBRARIES))

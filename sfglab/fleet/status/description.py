"""Description of an agent: its sensors and their streams, accelerators and software, as frozen values.

Knows the naming schema, the metadata messages, what a stream may say of itself, and how hardware is found.
"""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from sfglab import __version__
from sfglab.errors import SfglabError
from sfglab.fleet.status.heartbeat import AGENT_METADATA
from sfglab.messages import message_type, stamp_from_ns
from sfglab.names import FqnError, Scope, parse, validate_ros_name

if TYPE_CHECKING:
    from collections.abc import Sequence

#: What a stream may say that it is coded by.
CODECS = ("", "h264", "hevc", "jpeg", "png", "rvl")
MAX_EDGE = 16_384  #: Most pixels that a stream may say that its images are wide or high.
MAX_RATE_HZ = 10_000.0  #: Most messages per second that a stream may say that it has.
MAX_TEXT = 255  #: Longest name or line for people, in characters.
_TYPE = re.compile(r"[A-Za-z]\w*/msg/[A-Za-z]\w*", re.ASCII)


class DescriptionError(SfglabError, ValueError):
    """A description that others could not use."""

    def __init__(self, place: str, why: str) -> None:
        self.place = place  #: Which part of it.
        super().__init__(f"agent description, {place}: {why}")


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamDescription:
    """One stream of a sensor, as it crosses the agent's border; see ``StreamInfo.msg``."""

    topic: str  #: The global topic of the stream.
    type: str  #: ROS type of its messages.
    codec: str  #: ``h264``, ``rvl``, ``png`` or ``jpeg``.
    decoded_topic: str = ""  #: Where the decoded stream belongs; empty: derived from `topic`.
    camera_info_topic: str = ""  #: The global topic of the calibration; empty: there is none.
    width: int = 0  #: Pixels.
    height: int = 0  #: Pixels.
    rate_hz: float = 0.0  #: Nominal rate, messages per second.

    @classmethod
    def of(cls, stream: Any) -> StreamDescription:
        """Return what a ``StreamInfo``, or what has its fields, says, which may be anything."""
        return cls(**{name: getattr(stream, name) for name in cls.__dataclass_fields__})

    def check(self, agent: str) -> None:
        """Refuse what an agent must not, or cannot, say of a stream of its own.

        Raises:
            DescriptionError: A name is no name of this agent in the scope where it belongs, or type, codec,
                size or rate are none.
        """
        for topic in filter(None, (self.topic, self.camera_info_topic)):
            _check_topic(topic, agent)
        place = f"stream {_short(self.topic)}"
        if self.decoded_topic:
            _check_local(place, self.decoded_topic, agent)
        if not (_TYPE.fullmatch(self.type) and len(self.type) <= MAX_TEXT):
            raise DescriptionError(
                place, f"given the type {_short(self.type)}, allowed are names of messages"
            )
        if self.codec not in CODECS:
            raise DescriptionError(
                place, f"given the codec {_short(self.codec)}, allowed are {CODECS}"
            )
        if not (
            0 <= self.width <= MAX_EDGE
            and 0 <= self.height <= MAX_EDGE
            and 0 <= self.rate_hz <= MAX_RATE_HZ
        ):
            given = f"{self.width} x {self.height} pixels at {self.rate_hz} Hz"
            raise DescriptionError(
                place, f"given {given}, allowed are {MAX_EDGE} and {MAX_RATE_HZ:g}"
            )

    def to_message(self) -> Any:
        """Return the ``StreamInfo``."""
        return message_type("sfglab_interfaces/msg/StreamInfo")(**asdict(self))


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorDescription:
    """A sensor; see ``SensorInfo.msg``."""

    name: str  #: Unique within its agent.
    model: str = ""  #: Maker and model, for people.
    streams: tuple[StreamDescription, ...] = ()  #: What leaves the agent.

    def to_message(self) -> Any:
        """Return the ``SensorInfo``."""
        return message_type("sfglab_interfaces/msg/SensorInfo")(
            name=self.name,
            model=self.model,
            streams=[stream.to_message() for stream in self.streams],
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentDescription:
    """What an agent answers to whoever discovers it."""

    sensors: tuple[SensorDescription, ...] = ()  #: Its sensors.
    accelerators: tuple[str, ...] = ()  #: Codecs that work in hardware, by FFmpeg's names.
    software: tuple[str, ...] = ()  #: Components and versions.

    def check(self, agent: str) -> None:
        """Refuse an agent's description that would be of no use to others.

        Raises:
            DescriptionError: Two sensors share a name, or a topic is no name of this agent in the global
                scope, so that it does not cross the border.
        """
        names = [sensor.name for sensor in self.sensors]
        if len(set(names)) < len(names):
            raise DescriptionError("sensors", f"given {names}, allowed are names that differ")
        for stream in (stream for sensor in self.sensors for stream in sensor.streams):
            stream.check(agent)

    def to_message(self, agent: str, *, incarnation: int, revision: int, stamp_ns: int) -> Any:
        """Return the ``AgentMetadata`` with numbers as in heartbeats, made at `stamp_ns` since the epoch."""
        return message_type(AGENT_METADATA)(
            agent=agent,
            incarnation=incarnation,
            revision=revision,
            sensors=[sensor.to_message() for sensor in self.sensors],
            accelerators=list(self.accelerators),
            software=list(self.software),
            stamp=stamp_from_ns(stamp_ns),
        )

    @classmethod
    def from_values(cls, values: dict[str, Any]) -> AgentDescription:
        """Return the description that `asdict` took apart; `DescriptionError` if it has other parts."""
        known = _known_values("values", cls, values)
        sensors = tuple(_sensor_from_values(sensor) for sensor in _list(known.pop("sensors", ())))
        return cls(
            sensors=sensors,
            **{name: tuple(map(str, _list(entry))) for name, entry in known.items()},
        )


def _sensor_from_values(values: Any) -> SensorDescription:
    known = _known_values("sensor", SensorDescription, values)
    given = (
        _known_values("stream", StreamDescription, stream)
        for stream in _list(known.pop("streams", ()))
    )
    streams = tuple(StreamDescription(**stream) for stream in given)
    try:
        return SensorDescription(streams=streams, **known)
    except TypeError as error:
        raise DescriptionError("sensor", str(error)) from error


def _list(values: Any) -> Sequence[Any]:
    if isinstance(values, (list, tuple)):
        return values
    raise DescriptionError("values", f"given {values!r}, allowed are lists")


def _known_values(place: str, type_: type[Any], values: Any) -> dict[str, Any]:
    fields = set(type_.__dataclass_fields__)
    if not isinstance(values, dict) or not set(values) <= fields:
        raise DescriptionError(
            place, f"given {values!r}, allowed are values of {', '.join(sorted(fields))}"
        )
    return dict(values)


def _check_topic(topic: str, agent: str) -> None:
    place = f"topic {_short(topic)}"
    try:
        fqn = parse(topic)
    except FqnError as error:
        raise DescriptionError(place, str(error)[:MAX_TEXT]) from error
    allowed = f"allowed are names of agent {agent!r} in the global scope: others stay inside"
    if fqn.agent != agent:
        raise DescriptionError(place, f"it bears another agent's name or none; {allowed}")
    if fqn.scope is not Scope.GLOBAL:
        raise DescriptionError(place, allowed)


def _check_local(place: str, topic: str, agent: str) -> None:
    """Refuse a topic on which decoded pictures of this agent could be taken for somebody else's."""
    try:
        validate_ros_name(topic)
    except FqnError as error:
        raise DescriptionError(place, str(error)[:MAX_TEXT]) from error
    if not topic.startswith(f"/{Scope.LOCAL.value}/{agent}/"):
        allowed = f"allowed are names of agent {agent!r} in the local scope"
        raise DescriptionError(place, f"given the decoded topic {_short(topic)}; {allowed}")


def _short(text: str) -> str:
    """Return a text of a stranger's as it can be shown."""
    return repr(text if len(text) <= MAX_TEXT else text[:MAX_TEXT] + "...")


_LIBRARIES = ("cyclonedds", "av", "numpy")


def accelerators() -> tuple[str, ...]:
    """Return FFmpeg's names of the H.264 codecs that work in hardware here, after up to a second of trials."""
    from sfglab.codecs.probe import available_decoders, available_encoders

    probes = (*available_encoders(), *available_decoders())
    return tuple(dict.fromkeys(p.name for p in probes if p.hardware and p.works))


def software() -> tuple[str, ...]:
    """Return sfglab and the libraries that decide what it can do, each with its version."""
    return (f"sfglab {__version__}", *(f"{name} {version(name)}" for name in _LIBRARIES))

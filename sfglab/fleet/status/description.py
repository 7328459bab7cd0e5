"""Description of an agent: its sensors and their streams, accelerators and software, as frozen values.

Knows the naming schema, the metadata messages, and how hardware that works on this machine is found.
"""

from __future__ import annotations

from dataclasses import dataclass
from importlib.metadata import version
from typing import TYPE_CHECKING, Any

from sfglab import __version__
from sfglab.errors import SfglabError
from sfglab.fleet.status.heartbeat import AGENT_METADATA
from sfglab.messages import message_type, stamp_from_ns
from sfglab.names import FqnError, Scope, parse

if TYPE_CHECKING:
    from collections.abc import Sequence


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

    def to_message(self) -> Any:
        """Return the ``StreamInfo``."""
        return message_type("sfglab_interfaces/msg/StreamInfo")(
            **{name: getattr(self, name) for name in self.__dataclass_fields__}
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorDescription:
    """A sensor; see ``SensorInfo.msg``."""

    name: str  #: Unique within its agent.
    model: str = ""  #: Maker and model, for people.
    streams: tuple[StreamDescription, ...] = ()  #: What leaves the agent.

    def to_message(self) -> Any:
        """Return the ``SensorInfo``."""
        return message_type("sfglab_interfaces/msg/SensorInfo")(
            name=self.name, model=self.model, streams=[stream.to_message() for stream in self.streams]
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
            for topic in filter(None, (stream.topic, stream.camera_info_topic)):
                _check_topic(topic, agent)

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
        """Return the description that `dataclasses.asdict` took apart.

        Raises:
            DescriptionError: It has other parts than a description.
        """
        known = _known_values("values", cls, values)
        sensors = tuple(_sensor_from_values(sensor) for sensor in _list(known.pop("sensors", ())))
        return cls(sensors=sensors, **{name: tuple(map(str, _list(entry))) for name, entry in known.items()})


def _sensor_from_values(values: Any) -> SensorDescription:
    known = _known_values("sensor", SensorDescription, values)
    streams = tuple(
        StreamDescription(**_known_values("stream", StreamDescription, stream))
        for stream in _list(known.pop("streams", ()))
    )
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
        raise DescriptionError(place, f"given {values!r}, allowed are values of {', '.join(sorted(fields))}")
    return dict(values)


def _check_topic(topic: str, agent: str) -> None:
    try:
        fqn = parse(topic)
    except FqnError as error:
        raise DescriptionError(f"topic {topic!r}", str(error)) from error
    if fqn.scope is not Scope.GLOBAL or fqn.agent != agent:
        raise DescriptionError(
            f"topic {topic!r}", f"allowed are names of agent {agent!r} in the global scope: others stay inside"
        )


_LIBRARIES = ("cyclonedds", "av", "numpy")


def accelerators() -> tuple[str, ...]:
    """Return FFmpeg's names of the H.264 codecs that work in hardware here.

    Each candidate encodes or decodes a trial, which takes up to a second together.
    """
    from sfglab.codecs.probe import available_decoders, available_encoders

    probes = (*available_encoders(), *available_decoders())
    return tuple(dict.fromkeys(p.name for p in probes if p.hardware and p.works))


def software() -> tuple[str, ...]:
    """Return sfglab and the libraries that decide what it can do, each with its version."""
    return (f"sfglab {__version__}", *(f"{name} {version(name)}" for name in _LIBRARIES))

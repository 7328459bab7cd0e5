"""Standard values of the schema's segments, their suffixes, and `Custom` for other values.

The values are those of the sets S, C, D and R of paper A, section 4.1, of a mixed fleet. The rules below
make each segment readable in exactly one way:

* A suffix of digits only is appended directly (`infra1`, as camera drivers write it). Every other suffix follows
  an underscore (`camera_front`). A standard value ends in a letter, so that the suffix can be separated.
* The longest standard value wins. A suffix that would spell another value is refused: `compressed` with the
  suffix `depth` would be `compressed_depth`.
* A `Custom` segment must not spell a standard value of any set. It must not spell a value of its own set with a
  suffix either, in both forms (`camera_front`, `camera_1`).
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from enum import Enum, Flag, auto
from functools import cache
from typing import Generic, Self, TypeVar

from sfglab.names.grammar import FqnError, ResourceKind, check_words

_SUFFIX = re.compile(r"[A-Za-z0-9]+(?:_[A-Za-z0-9]+)*")
_DIGITS = re.compile(r"[0-9]+")


class Scope(Enum):
    """The set S: whether a name is used in the agent's domain only or also in the global domain."""

    LOCAL = "local"
    GLOBAL = "global"


class After(Flag):
    """The kinds of segment that a resource may follow: the bitwise constraint of paper A, Fig. 2."""

    SCOPE = auto()
    AGENT = auto()
    COMPONENT = auto()
    STREAM = auto()


class _Standard(Enum):
    @property
    def text(self) -> str:
        """Text of the segment in a name."""
        return str(self.value)

    def suffixed(self, suffix: str) -> Suffixed[Self]:
        """Return this value with a suffix, for example `Component.CAMERA.suffixed("front")`.

        Raises:
            FqnError: The suffix has other characters than letters, digits and single underscores
                between them, or the result spells another standard value.
        """
        return Suffixed(base=self, suffix=suffix)


class Component(_Standard):
    """The set C: parts of an agent, hardware and software."""

    LIDAR = "lidar"
    RADAR = "radar"
    SONAR = "sonar"
    CAMERA = "camera"
    DEPTH_CAMERA = "depth_camera"
    STEREO_CAMERA = "stereo_camera"
    THERMAL_CAMERA = "thermal_camera"
    IMU = "imu"
    GNSS = "gnss"
    MICROPHONE = "microphone"
    SPEAKER = "speaker"
    BATTERY = "battery"
    BASE = "base"
    ARM = "arm"
    GRIPPER = "gripper"
    LOCOMOTION_CONTROLLER = "locomotion_controller"
    JOINT_CONTROLLER = "joint_controller"
    TELEOP = "teleop"
    LOCALIZATION = "localization"
    MAPPING = "mapping"
    NAVIGATION = "navigation"
    PLANNER = "planner"
    PERCEPTION = "perception"
    MOCAP = "mocap"


class Stream(_Standard):
    """The set D: data streams of one component."""

    COLOR = "color"
    DEPTH = "depth"
    ALIGNED_DEPTH = "aligned_depth"
    CONFIDENCE = "confidence"
    INFRA = "infra"
    THERMAL = "thermal"
    MONO = "mono"
    LEFT = "left"
    RIGHT = "right"
    POINTS = "points"
    SCAN = "scan"
    IMU = "imu"
    ACCEL = "accel"
    GYRO = "gyro"
    POSE = "pose"
    ODOMETRY = "odometry"
    AUDIO = "audio"


# Places of resources. Sensor data belong to a component or one of its streams, state and motion to an agent
# or one of its components, life-cycle resources to the fleet or an agent.
_SENSOR = After.COMPONENT | After.STREAM
_BODY = After.AGENT | After.COMPONENT
_SHARED = After.SCOPE | After.AGENT | After.COMPONENT
_TOPIC, _SERVICE, _ACTION = ResourceKind.TOPIC, ResourceKind.SERVICE, ResourceKind.ACTION


class Resource(_Standard):
    """The set R: topics, services and actions."""

    after: After  #: Kinds of segment that the resource may follow.
    kind: ResourceKind  #: Topic, service or action.

    def __new__(cls, text: str, after: After, kind: ResourceKind) -> Self:
        """Use the text alone as the value, so that `Resource("image_raw")` finds the member."""
        member = object.__new__(cls)
        member._value_ = text
        member.after = after
        member.kind = kind
        return member

    IMAGE_RAW = "image_raw", _SENSOR, _TOPIC
    IMAGE_RECT = "image_rect", _SENSOR, _TOPIC
    COMPRESSED = "compressed", _SENSOR, _TOPIC
    COMPRESSED_DEPTH = "compressed_depth", _SENSOR, _TOPIC
    FFMPEG = "ffmpeg", _SENSOR, _TOPIC
    FFMPEG_REPLAY = "ffmpeg_replay", _SENSOR, _TOPIC
    CAMERA_INFO = "camera_info", _SENSOR, _TOPIC
    POINTS = "points", _SENSOR, _TOPIC
    SCAN = "scan", _SENSOR, _TOPIC
    RANGE = "range", _SENSOR, _TOPIC
    IMU = "imu", _SENSOR, _TOPIC
    MAGNETIC_FIELD = "magnetic_field", _SENSOR, _TOPIC
    NAV_SAT_FIX = "nav_sat_fix", _SENSOR, _TOPIC
    AUDIO = "audio", _SENSOR, _TOPIC
    WRENCH = "wrench", _SENSOR, _TOPIC
    DETECTIONS = "detections", _SENSOR, _TOPIC
    JOINT_STATES = "joint_states", _BODY, _TOPIC
    JOINT_COMMANDS = "joint_commands", _BODY, _TOPIC
    POSE = "pose", _BODY | After.STREAM, _TOPIC
    TWIST = "twist", _BODY | After.STREAM, _TOPIC
    ODOMETRY = "odometry", _BODY | After.STREAM, _TOPIC
    PATH = "path", _BODY, _TOPIC
    CMD_VEL = "cmd_vel", _BODY, _TOPIC
    GOAL_POSE = "goal_pose", _BODY, _TOPIC
    STATE = "state", _BODY, _TOPIC
    STATUS = "status", _BODY, _TOPIC
    BATTERY_STATE = "battery_state", _BODY, _TOPIC
    DIAGNOSTICS = "diagnostics", _BODY, _TOPIC
    ROBOT_DESCRIPTION = "robot_description", After.AGENT, _TOPIC
    MAP = "map", _SHARED, _TOPIC
    MARKERS = "markers", _SHARED, _TOPIC
    AGENT_HEARTBEAT = "agent_heartbeat", After.SCOPE, _TOPIC
    AGENT_STATUS = "agent_status", After.AGENT, _TOPIC
    AGENT_DISCOVERY_EVENT = "agent_discovery_event", After.AGENT, _TOPIC
    GET_METADATA = "get_metadata", After.AGENT, _SERVICE
    SET_MODE = "set_mode", _BODY, _SERVICE
    RESET = "reset", _BODY, _SERVICE
    NAVIGATE_TO_POSE = "navigate_to_pose", _BODY, _ACTION
    FOLLOW_PATH = "follow_path", _BODY, _ACTION
    EXECUTE_TRAJECTORY = "execute_trajectory", _BODY, _ACTION


StandardT = TypeVar("StandardT", bound=_Standard)


@dataclass(frozen=True, slots=True, kw_only=True)
class Suffixed(Generic[StandardT]):
    """A standard value with a suffix, for example for a front and a rear camera.

    Raises:
        FqnError: The suffix has other characters, or value and suffix together spell another standard value.
    """

    base: StandardT  #: The standard value.
    suffix: str  #: Letters and digits, with single underscores between them.

    def __post_init__(self) -> None:
        label = type(self.base).__name__.lower()
        if not _SUFFIX.fullmatch(self.suffix):
            allowed = f"{label} suffix of ASCII letters and digits, single underscores between them"
            raise FqnError("suffix", self.suffix, allowed)
        spelled = _split(type(self.base), self.text)
        if spelled is None or spelled[0] is not self.base:
            other = spelled[0] if spelled else None
            allowed = f"one that does not make {self.base.text!r} spell {label} {other}"
            raise FqnError("suffix", self.suffix, allowed)

    @property
    def text(self) -> str:
        """Text of the segment in a name."""
        joint = "" if _DIGITS.fullmatch(self.suffix) else "_"
        return f"{self.base.text}{joint}{self.suffix}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Custom:
    """A segment outside the standard sets, as paper A, section 4.1, provides for."""

    text: str = field(kw_only=False)  #: Words of letters and digits, joined by underscores.
    #: Topic, service or action of a resource; other segments have no kind.
    kind: ResourceKind = ResourceKind.TOPIC

    def __post_init__(self) -> None:
        check_words("custom", self.text)

    @property
    def after(self) -> After:
        """Kinds of segment that a custom resource may follow: all."""
        return After.SCOPE | After.AGENT | After.COMPONENT | After.STREAM


def read_standard(values: type[StandardT], text: str) -> StandardT | Suffixed[StandardT] | None:
    """Return the standard value, with its suffix if any, that a checked segment spells, or None.

    Raises:
        FqnError: An underscore precedes a suffix of digits; only `camera1` is allowed.
    """
    spelled = _split(values, text)
    if spelled is None:
        return None
    base, rest = spelled
    if not rest:
        return base
    suffix = rest.removeprefix("_")
    if rest.startswith("_") and _DIGITS.fullmatch(suffix):
        allowed = f"{base.text + suffix!r}: a suffix of digits follows the standard value directly"
        raise FqnError(values.__name__.lower(), text, allowed)
    return Suffixed(base=base, suffix=suffix)


def check_unmistakable(segment: str, text: str, *, own: type[_Standard]) -> None:
    """Check that a text spells no standard value, and no value of its own set with a suffix.

    Raises:
        FqnError: With this segment; the text spells such a value.
    """
    meant = _standard_texts().get(text)
    if meant is not None:
        raise FqnError(segment, text, f"a name that cannot be mistaken for the standard {meant}")
    spelled = _split(own, text)
    if spelled is not None:
        meant_value = f"{own.__name__}.{spelled[0].name}"
        raise FqnError(
            segment, text, f"a name that cannot be mistaken for {meant_value} with a suffix"
        )


@cache
def _standard_texts() -> dict[str, Enum]:
    """Return the standard values by text; if several sets have a text, the first of S, C, D and R counts."""
    return {
        value.value: value for values in (Resource, Stream, Component, Scope) for value in values
    }


@cache
def _longest_first(values: type[StandardT]) -> tuple[tuple[str, StandardT], ...]:
    texts = [(value.text, value) for value in values]
    return tuple(sorted(texts, key=lambda pair: len(pair[0]), reverse=True))


def _split(values: type[StandardT], text: str) -> tuple[StandardT, str] | None:
    """Return the longest standard value at the start of a text, and the rest of the text."""
    for standard, value in _longest_first(values):
        if text.startswith(standard):
            rest = text.removeprefix(standard)
            if not rest or rest[0] == "_" or _DIGITS.fullmatch(rest):
                return value, rest
    return None

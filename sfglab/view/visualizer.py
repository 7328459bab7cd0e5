"""Base class of visualizers: small classes that declare their inputs and draw the received messages.

    class Range(Visualizer):
        name = "range"
        inputs = (Input("range", "sensor_msgs/msg/Range"),)
        parameters = (Parameter("radius_m", 0.02, "line radius, m", minimum=0.001),)

        def show(self, update, canvas):
            ...

Visualizers are found through the entry points of the group ``sfglab.visualizers``. A panel makes a widget for each
parameter; only `Parameter.check` decides which values are allowed. A visualizer declares its rate and its queue, and
does not depend on the source of the messages or on the output.

A topic of the naming schema (paper A, section 4.1) has an entity below that of its agent, so that one click hides an
agent: ``/global/go2/camera_front/color/ffmpeg`` is ``/agents/go2/global/camera_front/color/ffmpeg``.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from dataclasses import KW_ONLY, dataclass
from fnmatch import fnmatchcase
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Protocol

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.fields import Bounds
from sfglab.names import FqnError, parse
from sfglab.qos import SENSOR_DATA, QoSProfile
from sfglab.validation import read
from sfglab.view.sync import Independent, SyncPolicy

if TYPE_CHECKING:
    from collections.abc import Mapping


@dataclass(frozen=True, slots=True)
class Input:
    """Declaration of a topic that a visualizer reads."""

    role: str  #: Name of the input in the visualizer.
    type: str  #: ROS type of its messages.
    _: KW_ONLY
    #: Topics that the visualizer is offered for; ``*`` stands for any characters.
    pattern: str = "*"
    #: Last segment of the topic that this input gets automatically, such as ``camera_info``; the other segments are
    #: those of the first input's topic. Empty for no such topic.
    sibling: str = ""
    optional: bool = False  #: Whether the visualizer also works without this input.
    #: Whether one message may belong to all updates, such as a calibration that is published once.
    steady: bool = False
    qos: QoSProfile = SENSOR_DATA  #: Requested QoS.

    def fits(self, topic: str, type_name: str) -> bool:
        """Return whether a topic with a ROS type can be this input."""
        return type_name == self.type and fnmatchcase(topic, self.pattern)


@dataclass(frozen=True, slots=True, kw_only=True)
class Update:
    """One message for each input of a visualizer, with matching stamps."""

    messages: Mapping[str, Any]  #: Decoded messages by role.
    #: Capture stamp of the first message, ns; without a stamp, the time of its reception.
    stamp_ns: int
    received_ns: int  #: Time of the last reception, ns, on the clock of this host or of the log.
    #: Number of sets that a full queue or the rate budget dropped since the last update.
    lost: int = 0

    def __getitem__(self, role: str) -> Any:
        return self.messages[role]

    @property
    def only(self) -> Any:
        """The message of the only input."""
        (message,) = self.messages.values()
        return message


class NotShownError(SfglabError):
    """An update that another visualizer shows; it counts neither as shown nor as an error."""


class SinkError(SfglabError, OSError):
    """An output that no longer accepts data; nothing more is shown there."""


class Canvas(Protocol):
    """Drawing interface of a visualizer."""

    def log(self, entity: str, *what: Any, static: bool = False) -> None:
        """Draw Rerun archetypes at an entity, from the present time on, or with `static` for all times."""

    def place(self, entity: str, frame: str) -> None:
        """Set the coordinate frame of an entity's geometry; an empty name has no effect."""

    def at(self, *, stamp_ns: int, received_ns: int) -> None:
        """Set the capture time and the reception time, ns, of everything drawn next."""


class Visualizer(ABC):
    """Base class of visualizers. One thread uses an object of it.

    Args:
        topics: Topic by role.
        settings: Values of parameters by name; the others have their defaults.

    Raises:
        InvalidValueError: A required role is missing, a role or a parameter is unknown, or a value is not allowed.
    """

    name: ClassVar[str]  #: Name for `Session.add`, unique among all installed visualizers.
    #: Inputs; the first one determines the entity and the time of an update.
    inputs: ClassVar[tuple[Input, ...]]
    sync: ClassVar[SyncPolicy] = (
        Independent()
    )  #: Policy by which messages of several inputs are matched.
    max_hz: ClassVar[float | None] = 30.0  #: Rate budget, updates per second; None for no limit.
    #: Largest number of updates that wait; the oldest is dropped when there are more. 1 shows the latest.
    queue: ClassVar[int] = 1
    tick_hz: ClassVar[float] = 0.0  #: Rate of calls of `tick`, Hz; 0 for none.
    parameters: ClassVar[tuple[Parameter, ...]] = ()  #: Parameters, which may change at run time.

    def __init__(
        self, topics: Mapping[str, str], settings: Mapping[str, object] | None = None
    ) -> None:
        self.topics = _checked_topics(type(self), topics)  #: Topic by role.
        #: Entity that the visualizer draws at, derived from the first topic.
        self.entity = entity_of_topic(next(iter(self.topics.values())))
        #: Value of every parameter; changed by `tune`.
        self.settings: dict[str, Setting] = {
            parameter.name: parameter.default for parameter in self.parameters
        }
        for name, value in (settings or {}).items():
            self.tune(name, value)

    def tune(self, name: str, value: object) -> None:
        """Change one parameter from the next update on.

        Raises:
            InvalidValueError: There is no such parameter, or the value is not allowed.
        """
        for parameter in self.parameters:
            if parameter.name == name:
                self.settings[name] = parameter.check(value)
                return
        known = ", ".join(self.settings) or "none"
        raise InvalidValueError(name, value, f"the parameters {known}")

    def __getitem__(self, name: str) -> Any:
        return self.settings[name]

    @abstractmethod
    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw one update.

        Raises:
            NotShownError: Another visualizer shows the update.
            SfglabError: The update cannot be drawn. The error is counted and reported, and the next update is drawn.
        """

    def tick(self, now_ns: int, canvas: Canvas) -> None:  # noqa: B027 - most have nothing to do
        """Draw what changes with time alone; called at `tick_hz` with the time on the reception clock, ns."""


def _checked_topics(kind: type[Visualizer], topics: Mapping[str, str]) -> dict[str, str]:
    """Return topics by role, in the order of a visualizer's inputs.

    Raises:
        InvalidValueError: A required role is missing, or a role is unknown.
    """
    found = {given.role: topics[given.role] for given in kind.inputs if given.role in topics}
    needed = {given.role for given in kind.inputs if not given.optional}
    if len(found) < len(topics) or not needed.issubset(found):
        roles = ", ".join(f"{i.role} (optional)" if i.optional else i.role for i in kind.inputs)
        raise InvalidValueError(f"{kind.name}, topics", dict(topics), f"one for each of {roles}")
    return found


AGENTS = "/agents"  #: The root of all agents.


def agent_root(agent: str) -> str:
    """Return the entity that is above all entities of an agent."""
    return f"{AGENTS}/{agent}"


def camera_name(topic: str) -> str:
    """Return the name that the topics of one camera have in common.

    It is ``<name>`` in ``<name>/camera_info``, in ``<name>/ffmpeg`` (naming schema), and in ``<name>/image_raw`` and
    ``<name>/image_raw/compressed`` (image_transport).
    """
    name = topic.rpartition("/")[0]
    parent, _, last = name.rpartition("/")
    return parent if last.startswith("image") else name


def entity_of_topic(topic: str) -> str:
    """Return the entity of a topic in the viewer; for a topic of an agent, an entity below `agent_root`."""
    try:
        agent = parse(topic).agent
    except FqnError:
        agent = None
    if agent is None:
        return topic
    scope, _, *rest = topic.strip("/").split("/")
    return "/".join((agent_root(agent), scope, *rest))


Setting = bool | int | float | str  #: Value of a parameter.


@dataclass(frozen=True, slots=True)
class Parameter:
    """Declaration of a parameter of a visualizer, which can be changed at run time."""

    name: str  #: Name, a Python identifier.
    default: Setting  #: Default value, which also determines the type.
    help: str  #: Sentence on its effect, with its unit.
    _: KW_ONLY
    minimum: float = -math.inf  #: Smallest number.
    maximum: float = math.inf  #: Largest number.

    @property
    def kind(self) -> type[Setting]:
        """Type of the values: `bool`, `int`, `float` or `str`."""
        return type(self.default)

    def check(self, value: object) -> Setting:
        """Return a value in the parameter's type.

        Raises:
            InvalidValueError: The value has another type, or is out of range.
        """
        hint: Any = self.kind
        if self.kind in (int, float):
            hint = Annotated[self.kind, Bounds(self.minimum, self.maximum)]
        checked: Setting = read(hint, value, self.name)
        return checked

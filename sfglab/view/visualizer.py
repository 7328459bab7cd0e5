"""A visualizer: a small class that says what it needs and shows what it gets.

    class Range(Visualizer):
        name = "range"
        inputs = (Input("range", "sensor_msgs/msg/Range"),)
        parameters = (Parameter("radius_m", 0.02, "line radius, m", minimum=0.001),)

        def show(self, update, canvas):
            ...

It is found through the entry points of the group ``sfglab.visualizers``. A panel makes a widget of each of its
parameters; `Parameter.check` is the one place that decides which values are allowed. A name of the schema
(paper A, section 4.1) lands below its agent, whichever scope it has, so one click hides an agent:
``/global/go2/camera_front/color/ffmpeg`` is ``/agents/go2/global/camera_front/color/ffmpeg``. Refuses to know
where messages come from and where what is shown goes; it decides nothing on rates and queues but declares them.
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
    """A topic that a visualizer needs."""

    role: str  #: Name of the input in the visualizer.
    type: str  #: ROS type of its messages.
    _: KW_ONLY
    pattern: str = "*"  #: Topics that it offers itself for; ``*`` stands for any characters.
    #: Last segment of the topic beside the first input's that this one is bound to by itself, such as
    #: ``camera_info``; empty for none.
    sibling: str = ""
    optional: bool = False  #: Whether the visualizer also works without.
    #: Whether one message may hold for good, as a calibration that is published once.
    steady: bool = False
    qos: QoSProfile = SENSOR_DATA  #: Requested QoS.

    def fits(self, topic: str, type_name: str) -> bool:
        """Return whether a topic can be this input."""
        return type_name == self.type and fnmatchcase(topic, self.pattern)


@dataclass(frozen=True, slots=True, kw_only=True)
class Update:
    """Messages that belong together."""

    messages: Mapping[str, Any]  #: Decoded, by role.
    #: Capture stamp of the first message; without a stamp, the time of its reception.
    stamp_ns: int
    received_ns: int  #: Time of the last reception, on the clock of this host or of the log.
    #: Sets of messages passed over since the last update, by a full queue or the rate budget.
    lost: int = 0

    def __getitem__(self, role: str) -> Any:
        return self.messages[role]

    @property
    def only(self) -> Any:
        """The message of an input that stands alone."""
        (message,) = self.messages.values()
        return message


class NotShownError(SfglabError):
    """An update that another visualizer shows: it counts neither as shown nor as failed."""


class SinkError(SfglabError, OSError):
    """A place that what is shown cannot be sent to; nothing more is shown there."""


class Canvas(Protocol):
    """Drawing interface of a visualizer."""

    def log(self, entity: str, *what: Any, static: bool = False) -> None:
        """Show Rerun archetypes at an entity, from the present time on, or for all times."""

    def place(self, entity: str, frame: str) -> None:
        """Say in which coordinate frame an entity's geometry is given; an empty name says nothing."""

    def at(self, *, stamp_ns: int, received_ns: int) -> None:
        """Set the time of what is shown next."""


class Visualizer(ABC):
    """Shows its inputs' messages, used by one thread; InvalidValueError for a wrong value or role."""

    name: ClassVar[str]  #: Under which it is added; unique among all that are installed.
    #: The first leads: it gives the entity, and where it matters the time.
    inputs: ClassVar[tuple[Input, ...]]
    sync: ClassVar[SyncPolicy] = (
        Independent()
    )  #: Policy by which messages of several inputs are matched.
    max_hz: ClassVar[float | None] = 30.0  #: Its rate budget; None where each message counts.
    #: Number of updates that may wait; the oldest is dropped when there are more. 1 shows the latest.
    queue: ClassVar[int] = 1
    tick_hz: ClassVar[float] = 0.0  #: Rate of calls of `tick`, Hz; 0 for none.
    parameters: ClassVar[tuple[Parameter, ...]] = ()  #: Parameters, which may change at run time.

    def __init__(
        self, topics: Mapping[str, str], settings: Mapping[str, object] | None = None
    ) -> None:
        self.topics = _checked_topics(type(self), topics)  #: Topic by role.
        #: Entity that it draws at, made from the first topic.
        self.entity = entity_of_topic(next(iter(self.topics.values())))
        #: Value of every parameter; changed by `tune`.
        self.settings: dict[str, Setting] = {
            parameter.name: parameter.default for parameter in self.parameters
        }
        for name, value in (settings or {}).items():
            self.tune(name, value)

    def tune(self, name: str, value: object) -> None:
        """Change one parameter from the next update on; InvalidValueError for an unknown name or a wrong value."""
        for parameter in self.parameters:
            if parameter.name == name:
                self.settings[name] = parameter.check(value)
                return
        known = ", ".join(self.settings) or "none"
        raise InvalidValueError(name, value, f"a parameter: {known}")

    def __getitem__(self, name: str) -> Any:
        return self.settings[name]

    @abstractmethod
    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw one update.

        Raises:
            NotShownError: The update is another visualizer's.
            SfglabError: It cannot be drawn. That is counted and told, and the next updates are tried.
        """

    def tick(self, now_ns: int, canvas: Canvas) -> None:  # noqa: B027 - most have nothing to do
        """Draw what changes as time goes by; called `tick_hz` times a second of the received clock."""


def _checked_topics(kind: type[Visualizer], topics: Mapping[str, str]) -> dict[str, str]:
    """Return topics in the order of a visualizer's inputs."""
    found = {given.role: topics[given.role] for given in kind.inputs if given.role in topics}
    needed = {given.role for given in kind.inputs if not given.optional}
    if len(found) < len(topics) or not needed.issubset(found):
        roles = ", ".join(f"{i.role} (optional)" if i.optional else i.role for i in kind.inputs)
        raise InvalidValueError(f"{kind.name}, topics", dict(topics), f"one for each of {roles}")
    return found


AGENTS = "/agents"  #: The root of all agents.


def agent_root(agent: str) -> str:
    """Return the entity below which everything of an agent stands."""
    return f"{AGENTS}/{agent}"


def camera_name(topic: str) -> str:
    """Return the name that the topics of one camera have in common.

    It is ``<name>`` in ``<name>/camera_info``, in ``<name>/ffmpeg`` as the naming schema has it, and in
    ``<name>/image_raw`` and ``<name>/image_raw/compressed`` as image_transport has it.
    """
    name = topic.rpartition("/")[0]
    parent, _, last = name.rpartition("/")
    return parent if last.startswith("image") else name


def entity_of_topic(topic: str) -> str:
    """Return the entity of a topic."""
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
    """One thing to tune."""

    name: str  #: A Python identifier.
    default: Setting  #: Its first value, which also says its type.
    help: str  #: Sentence on its effect, with its unit.
    _: KW_ONLY
    minimum: float = -math.inf  #: Smallest number.
    maximum: float = math.inf  #: Largest number.

    @property
    def kind(self) -> type[Setting]:
        """`bool`, `int`, `float` or `str`."""
        return type(self.default)

    def check(self, value: object) -> Setting:
        """Return a value in the parameter's type; InvalidValueError where it is of another or out of range."""
        hint: Any = self.kind
        if self.kind in (int, float):
            hint = Annotated[self.kind, Bounds(self.minimum, self.maximum)]
        checked: Setting = read(hint, value, self.name)
        return checked

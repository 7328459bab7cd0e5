"""A part of the scene: one topic's messages, and what a recording must hold of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from sfglab.lab.experiments.visualisation.moments import Moment


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where something is shown."""

    entity: str  #: Its entity.
    component: str  #: Of the archetype that shows it.
    is_timeless: bool = False  #: Whether it is shown for all times.


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """One topic and what a recording must hold of it."""

    kind: str  #: The visualizer that is asked for.
    topic: str  #: Its topic.
    type: str  #: Its ROS type.
    messages: tuple[Any, ...]  #: One a moment, None where it does not speak.
    place: Place | None = None  #: Where it is shown; None where nothing is compared message by message.
    #: What a recording must hold there, one array or list of texts for each message.
    expected: tuple[Any, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Speaker:
    """A topic and how its messages are made."""

    kind: str  #: The visualizer that is asked for.
    topic: str  #: Its topic.
    type: str  #: Its ROS type.
    say: Callable[[Moment], Any]  #: Makes the message of a moment, or None.

    def part(self, moments: Sequence[Moment]) -> Part:
        """Return its part of a scene, nothing expected of it."""
        messages = tuple(map(self.say, moments))
        return Part(kind=self.kind, topic=self.topic, type=self.type, messages=messages)

    def shown(
        self, moments: Sequence[Moment], entity: str, component: str, of: Callable[[Moment], Any]
    ) -> Part:
        """Return its part of a scene; `of` gives what each moment shows at an entity."""
        place = Place(entity=entity, component=component)
        return replace(self.part(moments), place=place, expected=tuple(map(of, moments)))

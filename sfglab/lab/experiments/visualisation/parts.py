"""A part of the scene: one topic's messages, and what a recording must hold of them."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from sfglab.lab.experiments.visualisation.moments import Moment

__all__ = ["Part", "Place", "Speaker"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where something is shown.

    Attributes:
        entity: Its entity.
        component: Of the archetype that shows it.
        is_timeless: Whether it is shown for all times.
    """

    entity: str
    component: str
    is_timeless: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """One topic and what a recording must hold of it.

    Attributes:
        kind: The visualizer that is asked for.
        topic: Its topic.
        type: Its ROS type.
        messages: One a moment, None where it does not speak.
        place: Where it is shown; None where nothing is compared message by message.
        expected: What a recording must hold there, one array or list of texts for each message.
    """

    kind: str
    topic: str
    type: str
    messages: tuple[Any, ...]
    place: Place | None = None
    expected: tuple[Any, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Speaker:
    """A topic and how its messages are made.

    Attributes:
        kind: The visualizer that is asked for.
        topic: Its topic.
        type: Its ROS type.
        say: Makes the message of a moment, or None.
    """

    kind: str
    topic: str
    type: str
    say: Callable[[Moment], Any]

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

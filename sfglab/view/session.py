"""Displays of a view, which are added, removed and tuned at run time, as in RViz's list of displays.

A package offers visualizers of its own under entry points of the group ``sfglab.visualizers``. One that cannot
be loaded is reported and left out. A session knows which visualizers show which topics; `stage` delivers
messages to them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any, NamedTuple

from sfglab.errors import InvalidValueError
from sfglab.view.slot import Slot
from sfglab.view.visualizer import Input, Visualizer
from sfglab.view.visualizers import clouds, fleet, images, markers, poses

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from sfglab.qos import QoSProfile
    from sfglab.view.sync import SyncPolicy

GROUP = "sfglab.visualizers"  #: The entry points' group.

BUILT_IN: tuple[type[Visualizer], ...] = (
    images.Image,
    images.CompressedImage,
    images.CameraModel,
    images.FfmpegVideo,
    images.FoxgloveVideo,
    images.CompressedImageVideo,
    clouds.DepthCloud,
    clouds.CompressedDepthCloud,
    clouds.PointCloud,
    clouds.LaserScan,
    poses.Transforms,
    poses.StaticTransforms,
    poses.Pose,
    poses.Path,
    poses.Odometry,
    markers.Marker,
    markers.MarkerArray,
    fleet.AgentStatus,
    fleet.AgentHeartbeats,
)
"""All of them, in the order in which they offer themselves for a topic."""


class Registry(NamedTuple):
    """Visualizers that were found."""

    kinds: dict[str, type[Visualizer]]  #: Visualizers by name, ours first.
    broken: tuple[str, ...]  #: One sentence for each that could not be loaded.


def available() -> Registry:
    """Return all visualizers that are installed now; one of ours is never replaced."""
    kinds = {kind.name: kind for kind in BUILT_IN}
    broken = []
    for entry in sorted(entry_points(group=GROUP), key=lambda e: (e.name, e.value)):
        kind = _load(entry)
        if isinstance(kind, str):
            broken.append(kind)
        elif (first := kinds.setdefault(kind.name, kind)) is not kind:
            broken.append(
                f"visualizer {entry.value!r}: the name {kind.name!r} is taken by {first!r}"
            )
    return Registry(kinds, tuple(broken))


def find(name: str) -> type[Visualizer]:
    """Return a visualizer by its name; InvalidValueError where none of that name is installed."""
    kinds = available().kinds
    if name not in kinds:
        raise InvalidValueError("visualizer", name, _listed(kinds))
    return kinds[name]


def _load(entry: EntryPoint) -> type[Visualizer] | str:
    """Return the class, or one sentence that says why there is none."""
    try:
        kind = entry.load()
    except Exception as error:  # noqa: BLE001 - foreign code may raise anything while it is imported
        return f"visualizer {entry.value!r}: cannot be loaded: {type(error).__name__}: {error}"
    if not (isinstance(kind, type) and issubclass(kind, Visualizer)):
        return f"visualizer {entry.value!r}: given {kind!r}, allowed is a class derived from Visualizer"
    if not isinstance(getattr(kind, "name", None), str) or not getattr(kind, "inputs", ()):
        return f"visualizer {entry.value!r}: it lacks a name or inputs"
    return kind


class Changed(Enum):
    """Kind of change of a display."""

    ADDED = "added"
    REMOVED = "removed"
    TUNED = "tuned"  #: A parameter, the rate, or whether it is on.
    REWIRED = "rewired"  #: Its QoS or synchronisation: what waited is gone.


@dataclass(slots=True, kw_only=True)
class Display:
    """One visualizer that looks at certain topics. Changed by its session only."""

    id: str  #: Unique in its session, stable.
    visualizer: Visualizer  #: Visualizer that draws.
    slot: Slot[Any]  #: Its queues.
    sync: SyncPolicy  #: Policy by which messages are matched.
    #: Requested instead of the inputs' own, by role.
    qos: dict[str, QoSProfile] = field(default_factory=dict)
    enabled: bool = True  #: Whether messages reach it.
    errors: int = 0  #: Updates that could not be shown.
    last_error: str = ""  #: Why the latest of these could not be.

    @property
    def inputs(self) -> tuple[tuple[Input, str, QoSProfile], ...]:
        """Each bound input with its topic and what is requested."""
        topics = self.visualizer.topics
        bound = [given for given in self.visualizer.inputs if given.role in topics]
        return tuple(
            (given, topics[given.role], self.qos.get(given.role, given.qos)) for given in bound
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Change:
    """Something that happened to a display."""

    what: Changed  #: Kind of change.
    display: Display  #: Display that changed, or was removed.


@dataclass(frozen=True, slots=True, kw_only=True)
class Offer:
    """A visualizer that could be added."""

    kind: str  #: Its name.
    topics: Mapping[str, str]  #: Topic by role.


class Session:
    """The displays; methods refuse, as an InvalidValueError, an id, role or value not there or not allowed."""

    def __init__(self) -> None:
        self._displays: dict[str, Display] = {}
        self._listeners: list[Callable[[Change], None]] = []
        self._count = 0

    @property
    def displays(self) -> tuple[Display, ...]:
        """All of them, in the order in which they were added."""
        return tuple(self._displays.values())

    def display(self, id_: str) -> Display:
        """Return a display."""
        if id_ not in self._displays:
            raise InvalidValueError("display", id_, _listed(self._displays))
        return self._displays[id_]

    def add(
        self,
        kind: str | type[Visualizer],
        topics: Mapping[str, str] | str,
        settings: Mapping[str, object] | None = None,
        *,
        qos: Mapping[str, QoSProfile] | None = None,
    ) -> Display:
        """Add a display of a visualizer or its name; a topic alone is the first role's, QoS goes by role."""
        kind = find(kind) if isinstance(kind, str) else kind
        topics = {kind.inputs[0].role: topics} if isinstance(topics, str) else topics
        visualizer = kind(topics, settings)
        self._count += 1
        display = Display(
            id=f"{kind.name}-{self._count}",
            visualizer=visualizer,
            slot=_slot(visualizer, kind.sync, kind.max_hz),
            sync=kind.sync,
            qos=dict(qos or {}),
        )
        self._displays[display.id] = display
        self._tell(Changed.ADDED, display)
        return display

    def remove(self, id_: str) -> None:
        """Remove a display; what it has drawn stays in the viewer's history."""
        display = self.display(id_)
        del self._displays[id_]
        self._tell(Changed.REMOVED, display)

    def tune(self, id_: str, name: str, value: object) -> None:
        """Set one parameter of a display."""
        display = self.display(id_)
        display.visualizer.tune(name, value)
        self._tell(Changed.TUNED, display)

    def limit(self, id_: str, max_hz: float | None) -> None:
        """Set the rate budget of a display; None lifts it."""
        display = self.display(id_)
        display.slot.budget.max_hz = max_hz
        self._tell(Changed.TUNED, display)

    def enable(self, id_: str, *, enabled: bool) -> None:
        """Switch a display on or off; what is off costs nothing and keeps its settings, not what waited."""
        display = self.display(id_)
        if display.enabled and not enabled:
            display.slot.interrupt()
        display.enabled = enabled
        self._tell(Changed.TUNED, display)

    def rewire(
        self,
        id_: str,
        *,
        qos: Mapping[str, QoSProfile] | None = None,
        sync: SyncPolicy | None = None,
    ) -> None:
        """Change a display's QoS, by role, or its policy, where given; what waited is gone."""
        display = self.display(id_)
        for role, profile in (qos or {}).items():
            if role not in display.visualizer.topics:
                raise InvalidValueError("role", role, _listed(display.visualizer.topics))
            display.qos[role] = profile
        display.sync = sync or display.sync
        display.slot = _slot(display.visualizer, display.sync, display.slot.budget.max_hz)
        self._tell(Changed.REWIRED, display)

    def offers(self, topics: Mapping[str, str]) -> tuple[Offer, ...]:
        """Return what could be added for topics, given type by topic, without what is shown already."""
        shown = {
            (d.visualizer.name, next(iter(d.visualizer.topics.values()))) for d in self.displays
        }
        found = []
        for kind in available().kinds.values():
            for topic in sorted(topics):
                bound = _bound(kind, topic, topics)
                if bound is not None and (kind.name, topic) not in shown:
                    found.append(Offer(kind=kind.name, topics=bound))
        return tuple(found)

    def listen(self, listener: Callable[[Change], None]) -> Callable[[], None]:
        """Call `listener` with every display that there is and every change; return what ends that."""
        self._listeners.append(listener)
        for display in self.displays:
            listener(Change(what=Changed.ADDED, display=display))
        return lambda: self._listeners.remove(listener)

    def _tell(self, what: Changed, display: Display) -> None:
        for listener in tuple(self._listeners):
            listener(Change(what=what, display=display))


def _slot(visualizer: Visualizer, sync: SyncPolicy, max_hz: float | None) -> Slot[Any]:
    topics = visualizer.topics
    steady = tuple(
        given.role for given in visualizer.inputs if given.steady and given.role in topics
    )
    return Slot(tuple(topics), policy=sync, max_hz=max_hz, queue=visualizer.queue, steady=steady)


def _bound(kind: type[Visualizer], topic: str, topics: Mapping[str, str]) -> dict[str, str] | None:
    """Return a topic for every input, led by the given one; None if one that is needed is not there."""
    leading, *others = kind.inputs
    if not leading.fits(topic, topics[topic]):
        return None
    bound = {leading.role: topic}
    for given in others:
        sibling = f"{topic.rpartition('/')[0]}/{given.sibling}"
        if given.sibling and given.fits(sibling, topics.get(sibling, "")):
            bound[given.role] = sibling
        elif not given.optional:
            return None
    return bound


def _listed(known: Iterable[str]) -> str:
    return ", ".join(sorted(known)) or "none"

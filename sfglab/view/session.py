"""Displays of a view, which are added, removed and tuned at run time, as in RViz's list of displays.

A package adds its own visualizers with entry points of the group ``sfglab.visualizers``. A visualizer that cannot
be loaded is reported and left out. A session knows which visualizers show which topics; `stage` delivers
messages to them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from importlib.metadata import EntryPoint, entry_points
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError
from sfglab.view.slot import Slot
from sfglab.view.visualizer import Input, Visualizer
from sfglab.view.visualizers import clouds, fleet, images, markers, poses

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping

    from sfglab.qos import QoSProfile

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
    poses.PoseStamped,
    poses.Path,
    poses.Odometry,
    markers.Marker,
    markers.MarkerArray,
    fleet.AgentStatus,
    fleet.AgentHeartbeats,
)
"""Visualizers of sfglab, in the order in which a session offers them for a topic."""


def installed_visualizers() -> tuple[dict[str, type[Visualizer]], list[str]]:
    """Return all visualizers by name, and a sentence for each one that is left out.

    A visualizer of another package cannot replace one of sfglab.
    """
    kinds = {kind.name: kind for kind in BUILT_IN}
    problems = []
    for entry in sorted(entry_points(group=GROUP), key=lambda e: (e.name, e.value)):
        try:
            _add_kind(entry, kinds)
        except Exception as error:  # noqa: BLE001 - foreign code may raise anything while it is imported
            problems.append(f"visualizer {entry.value!r}: {type(error).__name__}: {error}")
    return kinds, problems


def _add_kind(entry: EntryPoint, kinds: dict[str, type[Visualizer]]) -> None:
    kind = entry.load()
    if not (isinstance(kind, type) and issubclass(kind, Visualizer)):
        raise TypeError(f"{kind!r} is no class derived from Visualizer")
    if not kind.inputs:
        raise ValueError("it has no inputs; give it at least one")
    if kind.name in kinds:
        raise ValueError(f"the name {kind.name!r} is taken by {kinds[kind.name]!r}; choose another")
    kinds[kind.name] = kind


@dataclass(slots=True, kw_only=True)
class Display:
    """One visualizer with its topics, settings and counts. Only its session changes it."""

    id: str  #: Id, unique in the session and constant.
    visualizer: Visualizer  #: Visualizer that draws.
    slot: Slot[Any]  #: Queues of the display.
    #: QoS that is requested instead of the inputs' own, by role.
    qos: dict[str, QoSProfile] = field(default_factory=dict)
    enabled: bool = True  #: Whether the display receives messages.
    errors: int = 0  #: Number of updates that could not be shown.
    last_error: str = ""  #: Cause of the latest error; empty without one.

    @property
    def topics(self) -> dict[str, str]:
        """Topic of each bound input, by the input's role."""
        return self.visualizer.topics

    @property
    def inputs(self) -> list[tuple[Input, str, QoSProfile]]:
        """Each bound input with its topic and the requested QoS."""
        bound = [given for given in self.visualizer.inputs if given.role in self.topics]
        return [
            (given, self.topics[given.role], self.qos.get(given.role, given.qos)) for given in bound
        ]

    @property
    def counts(self) -> str:
        """Text with the numbers of received, shown and dropped messages, and of failures."""
        slot = self.slot
        text = f"{slot.received} received, {slot.shown} shown, {slot.dropped} dropped"
        return f"{text}; {self.errors} failed: {self.last_error}" if self.errors else text

    def fail(self, why: str) -> None:
        """Count an update that could not be shown, with the cause `why`."""
        self.errors += 1
        self.last_error = why


@dataclass(frozen=True, slots=True, kw_only=True)
class Offer:
    """A visualizer that can be added to a session, with its topics."""

    kind: str  #: Name of the visualizer.
    topics: Mapping[str, str]  #: Topic by role.


class Session:
    """The displays of a view, which are added, removed and tuned at run time.

    Raises:
        InvalidValueError: A method was given an id, a role, a name or a value that does not exist or is not allowed.
    """

    def __init__(self) -> None:
        #: Visualizers by name, those of sfglab first; and a sentence for each one that cannot be used.
        self.kinds, self.problems = installed_visualizers()
        self._displays: dict[str, Display] = {}
        self._listeners: dict[object, Callable[[], None]] = {}
        self._count = 0

    @property
    def displays(self) -> tuple[Display, ...]:
        """All displays, in the order in which they were added."""
        return tuple(self._displays.values())

    def display(self, id_: str) -> Display:
        """Return the display with an id."""
        if id_ not in self._displays:
            raise InvalidValueError("display", id_, _listed(self._displays))
        return self._displays[id_]

    def add(
        self,
        kind: str | type[Visualizer],
        topics: Mapping[str, str] | str,
        settings: Mapping[str, object] | None = None,
    ) -> Display:
        """Add a display and return it.

        Args:
            kind: Visualizer, or its name.
            topics: Topic by role, or the topic of the first role alone.
            settings: Values of parameters by name; the others have their defaults.
        """
        if isinstance(kind, str):
            if kind not in self.kinds:
                raise InvalidValueError("visualizer", kind, _listed(self.kinds))
            kind = self.kinds[kind]
        topics = {kind.inputs[0].role: topics} if isinstance(topics, str) else topics
        visualizer = kind(topics, settings)
        self._count += 1
        display = Display(
            id=f"{kind.name}-{self._count}",
            visualizer=visualizer,
            slot=Slot(visualizer, kind.max_hz),
        )
        self._displays[display.id] = display
        self._tell()
        return display

    def add_offer(self, offer: Offer) -> None:
        """Add a display of an offer; an error of the visualizer is appended to `problems`."""
        try:
            self.add(offer.kind, offer.topics)
        except Exception as error:  # noqa: BLE001 - a plug-in may raise any error
            self.problems.append(f"visualizer {offer.kind!r}: {type(error).__name__}: {error}")

    def remove(self, id_: str) -> None:
        """Remove a display; its drawn data stays in the viewer's history."""
        self.display(id_)
        del self._displays[id_]
        self._tell()

    def tune(self, id_: str, name: str, value: object) -> None:
        """Set one parameter of a display's visualizer by its name."""
        self.display(id_).visualizer.tune(name, value)

    def limit(self, id_: str, max_hz: float | None) -> None:
        """Set the rate budget of a display, updates per second; None for no limit."""
        if max_hz is not None and not 0 < max_hz < float("inf"):
            raise InvalidValueError("max_hz", max_hz, "positive numbers, or None for no limit")
        self.display(id_).slot.max_hz = max_hz

    def enable(self, id_: str, *, enabled: bool) -> None:
        """Enable or disable a display.

        A disabled display causes no work; it keeps its settings, and drops its waiting sets.
        """
        display = self.display(id_)
        if display.enabled and not enabled:
            display.slot.interrupt()
        display.enabled = enabled
        self._tell()

    def request(self, id_: str, role: str, profile: QoSProfile) -> None:
        """Change the QoS that a display requests for a role; waiting messages are dropped."""
        display = self.display(id_)
        if role not in display.topics:
            raise InvalidValueError("role", role, _listed(display.topics))
        display.qos[role] = profile
        display.slot = Slot(display.visualizer, display.slot.max_hz)
        self._tell()

    def offers(self, topics: Mapping[str, str]) -> tuple[Offer, ...]:
        """Return the visualizers that can be added for topics, given the ROS type by topic, and are not shown yet."""
        shown = {(d.visualizer.name, next(iter(d.topics.values()))) for d in self.displays}
        found = []
        for kind in self.kinds.values():
            for topic in sorted(topics):
                bound = _bound(kind, topic, topics)
                if bound is not None and (kind.name, topic) not in shown:
                    found.append(Offer(kind=kind.name, topics=bound))
        return tuple(found)

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call a function now and after each change, and return a function that stops this.

        Changes are added, removed, enabled and disabled displays, and changed QoS.
        """
        key = object()
        self._listeners[key] = listener
        listener()

        def end() -> None:
            self._listeners.pop(key, None)

        return end

    def _tell(self) -> None:
        for listener in tuple(self._listeners.values()):
            listener()


def _bound(kind: type[Visualizer], topic: str, topics: Mapping[str, str]) -> dict[str, str] | None:
    """Return a topic for each input of a visualizer, the given one first; None if a required topic is missing."""
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

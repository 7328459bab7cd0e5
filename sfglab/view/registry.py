"""Visualizers that there are: ours, and those of every installed package that offers some.

A package offers a class under an entry point of the group ``sfglab.visualizers``. One that cannot be loaded is
told and left out, so that somebody else's mistake costs nobody their view.
"""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from typing import NamedTuple

from sfglab.view.errors import SessionError
from sfglab.view.visualizer import Visualizer
from sfglab.view.visualizers.clouds import CompressedDepthCloud, DepthCloud, LaserScan, PointCloud
from sfglab.view.visualizers.fleet import AgentStatus, Communication
from sfglab.view.visualizers.images import (
    CameraModel,
    CompressedImage,
    CompressedImageVideo,
    FfmpegVideo,
    FoxgloveVideo,
    Image,
)
from sfglab.view.visualizers.markers import Marker, MarkerArray
from sfglab.view.visualizers.poses import Imu, Odometry, Path, Pose, StaticTransforms, Transforms

GROUP = "sfglab.visualizers"
"""The entry points' group."""

BUILT_IN: tuple[type[Visualizer], ...] = (
    Image,
    CompressedImage,
    CameraModel,
    FfmpegVideo,
    FoxgloveVideo,
    CompressedImageVideo,
    DepthCloud,
    CompressedDepthCloud,
    PointCloud,
    LaserScan,
    Transforms,
    StaticTransforms,
    Pose,
    Path,
    Odometry,
    Imu,
    Marker,
    MarkerArray,
    AgentStatus,
    Communication,
)
"""All of them, in the order in which they offer themselves for a topic."""


class Registry(NamedTuple):
    """Visualizers that were found."""

    kinds: dict[str, type[Visualizer]]  #: Visualizers by name, ours first.
    broken: tuple[str, ...]  #: What could not be loaded, one sentence each.


def available() -> Registry:
    """Return all visualizers that are installed now; one of ours is never replaced."""
    kinds = {kind.name: kind for kind in BUILT_IN}
    broken = []
    for entry in sorted(entry_points(group=GROUP), key=lambda e: (e.name, e.value)):
        kind = _load(entry)
        if isinstance(kind, str):
            broken.append(kind)
        elif kinds.setdefault(kind.name, kind) is not kind:
            broken.append(
                f"visualizer {entry.value!r}: the name {kind.name!r} is taken by {kinds[kind.name]!r}"
            )
    return Registry(kinds, tuple(broken))


def find(name: str) -> type[Visualizer]:
    """Return a visualizer by its name.

    Raises:
        SessionError: None of that name is installed.
    """
    kinds = available().kinds
    if name not in kinds:
        raise SessionError("visualizer", name, kinds)
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

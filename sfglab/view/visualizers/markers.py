"""Visualizers of markers: shapes with names, colours and lifetimes, which nodes publish for a viewer.

Source: visualization_msgs/msg/Marker and https://wiki.ros.org/rviz/DisplayTypes/Marker.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import InvalidValueError
from sfglab.messages import ns_from_stamp
from sfglab.qos import DEFAULT
from sfglab.view.rerunning import rr
from sfglab.view.visualizer import Canvas, Input, Parameter, Update, Visualizer
from sfglab.view.visualizers.poses import pose_of

if TYPE_CHECKING:
    from collections.abc import Callable

    from numpy.typing import NDArray

_ADD, _DELETE, _DELETE_ALL = 0, 2, 3
_ARROW, _CUBE, _SPHERE, _CYLINDER, _LINE_STRIP, _LINE_LIST = 0, 1, 2, 3, 4, 5
_CUBE_LIST, _SPHERE_LIST, _POINTS, _TEXT, _TRIANGLES = 6, 7, 8, 9, 11


class _Markers(Visualizer):
    """Base class: draws markers at ``<namespace>/<id>`` below its entity, and removes them after their lifetime."""

    max_hz = None
    queue = 100
    tick_hz = 10.0
    parameters = (Parameter("most", 1000, "markers shown at a time", minimum=1, maximum=100_000),)

    def __init__(self, *args: Any, **kwargs: Any) -> None:
        super().__init__(*args, **kwargs)
        self._shown: dict[str, tuple[int, float]] = {}  # type, and until when (ns)

    def show(self, update: Update, canvas: Canvas) -> None:
        """Draw or remove each marker; an error of one marker does not affect the others."""
        failed = None
        for marker in getattr(update.only, "markers", [update.only]):
            try:
                self._apply(marker, update, canvas)
            except InvalidValueError as error:
                failed = error
        if failed is not None:
            raise failed

    def tick(self, now_ns: int, canvas: Canvas) -> None:
        """Remove markers whose lifetime is over."""
        over = [entity for entity, (_, until_ns) in self._shown.items() if until_ns <= now_ns]
        for entity in over:
            self._clear(entity, canvas)

    def _apply(self, marker: Any, update: Update, canvas: Canvas) -> None:
        parts = self.entity, marker.ns.strip("/"), str(marker.id)
        entity = "/".join(filter(None, parts))
        if marker.action == _DELETE_ALL:
            for known in tuple(self._shown):
                self._clear(known, canvas)
        elif marker.action == _DELETE:
            self._clear(entity, canvas)
        elif marker.action == _ADD:
            self._draw(entity, marker, update, canvas)
        else:
            raise InvalidValueError(
                "marker action", marker.action, "0 (add), 2 (delete), 3 (delete all)"
            )

    def _draw(self, entity: str, marker: Any, update: Update, canvas: Canvas) -> None:
        draw = _SHAPES.get(marker.type)
        if draw is None:
            allowed = f"{', '.join(map(str, _SHAPES))}; meshes are not loaded"
            raise InvalidValueError("marker type", marker.type, allowed)
        shape = draw(marker)
        if entity in self._shown and self._shown[entity][0] != marker.type:
            self._clear(entity, canvas)
        self._shown.pop(entity, None)  # the entry then moves to the end, as the newest
        while len(self._shown) >= self["most"]:
            self._clear(next(iter(self._shown)), canvas)
        lifetime_ns = ns_from_stamp(marker.lifetime) or math.inf
        self._shown[entity] = marker.type, update.received_ns + lifetime_ns
        canvas.place(entity, marker.header.frame_id)
        canvas.log(entity, shape)

    def _clear(self, entity: str, canvas: Canvas) -> None:
        if self._shown.pop(entity, None) is not None:
            canvas.log(entity, rr.Clear(recursive=False))


class Marker(_Markers):
    """Messages with one marker (``visualization_msgs/msg/Marker``)."""

    name = "marker"
    inputs = (Input("marker", "visualization_msgs/msg/Marker", qos=DEFAULT),)


class MarkerArray(_Markers):
    """Messages with several markers (``visualization_msgs/msg/MarkerArray``)."""

    name = "marker_array"
    inputs = (Input("markers", "visualization_msgs/msg/MarkerArray", qos=DEFAULT),)


def _colors(marker: Any) -> NDArray[np.uint8]:
    """Return one colour per point if the marker has as many, otherwise the marker's own colour; shape (n, 4)."""
    given = marker.colors if len(marker.colors) == len(marker.points) else ()
    rgba = np.array([(c.r, c.g, c.b, c.a) for c in given or (marker.color,)])
    levels: NDArray[np.uint8] = (np.clip(np.nan_to_num(rgba), 0, 1) * 255).round().astype(np.uint8)
    return levels


def _points(marker: Any, scale: NDArray[np.float64] | float = 1.0) -> NDArray[np.float64]:
    """Return the marker's points in its frame, scaled and then moved by its pose, shape (N, 3)."""
    pose = pose_of(marker.pose)
    points = np.array([(p.x, p.y, p.z) for p in marker.points]).reshape(-1, 3) * scale
    matrix = pose.matrix()
    return np.asarray(points @ matrix[:3, :3].T + matrix[:3, 3])


def _scale(marker: Any) -> NDArray[np.float64]:
    return np.array([marker.scale.x, marker.scale.y, marker.scale.z])


def _arrow(marker: Any) -> Any:
    """Return an arrow along x of the pose with the length ``scale.x``, or from the first point to the second."""
    if len(marker.points) >= 2:
        start, end = _points(marker)[:2]
        radius = marker.scale.x / 2
    else:
        pose = pose_of(marker.pose)
        start, end = np.array([pose.position_m, pose.apply((marker.scale.x, 0.0, 0.0))])
        radius = marker.scale.y / 2
    colors = _colors(marker)[:1]
    return rr.Arrows3D(vectors=[end - start], origins=[start], radii=radius, colors=colors)


def _boxes(marker: Any) -> Any:
    sizes, placed = _instances(marker)
    return rr.Boxes3D(sizes=sizes, **placed)


def _spheres(marker: Any) -> Any:
    sizes, placed = _instances(marker)
    return rr.Ellipsoids3D(half_sizes=sizes / 2, **placed)


def _cylinder(marker: Any) -> Any:
    """Return a cylinder along z; Rerun's cylinder is round, so its diameter is the mean of both diameters."""
    ((x, y, z),), placed = _instances(marker)
    return rr.Cylinders3D(lengths=[z], radii=[(x + y) / 4], **placed)


def _instances(marker: Any) -> tuple[NDArray[Any], dict[str, Any]]:
    """Return the sizes of a marker's bodies, and their poses: one body at the pose, or a list with one per point."""
    pose = pose_of(marker.pose)
    is_list = marker.type in (_CUBE_LIST, _SPHERE_LIST)
    centers = _points(marker) if is_list else np.array([pose.position_m])
    placed = {
        "centers": centers,
        "quaternions": [pose.quat_xyzw] * len(centers),
        "colors": _colors(marker),
        "fill_mode": "solid",
    }
    return np.tile(_scale(marker), (len(centers), 1)), placed


def _line_strip(marker: Any) -> Any:
    points = _points(marker)
    strips = [points] if len(points) > 1 else []
    return rr.LineStrips3D(strips, radii=marker.scale.x / 2, colors=_colors(marker)[:1])


def _line_list(marker: Any) -> Any:
    points = _points(marker)
    pairs = points[: len(points) // 2 * 2].reshape(-1, 2, 3)
    colors = _colors(marker)[: 2 * len(pairs) : 2]
    return rr.LineStrips3D(pairs, radii=marker.scale.x / 2, colors=colors)


def _dots(marker: Any) -> Any:
    return rr.Points3D(_points(marker), radii=marker.scale.x / 2, colors=_colors(marker))


def _text(marker: Any) -> Any:
    position = pose_of(marker.pose).position_m
    shown = {"labels": [marker.text], "show_labels": True, "radii": 0.001}
    return rr.Points3D([position], colors=_colors(marker)[:1], **shown)


def _triangles(marker: Any) -> Any:
    """Return a mesh in which every three points, scaled by the marker's scale, are a triangle."""
    points = _points(marker, _scale(marker))
    if len(points) % 3:
        raise InvalidValueError("triangle list, points", len(points), "a multiple of 3")
    colors = np.broadcast_to(_colors(marker), (len(points), 4))
    return rr.Mesh3D(vertex_positions=points, vertex_colors=colors)


_SHAPES: dict[int, Callable[[Any], Any]] = {
    _ARROW: _arrow,
    _CUBE: _boxes,
    _SPHERE: _spheres,
    _CYLINDER: _cylinder,
    _LINE_STRIP: _line_strip,
    _LINE_LIST: _line_list,
    _CUBE_LIST: _boxes,
    _SPHERE_LIST: _spheres,
    _POINTS: _dots,
    _TEXT: _text,
    _TRIANGLES: _triangles,
}

"""Objects, ghosts and conflicts as nodes of viser's scene; `viewport` decides which are drawn again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.spatial.scene import model
from sfglab.spatial.scene.model import Box, Cylinder, Shape
from sfglab.units import NS_PER_S
from sfglab.view.planner import looks

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Mapping

    from sfglab.spatial.poses import Pose
    from sfglab.spatial.scene.conflicts import Conflict, Ghost
    from sfglab.spatial.scene.tree import Scene


_OBSTACLE: looks.Colour = (125, 130, 140)
_FORBIDDEN: looks.Colour = (214, 60, 60)
_INSIDE: looks.Colour = (70, 150, 90)
_CONFLICT: looks.Colour = (255, 20, 20)
_MOST_CONFLICTS = 20
_MOST_TIMES = 100
_LINE_PX = 3.0
_AXES_M = 0.22
_LIFT_M = 0.12
_MARK_M = 0.22


class Drawing:
    """Draws into the scene of a server; a node replaces the one of its name.

    Args:
        scene_api: The scene of viser's server.
        clicked: Returns the callback of a node, given a function from an event's instance index to the id of
            the object.
    """

    def __init__(self, scene_api: Any, clicked: Callable[[Callable[[Any], int]], Any]) -> None:
        self._api = scene_api
        self._clicked = clicked
        self._conflicts: list[Any] = []
        self._ghosts: dict[int, tuple[Any, Any]] = {}

    def floor(self, size_m: float) -> None:
        """Draw a grid at height zero."""
        self._api.add_grid(
            "/floor",
            size_m,
            size_m,
            cell_size=1.0,
            section_size=5.0,
            cell_color=(222, 225, 230),
            section_color=(190, 195, 205),
            fade_distance=4.0 * size_m,
        )

    def object(
        self, scene: Scene, id_: int, before: Mapping[str, Any], *, selected: bool
    ) -> list[Any]:
        """Draw an obstacle, zone or trajectory, a selected one broader and with times; return its nodes."""
        thing = scene.get(id_)
        if isinstance(thing, model.ObstacleObject):
            return [self._body(scene, id_, thing.shape, _OBSTACLE, 1.0)]
        if isinstance(thing, model.ZoneObject):
            forbidden = thing.rule is model.ZoneRule.FORBIDDEN
            nodes = [self._edges(scene, id_, thing.shape, _FORBIDDEN if forbidden else _INSIDE)]
            return nodes + (
                [self._body(scene, id_, thing.shape, _FORBIDDEN, 0.25)] if forbidden else []
            )
        if isinstance(thing, model.TrajectoryObject):
            nodes = self._trajectory(scene, thing, selected=selected)
            return nodes + (self._times(scene, thing, before) if selected else [])
        return []

    def ghosts(self, scene: Scene, ghosts: tuple[Ghost, ...], again: Collection[int] = ()) -> None:
        """Show each agent at the time of the slider; `again` has the ids of agents to draw again."""
        for id_ in self._ghosts.keys() - {ghost.agent for ghost in ghosts}:
            self._ghosts.pop(id_)[0].remove()
        self._make_ghosts(
            scene, [g for g in ghosts if g.agent in again or g.agent not in self._ghosts]
        )
        for ghost in ghosts:
            frame, label = self._ghosts[ghost.agent]
            frame.position, frame.wxyz = ghost.pose.position_m, looks.wxyz(ghost.pose)
            text = f"{ghost.name} {ghost.speed_m_s:.2f} m/s" if ghost.driving else ghost.name
            if label.text != text:
                label.text = text

    def conflicts(self, conflicts: tuple[Conflict, ...]) -> None:
        """Mark the places of conflicts."""
        for node in self._conflicts:
            node.remove()
        placed = [c for c in conflicts if c.position_m is not None][:_MOST_CONFLICTS]
        self._conflicts = [self._conflict(i, conflict) for i, conflict in enumerate(placed)]

    def _make_ghosts(self, scene: Scene, ghosts: list[Ghost]) -> None:
        colours = looks.agent_colours(scene)
        for ghost in ghosts:
            agent: model.AgentObject = scene.get(ghost.agent)  # type: ignore[assignment]
            name = f"/ghosts/{ghost.agent}"
            frame = self._api.add_frame(
                name,
                axes_length=1.5 * agent.radius_m,
                axes_radius=0.05 * agent.radius_m,
                position=ghost.pose.position_m,
                wxyz=looks.wxyz(ghost.pose),
            )
            body = self._api.add_icosphere(
                f"{name}/body", agent.radius_m, color=colours[ghost.agent], opacity=0.8
            )
            body.on_click(self._clicked(lambda _, id_=ghost.agent: id_))  # type: ignore[misc]
            label = self._api.add_label(
                f"{name}/label",
                ghost.name,
                position=(0.0, 0.0, -agent.radius_m - _LIFT_M),
                anchor="top-center",
            )
            self._ghosts[ghost.agent] = (frame, label)

    def _conflict(self, index: int, conflict: Conflict) -> Any:
        frame = self._api.add_frame(
            f"/conflicts/{index}", show_axes=False, position=conflict.position_m
        )
        self._api.add_icosphere(
            f"/conflicts/{index}/mark", _MARK_M, color=_CONFLICT, cast_shadow=False
        )
        self._api.add_label(
            f"/conflicts/{index}/label",
            f"⚠ {conflict.kind.value}"
            + ("" if conflict.time_s is None else f" {conflict.time_s:.1f} s"),
            position=(2.0 * _MARK_M, 0.0, 0.0),
            anchor="center-left",
        )
        return frame

    def _body(
        self, scene: Scene, id_: int, shape: Shape, colour: looks.Colour, opacity: float
    ) -> Any:
        pose = scene.world_pose(id_)
        name = f"/objects/{id_}/body"
        look = {
            "color": colour,
            "opacity": None if opacity == 1.0 else opacity,
            "position": pose.position_m,
            "wxyz": looks.wxyz(pose),
            "cast_shadow": opacity == 1.0,
        }
        if isinstance(shape, Box):
            node = self._api.add_box(name, dimensions=shape.size_m, **look)
        elif isinstance(shape, Cylinder):
            node = self._api.add_cylinder(name, shape.radius_m, shape.height_m, **look)
        else:
            node = self._api.add_icosphere(name, shape.radius_m, **look)
        node.on_click(self._clicked(lambda _: id_))
        return node

    def _edges(self, scene: Scene, id_: int, shape: Shape, colour: looks.Colour) -> Any:
        pose = scene.world_pose(id_)
        return self._lines(
            f"/objects/{id_}/edges", looks.outline_of(shape), np.array(colour), 1.5, pose
        )

    def _trajectory(
        self, scene: Scene, thing: model.TrajectoryObject, *, selected: bool
    ) -> list[Any]:
        path = scene.world_trajectory(thing.id)
        if path is None:
            return []
        name = f"/objects/{thing.id}"
        colour = looks.NOBODY if thing.agent is None else looks.agent_colours(scene)[thing.agent]
        points = looks.line_of(path)
        width = 2.0 * _LINE_PX if selected else _LINE_PX
        nodes = (
            [self._lines(f"{name}/line", points, looks.linear(colour), width)]
            if len(points)
            else []
        )
        held = scene.held_by(thing.id)
        axes = self._api.add_batched_axes(
            f"{name}/waypoints",
            np.array([looks.wxyz(w.pose) for w in path.waypoints]),
            np.array([w.pose.position_m for w in path.waypoints]),
            axes_length=_AXES_M,
            axes_radius=_AXES_M / 10.0,
        )
        axes.on_click(self._clicked(lambda index: held[index or 0]))
        return [*nodes, axes]

    def _times(
        self, scene: Scene, thing: model.TrajectoryObject, before: Mapping[str, Any]
    ) -> list[Any]:
        held = scene.held_by(thing.id)[:_MOST_TIMES]
        return [self._time(scene, scene.of_kind(id_, model.WaypointObject), before) for id_ in held]

    def _time(self, scene: Scene, waypoint: model.WaypointObject, before: Mapping[str, Any]) -> Any:
        """Label a waypoint; an existing label is moved, because there may be many and only one is dragged."""
        name = f"/objects/{waypoint.parent}/time {waypoint.id}"
        text = f"{waypoint.time_ns / NS_PER_S:g} s"
        position = scene.world_pose(waypoint.id).position_m
        label = before.get(name)
        if label is None:
            return self._api.add_label(
                name, text, position=position, anchor="center-right", font_screen_scale=0.8
            )
        if label.text != text:
            label.text = text
        if tuple(label.position) != position:
            label.position = position
        return label

    def _lines(
        self, name: str, points: Any, colours: Any, width_px: float, pose: Pose | None = None
    ) -> Any:
        where = {} if pose is None else {"position": pose.position_m, "wxyz": looks.wxyz(pose)}
        return self._api.add_line_segments(
            name, points, colours, thickness=width_px, thickness_units="screen", **where
        )

"""The viewport: draws the objects of a change again, and only these; a click selects an object.

The gizmo is at the selected object. One drag with it is one step that can be undone.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.editor import Change, ChangeKind
from sfglab.spatial.scene.model import AgentObject, Group, TrajectoryObject, WaypointObject
from sfglab.spatial.trajectory.path import Align
from sfglab.view.planner.context import Context, Part
from sfglab.view.planner.drawing import Drawing
from sfglab.view.planner.looks import camera_for, open_trajectory, wxyz

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable

    from sfglab.spatial.scene.conflicts import Conflict
    from sfglab.spatial.scene.tree import Scene

_SCALE = 1.6


class Gizmo:
    """Transform controls at the object that was selected last."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._on: tuple[int, bool] | None = None
        self._handle: Any = None
        self._dragging = False

    def show(self) -> None:
        """Move to the last selected object, except during a drag."""
        editor = self._context.editor
        on = None
        if editor.selection:
            thing = editor.scene.get(editor.selection[-1])
            on = (thing.id, isinstance(thing, WaypointObject) and thing.align is not Align.NONE)
        if on != self._on:
            self._change(on)
        if on is not None and not self._dragging:
            pose = editor.scene.world_pose(on[0])
            self._handle.position, self._handle.wxyz = pose.position_m, wxyz(pose)

    def drop(self) -> None:
        """End the drag of a browser that disconnected."""
        if self._dragging:
            self._dragging = False
            self._context.editor.end_drag()
            self.show()

    def _change(self, on: tuple[int, bool] | None) -> None:
        if self._dragging:
            self._dragging = False
            self._context.editor.end_drag()
        if self._handle is not None:
            self._handle.remove()
            self._handle = None
        self._on = on
        if on is None:
            return
        pose = self._context.editor.scene.world_pose(on[0])
        self._handle = self._context.server.scene.add_transform_controls(
            f"/gizmo/{on[0]}",
            scale=_SCALE,
            disable_rotations=on[1],
            depth_test=False,
            position=pose.position_m,
            wxyz=wxyz(pose),
            translation_limits=((-1e6, 1e6),) * 3,
        )
        self._handle.on_update(self._follow(on[0]))

    def _follow(self, id_: int) -> Any:
        jobs = self._context.jobs

        async def moved(event: Any) -> None:
            if event.phase == "start":
                jobs.submit(lambda: self._start(id_))
            elif event.phase == "end":
                jobs.submit(lambda: self._end(id_))
            else:
                w, x, y, z = (float(c) for c in event.target.wxyz)
                place = [float(c) for c in event.target.position]
                jobs.submit(
                    lambda: self._place(id_, Pose.at(place, (x, y, z, w))), key=("gizmo", id_)
                )

        return moved

    def _start(self, id_: int) -> None:
        if self._on is not None and self._on[0] == id_:
            self._dragging = True
            self._context.editor.begin_drag()

    def _place(self, id_: int, pose: Pose) -> None:
        if self._dragging and self._on is not None and self._on[0] == id_:
            self._context.editor.place(id_, pose)

    def _end(self, id_: int) -> None:
        if self._on is not None and self._on[0] == id_:
            self.drop()


_FLOOR_M = 40.0


def concerned(scene: Scene, change: Change) -> set[int]:
    """Return the ids of objects to draw again: the changed ones, and those that move with them."""
    found = {*change.added, *change.changed} & scene.objects.keys()
    for id_ in tuple(found):
        thing = scene.get(id_)
        if isinstance(thing, Group | TrajectoryObject):
            found |= {held.id for held in scene.walk(id_)}
        elif isinstance(thing, AgentObject):
            driven = scene.driven_by(id_)
            found |= {driven.id} if driven is not None else set()
    return {scene.get(i).parent if isinstance(scene.get(i), WaypointObject) else i for i in found}


class Viewport(Part):
    """The 3D view."""

    def __init__(self, context: Context, container: Any) -> None:
        super().__init__(context, container)
        self._drawing = Drawing(context.server.scene, self._clicked)
        self._gizmo = Gizmo(context)
        self._nodes: dict[int, list[Any]] = {}
        self._open: int | None = None
        self._agents: frozenset[int] = frozenset()
        self._drawing.floor(_FLOOR_M)
        context.server.on_client_disconnect(lambda _: context.jobs.submit(self._gizmo.drop))
        self._look()
        self._draw_all()

    def show(self, change: Change) -> None:
        """Draw the objects of a change again."""
        if change.kind is ChangeKind.SAVE:
            return
        with self._context.server.atomic():
            if change.kind is ChangeKind.LOAD:
                self._look()
                self._draw_all()
            elif change.kind is ChangeKind.TIME:
                self._ghosts()
            else:
                self._draw_change(change)

    def found(self, conflicts: tuple[Conflict, ...]) -> None:
        """Mark where conflicts are."""
        with self._context.server.atomic():
            self._drawing.conflicts(conflicts)

    def _draw_change(self, change: Change) -> None:
        editor = self._context.editor
        scene = editor.scene
        agents = frozenset(agent.id for agent in scene.all_of(AgentObject))
        if agents != self._agents:  # colours go by rank
            self._draw_all()
            return
        for id_ in change.removed:
            self._erase(id_)
        opened = open_trajectory(scene, editor.selection)
        again = (self._open, opened) if opened != self._open else ()
        self._open = opened
        self._draw(
            concerned(scene, change) | {i for i in again if i is not None and i in scene.objects}
        )
        if change.added or change.removed or change.changed:
            self._ghosts(again=change.changed)
        self._gizmo.show()

    def _draw_all(self) -> None:
        editor = self._context.editor
        for id_ in self._nodes.keys() - editor.scene.objects.keys():
            self._erase(id_)
        self._agents = frozenset(agent.id for agent in editor.scene.all_of(AgentObject))
        self._open = open_trajectory(editor.scene, editor.selection)
        self._draw(editor.scene.objects)
        self._ghosts(again=self._agents)
        self._gizmo.show()

    def _draw(self, ids: Iterable[int]) -> None:
        scene = self._context.editor.scene
        for id_ in tuple(ids):
            before = {node.name: node for node in self._nodes.pop(id_, ())}
            nodes = self._drawing.object(scene, id_, before, selected=id_ == self._open)
            if nodes:
                self._nodes[id_] = nodes
            for name in before.keys() - {node.name for node in nodes}:
                before[name].remove()

    def _erase(self, id_: int) -> None:
        for node in self._nodes.pop(id_, ()):
            node.remove()

    def _ghosts(self, again: Collection[int] = ()) -> None:
        self._drawing.ghosts(self._context.editor.scene, self._context.editor.ghosts(), again)

    def _look(self) -> None:
        camera = self._context.server.initial_camera
        camera.position, camera.look_at = camera_for(self._context.editor.scene)

    def _clicked(self, of: Callable[[Any], int]) -> Any:
        def select(index: Any) -> None:
            id_ = of(index)
            if id_ in self._context.editor.scene.objects:
                self._context.editor.select(id_)

        return self._context.on(select, read=lambda event: event.instance_index)

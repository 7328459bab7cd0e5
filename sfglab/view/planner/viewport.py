"""The viewport: draws the scene, the ghosts and the conflicts; a click selects an object.

The gizmo is at the selected object. One drag with it is one step that can be undone.
"""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.editor import Change
from sfglab.spatial.scene.model import WaypointObject
from sfglab.spatial.trajectory.path import Align
from sfglab.view.planner.context import Context, Part
from sfglab.view.planner.drawing import (
    Look,
    Looks,
    add_floor,
    looks_of_conflicts,
    looks_of_ghosts,
    looks_of_objects,
)
from sfglab.view.planner.looks import camera_for, open_trajectory, wxyz

if TYPE_CHECKING:
    from sfglab.spatial.scene.conflicts import Conflict

_SCALE = 1.6


class Gizmo:
    """Transform controls at the object that was selected last."""

    def __init__(self, context: Context) -> None:
        self._context = context
        self._on: tuple[int, bool] | None = None
        self._handle: Any = None
        self._client: int | None = None  # the browser that drags

    def show(self) -> None:
        """Move to the last selected object, except during a drag."""
        editor = self._context.editor
        on = None
        if editor.selection:
            thing = editor.scene.get(editor.selection[-1])
            on = (thing.id, isinstance(thing, WaypointObject) and thing.align is not Align.NONE)
        if on != self._on:
            self._change(on)
        if on is not None and self._client is None:
            put(self._handle, editor.scene.world_pose(on[0]))

    def drop(self, client: int) -> None:
        """End the drag of a browser, if any; the browser may have disconnected."""
        if self._client == client:
            self._end_drag()
            self.show()

    def _end_drag(self) -> None:
        if self._client is not None:
            self._client = None
            self._context.editor.end_drag()

    def _change(self, on: tuple[int, bool] | None) -> None:
        self._on = on
        self._end_drag()
        if self._handle is not None:
            self._handle.remove()
            self._handle = None
        if on is not None:
            id_, is_aligned = on
            self._handle = self._context.server.scene.add_transform_controls(
                f"/gizmo/{id_}",
                scale=_SCALE,
                disable_rotations=is_aligned,
                depth_test=False,
                translation_limits=((-1e6, 1e6),) * 3,
            )
            self._handle.on_update(self._follow(id_))

    def _follow(self, id_: int) -> Any:
        jobs = self._context.jobs

        async def moved(event: Any) -> None:
            client, phase = event.client_id, event.phase
            place = event.target.position, event.target.wxyz
            key = ("gizmo", id_, client) if phase == "update" else None
            jobs.submit(lambda: self._moved(id_, client, phase, place), key=key)

        return moved

    def _moved(self, id_: int, client: int, phase: str, place: Any) -> None:
        if self._on is None or self._on[0] != id_:
            return
        if phase == "start" and self._client is None:
            self._client = client
            self._context.editor.begin_drag()
        elif phase == "end":
            self.drop(client)
        elif phase == "update" and self._client == client:
            position, (w, x, y, z) = place
            self._context.editor.place(id_, Pose.at(position, (x, y, z, w)))


class Layer:
    """Nodes of viser that are shown together; only changed nodes are created again."""

    def __init__(self, context: Context) -> None:
        self.nodes: dict[str, Any] = {}  #: Nodes by name.
        self._context = context
        self._looks: Looks = {}

    def show(self, looks: Looks) -> None:
        """Show these nodes and no others."""
        for name in self.nodes.keys() - looks.keys():
            self._looks.pop(name, None)
            self.nodes.pop(name).remove()
        for name, look in looks.items():
            shown = self._looks.pop(name, None)  # after an error the node is made again
            if shown != look:
                shown = None
                self._add(name, look)
            node = self.nodes[name]
            if shown is None or shown.pose != look.pose:
                put(node, look.pose)
            if look.text and (shown is None or shown.text != look.text):
                node.text = look.text
            self._looks[name] = look

    def _add(self, name: str, look: Look) -> None:
        node = look.add(self._context.server.scene, name, *look.values)
        self.nodes[name] = node
        if look.ids:
            clicked = self._context.on(
                lambda index: self._select(look.ids[index or 0]),
                read=lambda event: event.instance_index,
            )
            node.on_click(clicked)

    def _select(self, id_: int) -> None:
        editor = self._context.editor
        if id_ in editor.scene.objects:
            editor.select(id_)


class Viewport(Part):
    """3D view of the scene, in which objects can be selected and moved."""

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._gizmo = Gizmo(context)
        self._objects = Layer(context)
        self._ghosts = Layer(context)
        self._conflicts = Layer(context)
        add_floor(context.server.scene)
        context.server.on_client_disconnect(
            lambda client: context.jobs.submit(partial(self._gizmo.drop, client.client_id))
        )
        self.show(Change.LOAD)

    def show(self, change: Change) -> None:
        """Draw the differences after a change."""
        if change is Change.SAVE:
            return
        editor, scene = self._editor, self._editor.scene
        if change is Change.LOAD:
            camera = self._context.server.initial_camera
            camera.position, camera.look_at = camera_for(scene)
        with self._context.server.atomic():
            if change is not Change.TIME:
                opened = open_trajectory(scene, editor.selection)
                self._objects.show(looks_of_objects(scene, opened))
                self._gizmo.show()
            self._ghosts.show(looks_of_ghosts(scene, editor.ghosts()))

    def found(self, conflicts: tuple[Conflict, ...]) -> None:
        """Draw a mark at the place of each conflict."""
        with self._context.server.atomic():
            self._conflicts.show(looks_of_conflicts(conflicts))


def put(node: Any, pose: Pose) -> None:
    """Move a node of viser's scene to a pose."""
    node.position, node.wxyz = pose.position_m, wxyz(pose)

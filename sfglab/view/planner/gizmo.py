"""The gizmo on what is selected: one drag with it is one step that can be undone."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.spatial.poses import Pose
from sfglab.spatial.scene import WaypointObject
from sfglab.spatial.trajectory import Align
from sfglab.view.planner.looks import wxyz

if TYPE_CHECKING:
    from sfglab.view.planner.bench import Bench


_SCALE = 1.6


class Gizmo:
    """The transform controls, where one object is selected.

    Args:
        bench: What it works with.
    """

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._on: tuple[int, bool] | None = None
        self._handle: Any = None
        self._dragging = False

    def show(self) -> None:
        """Stand on the last selected object; while somebody drags, stay under their hand."""
        editor = self._bench.editor
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
        """End a drag whose browser is gone."""
        if self._dragging:
            self._dragging = False
            self._bench.editor.end_drag()
            self.show()

    def _change(self, on: tuple[int, bool] | None) -> None:
        if self._dragging:
            self._dragging = False
            self._bench.editor.end_drag()
        if self._handle is not None:
            self._handle.remove()
            self._handle = None
        self._on = on
        if on is None:
            return
        pose = self._bench.editor.scene.world_pose(on[0])
        self._handle = self._bench.server.scene.add_transform_controls(
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
        desk = self._bench.desk

        async def moved(event: Any) -> None:
            if event.phase == "start":
                desk.submit(lambda: self._start(id_))
            elif event.phase == "end":
                desk.submit(lambda: self._end(id_))
            else:
                w, x, y, z = (float(c) for c in event.target.wxyz)
                place = [float(c) for c in event.target.position]
                desk.submit(lambda: self._place(id_, Pose.at(place, (x, y, z, w))), key=("gizmo", id_))

        return moved

    def _start(self, id_: int) -> None:
        if self._on is not None and self._on[0] == id_:
            self._dragging = True
            self._bench.editor.begin_drag()

    def _place(self, id_: int, pose: Pose) -> None:
        if self._dragging and self._on is not None and self._on[0] == id_:
            self._bench.editor.place(id_, pose)

    def _end(self, id_: int) -> None:
        if self._on is not None and self._on[0] == id_:
            self.drop()

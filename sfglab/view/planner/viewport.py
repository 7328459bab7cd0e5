"""The viewport: redraws what a change concerns, and only that; a click on something selects it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.spatial.scene import AgentObject, ChangeKind, Group, TrajectoryObject, WaypointObject
from sfglab.view.planner.drawing import Drawing
from sfglab.view.planner.gizmo import Gizmo
from sfglab.view.planner.looks import camera_for
from sfglab.view.planner.rows import open_trajectory

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterable

    from sfglab.spatial.scene import Change, Conflict, Scene
    from sfglab.view.planner.bench import Bench


_FLOOR_M = 40.0


def concerned(scene: Scene, change: Change) -> set[int]:
    """Return whose drawing a change concerns: what changed, who shows it, and what moves with it."""
    found = {*change.added, *change.changed} & scene.objects.keys()
    for id_ in tuple(found):
        thing = scene.get(id_)
        if isinstance(thing, Group | TrajectoryObject):
            found |= {held.id for held in scene.walk(id_)}
        elif isinstance(thing, AgentObject):
            driven = scene.driven_by(id_)
            found |= {driven.id} if driven is not None else set()
    return {scene.get(i).parent if isinstance(scene.get(i), WaypointObject) else i for i in found}


class Viewport:
    """What is seen in 3D.

    Args:
        bench: What it works with.
        container: A context that widgets are put into.
    """

    def __init__(self, bench: Bench, container: Any) -> None:
        self._bench = bench
        self._drawing = Drawing(bench.server.scene, self._clicked)
        self._gizmo = Gizmo(bench)
        self._nodes: dict[int, list[Any]] = {}
        self._open: int | None = None
        self._agents: frozenset[int] = frozenset()
        self._drawing.floor(_FLOOR_M)
        with container:
            colours = bench.server.gui.add_dropdown("paths by", ("agent", "speed"))
        colours.on_update(bench.on(self._colour, read=lambda event: event.target.value))
        bench.server.on_client_disconnect(lambda _: bench.desk.submit(self._gizmo.drop))
        self._look()
        self._draw_all()

    def show(self, change: Change) -> None:
        """Redraw what a change concerns."""
        if change.kind is ChangeKind.SAVE:
            return
        with self._bench.server.atomic():
            if change.kind is ChangeKind.LOAD:
                self._look()
                self._draw_all()
            elif change.kind is ChangeKind.TIME:
                self._ghosts()
            else:
                self._draw_change(change)

    def found(self, conflicts: tuple[Conflict, ...]) -> None:
        """Mark where conflicts are."""
        with self._bench.server.atomic():
            self._drawing.conflicts(conflicts)

    def _draw_change(self, change: Change) -> None:
        editor = self._bench.editor
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
        self._draw(concerned(scene, change) | {i for i in again if i is not None and i in scene.objects})
        if change.added or change.removed or change.changed:
            self._ghosts(again=change.changed)
        self._gizmo.show()

    def _draw_all(self) -> None:
        editor = self._bench.editor
        for id_ in self._nodes.keys() - editor.scene.objects.keys():
            self._erase(id_)
        self._agents = frozenset(agent.id for agent in editor.scene.all_of(AgentObject))
        self._open = open_trajectory(editor.scene, editor.selection)
        self._draw(editor.scene.objects)
        self._ghosts(again=self._agents)
        self._gizmo.show()

    def _draw(self, ids: Iterable[int]) -> None:
        scene = self._bench.editor.scene
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
        self._drawing.ghosts(self._bench.editor.scene, self._bench.editor.ghosts(), again)

    def _look(self) -> None:
        camera = self._bench.server.initial_camera
        camera.position, camera.look_at = camera_for(self._bench.editor.scene)

    def _colour(self, by: str) -> None:
        self._drawing.by_speed = by == "speed"
        self._draw([t.id for t in self._bench.editor.scene.all_of(TrajectoryObject)])

    def _clicked(self, of: Callable[[Any], int]) -> Any:
        def select(index: Any) -> None:
            id_ = of(index)
            if id_ in self._bench.editor.scene.objects:
                self._bench.editor.select(id_)

        return self._bench.on(select, read=lambda event: event.instance_index)

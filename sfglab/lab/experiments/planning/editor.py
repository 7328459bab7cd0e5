"""The scene editor in a cell of a notebook: its page while a kernel runs, otherwise an image of the scene.

The editor works on a copy below ``runs/``, so the scenes of the repository do not change.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.explore.press import still_bundle
from sfglab.lab.figures import drawn, png_of
from sfglab.lab.paths import find_project
from sfglab.spatial.scene.editor import Editor
from sfglab.spatial.scene.files import load_scene
from sfglab.view.planner.server import Planner
from sfglab.view.widgets import widgets

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SIZE = (9.0, 5.6)


class SceneCell:
    """A scene of the data folder from above, in its editor; *Save* writes a copy below ``runs/``.

    Raises:
        SceneError: The file is no scene file.
        MissingExtraError: The extra ``view`` is not installed.
    """

    def __init__(self, name: str = "scenes/hall.yaml") -> None:
        project = find_project()
        file = project.runs / name
        file.parent.mkdir(parents=True, exist_ok=True)
        #: Server of the editor: `call` edits from Python, `close` ends the server.
        self.planner = Planner(Editor(load_scene(project.data / name), file=file))
        self.widget = widgets().HTML(self.planner._repr_html_())  #: Widget of the cell.

    def __repr__(self) -> str:
        return f"<scene editor: {self.planner.call(lambda editor: editor.scene.name)}>"

    def _repr_mimebundle_(self, **_: object) -> tuple[dict[str, Any], dict[str, Any]]:
        data, metadata = still_bundle(self.widget, png_of(drawn(_SIZE, self._draw)), type(self))
        return data | {"text/plain": repr(self)}, metadata

    def _draw(self, figure: Figure) -> None:
        from sfglab.lab.experiments.planning.results import draw_from_above

        scene = self.planner.call(lambda editor: editor.scene)
        axes = figure.subplots()
        draw_from_above(axes, scene)
        axes.set_title(f"{scene.name} from above: run this cell to edit it here, or: sfglab plan")

"""Screenshots for the documentation, made from what is in the repository: ``make screenshots``.

The scene editor of paper A, section 4.5 (Fig. 7), with the hall's plan changed so that there is a conflict to
see. Refuses to know the editor's panels.
"""

from __future__ import annotations

import sys
import time
from pathlib import Path
from typing import TYPE_CHECKING

import cv2

from sfglab.lab.browser import Browser
from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.commands import SetPose, Several, Stretch
from sfglab.spatial.scene.editor import Editor
from sfglab.spatial.scene.objects import SceneError
from sfglab.view.planner.server import Planner

if TYPE_CHECKING:
    from sfglab.spatial.scene.tree import Scene


_SIZE = (1400, 800)
_TIME_S = 3.2
_SETTLED_S = 3.0
_CLOSE_NOTE = "document.querySelector('.mantine-Notification-closeButton')?.click()"
_DRONE_PATH, _DRONE_ACROSS, _DRONE_LAST, _LOW_M = 14, 17, 18, 0.6


def main(folder: Path) -> None:
    """Make all screenshots."""
    folder.mkdir(parents=True, exist_ok=True)
    planner_editor(Path("data/scenes/hall.yaml"), folder / "planner_editor.png")


def planner_editor(scene: Path, file: Path) -> None:
    """Write what the editor shows of a scene, its conflict included, into a PNG file."""
    if not scene.exists():
        raise SceneError("scene", str(scene), "a scene file; run this in the repository's own folder")
    with Planner(Editor.open(scene), port=0) as planner, Browser(*_SIZE) as browser:
        planner.call(with_conflict)
        browser.open(planner.url)
        browser.find("Save *")
        browser.evaluate(_CLOSE_NOTE)
        browser.wait_for("document.body.innerText.includes('conflict')")
        time.sleep(_SETTLED_S)  # panels slide in, and the first frame is drawn in software
        browser.screenshot(file)
    _shrink(file)


def with_conflict(editor: Editor) -> Scene:
    """Let the drone cross later and lower, where the dog then is; select its last waypoint."""
    place = editor.scene.get(_DRONE_ACROSS).pose
    x, y, _ = place.position_m
    low = Pose(position_m=(x, y, _LOW_M), quat_xyzw=place.quat_xyzw)
    later = Stretch(id=_DRONE_PATH, factor=2.1)
    editor.do(Several(commands=(later, SetPose(id=_DRONE_ACROSS, pose=low)), label="Cross later"))
    editor.select(_DRONE_LAST)
    editor.set_time(_TIME_S)
    return editor.scene


def _shrink(file: Path) -> None:
    """Write a PNG again as small as it gets without loss."""
    image = cv2.imread(str(file))
    assert image is not None  # it was written a moment ago
    cv2.imwrite(str(file), image, [cv2.IMWRITE_PNG_COMPRESSION, 9])


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("figures"))

"""The scene editor as people have it: in a real browser, with a mouse, until the file on disk."""

from contextlib import closing

import pytest
from machine import open_browser
from pixels import CAMERA, pixel
from seen import edited

from sfglab.spatial.scene.editor import Editor
from sfglab.spatial.scene.files import load_scene
from sfglab.view.planner.server import Planner

pytestmark = [pytest.mark.live, pytest.mark.browser]

CANVAS = """(() => { const r = document.querySelector('canvas').getBoundingClientRect();
  return [r.x, r.y, r.width, r.height]; })()"""


@pytest.fixture(scope="module")
def browser():
    with closing(open_browser(1000, 620)) as made:
        yield made


def delete_key(browser):
    key = {"key": "Delete", "code": "Delete", "windowsVirtualKeyCode": 46}
    browser.call("Input.dispatchKeyEvent", type="keyDown", **key)
    browser.call("Input.dispatchKeyEvent", type="keyUp", **key)


def place(planner, browser, point):
    """Where a point of the scene is on the page, by the camera that the browser reports."""
    camera = next(iter(planner._server.get_clients().values())).camera
    return pixel(eval(CAMERA, {"c": camera}), browser.evaluate(CANVAS), point)  # noqa: S307 - it is our own


def test_a_trajectory_is_made_dragged_undone_redone_and_saved_with_mouse_and_keys(
    tmp_path, browser
):
    file = tmp_path / "new.yaml"
    with Planner(Editor.open(file)) as planner:
        browser.open(planner.url)
        browser.press("trajectory")
        waypoint = edited(planner, lambda e: e.scene.objects and e.scene.held_by(1)[1])
        browser.press(f"2.00 s #{waypoint}")
        edited(planner, lambda e: e.selection == (waypoint,))
        made = planner.call(lambda e: e.scene)

        browser.find(f"waypoint: 2.00 s #{waypoint}", "legend, label, button, p, div")
        arrow = (2.0, 0.0, 1.4)
        browser.drag(place(planner, browser, arrow), place(planner, browser, (2.0, 0.0, 2.4)))
        browser.find("Undo: Change pose")
        moved = edited(planner, lambda e: not e._drag and e.scene)
        x, y, z = moved.world_pose(waypoint).position_m
        assert (x, y) == pytest.approx((2.0, 0.0), abs=1e-6)
        assert z == pytest.approx(1.0, abs=0.1)

        browser.press("Undo: Change pose")
        edited(planner, lambda e: e.scene == made)
        browser.press("Redo: Change pose")
        edited(planner, lambda e: e.scene == moved)
        browser.press("Save *")
        edited(planner, lambda e: not e.dirty)
        assert load_scene(file) == moved

        browser.evaluate("document.querySelector('input[type=text]').focus()")
        delete_key(browser)
        assert planner.call(lambda e: e.scene) == moved
        browser.evaluate("document.activeElement.blur()")
        delete_key(browser)
        edited(planner, lambda e: waypoint not in e.scene.objects)
        browser.open(planner.url)  # as a second browser does
        browser.find("Undo: Remove")
        browser.find("trajectory 1 #1")

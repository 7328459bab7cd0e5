"""The scene editor as people have it: in a real browser, with a mouse, until the file on disk."""

import os
from contextlib import closing
from functools import partial

import pytest
from machine import open_browser
from pixels import CAMERA, pixel
from seen import at_work, edited

from sfglab.bus import Node
from sfglab.lab.browser import Browser
from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.editor import Editor
from sfglab.spatial.scene.files import load_scene
from sfglab.spatial.trajectory.path import Trajectory
from sfglab.view.planner.server import Planner

pytestmark = [pytest.mark.live, pytest.mark.browser]

CANVAS = """(() => { const r = document.querySelector('canvas').getBoundingClientRect();
  return [r.x, r.y, r.width, r.height]; })()"""


@pytest.fixture(scope="module")
def browser():
    with closing(open_browser(1200, 700)) as made:
        yield made


@pytest.fixture
def planner(tmp_path):
    with Planner(Editor.open(tmp_path / "new.yaml"), port=0) as made:
        yield made


def place(planner, browser, point):
    """Where a point of the scene is on the page, by the camera that the browser reports."""
    camera = next(iter(planner._server.get_clients().values())).camera
    return pixel(eval(CAMERA, {"c": camera}), browser.evaluate(CANVAS), point)  # noqa: S307 - it is our own


def test_a_trajectory_is_made_dragged_undone_redone_saved_and_loaded_with_the_mouse(
    planner, browser
):
    file = planner.call(lambda editor: editor.file)
    browser.open(planner.url)
    browser.press("trajectory")
    waypoint = edited(planner, lambda e: e.scene.objects and e.scene.held_by(1)[1])
    browser.press(f"2.00 s #{waypoint}")
    edited(planner, lambda e: e.selection == (waypoint,))
    made = planner.call(lambda e: e.scene)
    assert made.world_pose(waypoint).position_m == (2.0, 0.0, 0.0)

    browser.find(f"waypoint: 2.00 s #{waypoint}", "legend, label, button, p, div")
    arrow = (2.0, 0.0, 1.4)
    browser.drag(place(planner, browser, arrow), place(planner, browser, (2.0, 0.0, 2.4)))
    browser.find("Undo: Change pose")
    moved = edited(planner, lambda e: not e._drag and e.scene)
    x, y, z = moved.world_pose(waypoint).position_m
    assert (x, y) == pytest.approx((2.0, 0.0), abs=1e-6)
    assert z == pytest.approx(1.0, abs=0.1)

    browser.press("Undo: Change pose")
    assert edited(planner, lambda e: e.redo_label == "Change pose" and e.scene) == made
    browser.press("Redo: Change pose")
    assert edited(planner, lambda e: e.redo_label is None and e.scene) == moved

    browser.press("Save *")
    edited(planner, lambda e: not e.dirty)
    assert load_scene(file) == moved

    browser.press("append")
    edited(planner, lambda e: len(e.scene.held_by(1)) == 3)
    assert load_scene(file) == moved
    browser.press("Reload")
    browser.press("Discard and reload")
    assert edited(planner, lambda e: not e.dirty and e.scene) == load_scene(file) == moved
    browser.find("Undo")


def test_a_second_browser_sees_what_the_first_one_does(planner, browser):
    browser.open(planner.url)
    browser.press("obstacle")
    edited(planner, lambda e: e.scene.objects)
    with closing(Browser(640, 400)) as other:
        other.open(planner.url)
        other.find("obstacle 1 #1")
        browser.press("agent")
        other.find("agent 1 #2")


def test_a_trajectory_is_sent_to_an_action_server_and_cancelled_with_the_mouse(
    tmp_path, browser, domain_id
):
    editor = Editor.open(tmp_path / "new.yaml")
    dog = editor.add("agent", "dog")
    path = Trajectory.of([(0, Pose()), (60 * 10**9, Pose.at((3.0, 0.0, 0.0)))])
    editor.select(editor.add_trajectory(path, "walk", agent=dog))
    node = partial(Node, "planner", domain_id=domain_id, interface="lo")
    more = {"env": os.environ | {"PYTHONUNBUFFERED": "1"}}
    place = ("--domain", domain_id, "--interface", "lo")
    served = at_work("follow", "serve", "--agent", "dog", *place, **more)
    with served as agent, Planner(editor, port=0, node=node) as planner:
        assert "moves it" in agent.stdout.readline()
        browser.open(planner.url)
        browser.press("Send")
        browser.wait_for("document.body.innerText.includes('m from the plan')", 60.0)
        browser.press("Cancel")
        browser.wait_for("document.body.innerText.includes('canceled: ')", 60.0)

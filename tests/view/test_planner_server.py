"""The scene editor's server and panels, without a browser: events, refused values, ports, ends."""

import asyncio
import http.client
import os
import signal
import socket
import subprocess
import sys
import threading
from functools import partial
from types import SimpleNamespace
from unittest.mock import DEFAULT, Mock

import pytest
from served import agent_at_work
from typer.testing import CliRunner
from waiting import program, wait_until

from sfglab.bus import Node
from sfglab.cli import app
from sfglab.errors import MissingExtraError, SfglabError
from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.editor import Editor
from sfglab.spatial.trajectory.path import Trajectory
from sfglab.view.planner import drawing, server
from sfglab.view.planner.server import Planner

pytest.importorskip("viser", reason="the scene editor needs the extra 'view'")
pytestmark = pytest.mark.live


@pytest.fixture
def planner(tmp_path):
    editor = Editor(file=tmp_path / "scene.yaml")
    editor.select(editor.add("agent", "dog"))
    editor.add("obstacle", "wall")
    with Planner(editor) as made:
        yield made


class Remote:
    """An editor whose methods are called in its planner's thread."""

    def __init__(self, planner):
        self._planner = planner

    def __getattr__(self, name):
        value = self._planner.call(lambda editor: getattr(editor, name))
        if not callable(value):
            return value
        return lambda *arguments: self._planner.call(lambda _: value(*arguments))


@pytest.fixture
def editor(planner):
    return Remote(planner)


UPGRADE = {
    "Upgrade": "websocket",
    "Connection": "Upgrade",
    "Sec-WebSocket-Version": "13",
    "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
    "Sec-WebSocket-Protocol": "viser-v0",
}


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        ("{token}/", {}, 200),
        ("", {}, 403),
        ("{token}/", UPGRADE, 101),
        ("{token}/", UPGRADE | {"Origin": "http://{host}"}, 101),
        ("", UPGRADE, 403),
        ("{token}x/", UPGRADE, 403),
        ("{token}/", UPGRADE | {"Origin": "https://evil.example"}, 403),
        ("{token}/", UPGRADE | {"Origin": "null"}, 403),
        (
            "{token}/",
            UPGRADE | {"Host": "evil.example:80", "Origin": "http://evil.example:80"},
            403,
        ),
    ],
)
def test_only_a_request_with_the_token_and_from_its_own_page_is_served(
    planner, path, headers, status
):
    host = f"127.0.0.1:{planner._server.get_port()}"
    values = {"token": planner._guard.token, "host": host}
    given = {key: value.format_map(values) for key, value in headers.items()}
    asking = http.client.HTTPConnection(host)
    asking.request("GET", "/" + path.format_map(values), headers=given)
    assert asking.getresponse().status == status
    asking.close()


def happens(callback, target, **more):
    """Do what viser does at an event of a browser."""
    given = {"client_id": 1, "client": None, "instance_index": None} | more
    asyncio.run(callback(SimpleNamespace(target=target, **given)))


def typed(planner, key, value):
    widget = planner._inspector._widgets[key]
    widget._impl.value = value
    happens(widget._impl.update_cb[0], widget)


def clicked(widget):
    happens(widget._impl.update_cb[0], widget)


def dragged(planner, phase, position=(0.0, 0.0, 0.0), **more):
    target = SimpleNamespace(wxyz=(1.0, 0.0, 0.0, 0.0), position=position)
    happens(planner._viewport._gizmo._handle._impl_aux.update_cb[0], target, phase=phase, **more)


def position(editor):
    return editor.scene.get(1).pose.position_m


def test_a_drag_is_one_step_that_ends_with_its_own_browser_or_another_selection(planner, editor):
    disconnected = planner._server._client_disconnect_cb[-1]
    gizmo = planner._viewport._gizmo._handle
    dragged(planner, "start")
    dragged(planner, "update", (1.0, 0.0, 0.0))
    disconnected(SimpleNamespace(client_id=2))
    for phase in ("start", "update", "end"):
        dragged(planner, phase, (9.0, 0.0, 0.0), client_id=2)
    dragged(planner, "update", (2.0, 0.0, 0.0))
    dragged(planner, "end", (float("nan"), 0.0, 0.0))
    assert position(editor) == tuple(gizmo.position) == (2.0, 0.0, 0.0)
    for x, ends in (
        (3.0, lambda: disconnected(SimpleNamespace(client_id=1))),
        (4.0, editor.select),
    ):
        dragged(planner, "start")
        dragged(planner, "update", (x, 0.0, 0.0))
        ends()
    editor.rename(1, "cat")
    for x in (4.0, 4.0, 3.0, 2.0, 0.0):  # the name and each drag are one step
        assert position(editor) == (x, 0.0, 0.0)
        editor.undo()


def test_numbers_typed_key_by_key_are_one_edit_and_a_refused_one_is_taken_out_of_its_field(
    planner, editor
):
    radius = planner._inspector._widgets["radius_m"]
    for value in (1.0, 1.2, 1.25):
        typed(planner, "radius_m", value)
    assert editor.scene.get(1).radius_m == 1.25
    editor.undo()
    before = editor.scene
    assert before.get(1).radius_m == radius.value == 0.3
    typed(planner, "radius_m", 0.0)
    assert editor.scene is before
    assert radius.value == 0.3


def test_a_click_into_the_viewport_selects_an_object(planner, editor):
    node = planner._viewport._objects.nodes["/objects/2"]
    happens(node._impl.click_cb[0].callback, node)
    assert editor.selection == (2,)


def test_an_edit_touches_only_the_nodes_that_it_concerns(planner, editor):
    ghosts = planner._viewport._ghosts.nodes
    before = dict(ghosts)
    editor.rename(1, "cat")
    editor.place(1, Pose.at((1.0, 1.0, 1.0)))
    assert planner._hierarchy._buttons[1].label == "cat  #1"
    assert ghosts["/ghosts/1/label"].text == "cat"
    assert tuple(ghosts["/ghosts/1/body"].position) == (1.0, 1.0, 1.0)
    assert ghosts == before
    editor.set_property(1, "radius_m", 0.5)
    assert ghosts["/ghosts/1/body"] is not before["/ghosts/1/body"]


def test_conflicts_are_listed_and_lead_to_their_objects(planner, editor):
    [button] = wait_until(lambda: planner._warnings._buttons)
    assert "dog is" in button.label
    assert "/conflicts/0/mark" in planner._viewport._conflicts.nodes
    editor.select()
    clicked(button)
    assert editor.selection == (1, 2)
    editor.remove(2)
    wait_until(lambda: planner._warnings._head.content == "no conflicts")
    assert editor.selection == (1,)
    assert planner._viewport._conflicts.nodes == {}


def test_a_part_that_fails_to_draw_hides_no_edit_and_draws_all_the_next_time(
    planner, editor, monkeypatch
):
    with monkeypatch.context() as broken:
        broken.setattr(drawing, "add_body", Mock(side_effect=RuntimeError("broken")))
        editor.add("obstacle", "box")
        assert sorted(planner._hierarchy._buttons) == [1, 2, 3]
    editor.rename(3, "crate")
    assert sorted(planner._viewport._objects.nodes) == ["/objects/2", "/objects/3"]


def test_a_check_for_conflicts_that_fails_says_so_until_the_next_one(planner, editor, monkeypatch):
    head = planner._warnings._head
    with monkeypatch.context() as broken:
        broken.setattr(Editor, "conflicts", Mock(side_effect=RuntimeError("broken")))
        editor.rename(1, "cat")
        wait_until(lambda: head.content == "the check failed")
    editor.undo()
    wait_until(lambda: "1 conflict" in head.content)


def test_a_loaded_scene_takes_the_place_of_what_was_drawn_but_reload_loses_no_changes(
    planner, editor
):
    editor.save()
    editor.remove(2)
    clicked(planner._toolbar._load)  # as a browser can that still shows it enabled
    assert list(planner._hierarchy._buttons) == [1]
    editor.undo()
    clicked(planner._toolbar._load)
    assert editor.redo_label is None
    assert sorted(planner._hierarchy._buttons) == [1, 2]
    assert list(planner._viewport._objects.nodes) == ["/objects/2"]


def test_a_trajectory_is_sent_to_an_action_cancelled_and_stopped_by_closing(domain_id):
    scene = Editor()
    path = Trajectory.of([(0, Pose()), (60 * 10**9, Pose.at((3.0, 0.0, 0.0)))])
    walk = scene.add_trajectory(path, "walk")
    scene.select(walk)
    join = partial(Node, "planner", domain_id=domain_id, interface="lo")
    node = Mock(wraps=join, side_effect=[OSError("no network"), DEFAULT])
    with agent_at_work("dog", domain_id, "/walk"), Planner(scene, node=node) as planner:
        editor = Remote(planner)
        states = planner._sender.states
        clicked(planner._inspector._send_form._send)
        editor.set_property(walk, "agent", editor.add("agent", "dog"))
        form = planner._inspector._send_form
        assert form._action.value == "/global/dog/execute_trajectory"
        assert form._text.content == "not sent", "without an agent"
        for action, words in (("/walk", "no network"), ("no name", "no name")):
            form._action.value = action
            clicked(form._send)
            wait_until(lambda words=words: words in form._text.content and not states[walk].running)
        form._action.value = "/walk"
        clicked(form._send)
        wait_until(lambda: "m from the plan" in form._text.content)
        clicked(form._cancel)
        wait_until(lambda: form._text.content.startswith("canceled"))
        clicked(form._send)
        wait_until(lambda: states[walk].running and states[walk].share > 0.0)
    assert states[walk].text.startswith("canceled")


def job_threads():
    return [thread for thread in threading.enumerate() if thread.name == "planner-jobs"]


def test_playing_moves_the_time_and_nothing_of_the_planner_outlives_it(planner, editor):
    others = len(job_threads()) - 1  # of planners that other tests show in notebooks
    clicked(planner._timeline._button)
    wait_until(lambda: editor.time_s)
    assert f'src="{planner.url}"' in planner._repr_html_()
    planner.close()
    assert "iframe" not in planner._repr_html_()
    assert len(job_threads()) == others
    with pytest.raises(SfglabError, match="closed"):
        editor.undo()


def test_an_editor_that_cannot_be_furnished_frees_its_port_and_leaves_no_thread(monkeypatch):
    monkeypatch.setattr(server, "Warnings", Mock(side_effect=RuntimeError("broken")))
    others = job_threads()
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(RuntimeError, match="broken"):
        Planner(Editor(), port=port)
    with socket.create_server(("127.0.0.1", port)):
        assert job_threads() == others


def test_a_port_in_use_and_viser_that_is_missing_are_one_clear_error(monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(SfglabError, match=rf"--port: given {port}, allowed: a free port"):
            Planner(Editor(), port=port)
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingExtraError, match=r"'.\[view\]' in a checkout"):
        Planner(Editor())


def test_the_command_ends_at_ctrl_c_says_nothing_of_a_saved_scene_and_leaves_the_file(tmp_path):
    file = tmp_path / "s.yaml"
    Editor().save(file)
    before = file.read_text()
    argv = (sys.executable, "-m", "sfglab", "plan", str(file), "--port", "0", "--no-browser")
    more = {"stderr": subprocess.PIPE, "env": os.environ | {"PYTHONUNBUFFERED": "1"}}
    with program(*argv, **more) as process:
        assert "s.yaml: http://127.0.0.1:" in process.stdout.readline()
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert (process.returncode, said) == (0, "")
    assert file.read_text() == before


def test_changes_that_were_not_saved_at_ctrl_c_are_reported_and_the_file_stays_as_it_was(
    tmp_path, monkeypatch
):
    def edited_then_interrupted(planner):
        planner.call(lambda e: e.add("agent", "late"))
        raise KeyboardInterrupt

    file = tmp_path / "s.yaml"
    Editor().save(file)
    before = file.read_text()
    monkeypatch.setattr(Planner, "wait", edited_then_interrupted)
    result = CliRunner().invoke(app, ["plan", str(file), "--port", "0", "--no-browser"])
    assert (result.exit_code, result.stderr) == (
        0,
        "s.yaml: changes since the last save were not saved\n",
    )
    assert file.read_text() == before

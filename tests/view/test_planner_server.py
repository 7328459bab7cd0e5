"""The scene editor's server and panels, without a browser: events, refused values, ports, ends."""

import asyncio
import http.client
import os
import signal
import socket
import subprocess
import sys
import threading
from types import SimpleNamespace
from unittest.mock import Mock

import pytest
from seen import at_work, edited
from typer.testing import CliRunner
from waiting import wait_until

from sfglab.cli import app
from sfglab.errors import MissingExtraError, SfglabError
from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.editor import Editor
from sfglab.spatial.scene.files import load_scene, scene_text
from sfglab.spatial.trajectory.path import Trajectory
from sfglab.view.planner import drawing, server
from sfglab.view.planner.sending import Sending
from sfglab.view.planner.server import Planner, show_planner

pytest.importorskip("viser", reason="the scene editor needs the extra 'view'")
pytestmark = pytest.mark.live


@pytest.fixture
def planner(tmp_path):
    editor = Editor(file=tmp_path / "scene.yaml")
    editor.select(editor.add("agent", "dog"))
    editor.add("obstacle", "wall")
    with Planner(editor, port=0) as made:
        yield made


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


def test_a_drag_is_one_step_and_leaves_the_gizmo_where_the_object_is(planner):
    before = planner.call(lambda e: e.scene)
    dragged(planner, "start")
    for i in range(50):
        dragged(planner, "update", (i / 10, 0.0, 0.0))
    dragged(planner, "end")
    assert planner.call(lambda e: e.scene.get(1).pose.position_m) == (4.9, 0.0, 0.0)
    assert tuple(planner._viewport._gizmo._handle.position) == (4.9, 0.0, 0.0)
    planner.call(Editor.undo)
    assert planner.call(lambda e: e.scene) == before
    assert tuple(planner._viewport._gizmo._handle.position) == (0.0, 0.0, 0.0)


def test_a_drag_that_another_selection_ends_does_not_swallow_later_edits(planner):
    dragged(planner, "start")
    dragged(planner, "update", (1.0, 0.0, 0.0))
    planner.call(lambda e: e.select(2))
    planner.call(lambda e: e.rename(1, "cat"))
    planner.call(Editor.undo)
    thing = planner.call(lambda e: e.scene.get(1))
    assert (thing.name, thing.pose.position_m) == ("dog", (1.0, 0.0, 0.0))


def test_a_drag_ends_with_its_own_browser_only_and_also_where_its_last_place_is_impossible(planner):
    gone = planner._server._client_disconnect_cb[-1]
    before = planner.call(lambda e: e.scene)
    dragged(planner, "start")
    dragged(planner, "update", (1.0, 0.0, 0.0))
    gone(SimpleNamespace(client_id=2))
    dragged(planner, "start", client_id=2)
    dragged(planner, "update", (9.0, 0.0, 0.0), client_id=2)
    dragged(planner, "end", client_id=2)
    dragged(planner, "update", (2.0, 0.0, 0.0))
    dragged(planner, "end", (float("nan"), 0.0, 0.0))
    assert planner.call(lambda e: e.scene.get(1).pose.position_m) == (2.0, 0.0, 0.0)
    dragged(planner, "start")
    dragged(planner, "update", (3.0, 0.0, 0.0))
    gone(SimpleNamespace(client_id=1))
    planner.call(lambda e: e.rename(1, "cat"))
    for _ in range(3):
        planner.call(Editor.undo)
    assert planner.call(lambda e: e.scene) == before


def test_numbers_typed_key_by_key_are_one_edit_and_a_refused_one_is_taken_out_of_its_field(planner):
    radius = planner._inspector._widgets["radius_m"]
    for value in (1.0, 1.2, 1.25):
        typed(planner, "radius_m", value)
    assert planner.call(lambda e: e.scene.get(1).radius_m) == 1.25
    planner.call(Editor.undo)
    assert planner.call(lambda e: e.scene.get(1).radius_m) == 0.3
    assert radius.value == 0.3
    before = planner.call(lambda e: e.scene)
    typed(planner, "radius_m", 0.0)
    assert planner.call(lambda e: e.scene) is before
    assert radius.value == 0.3


def test_a_click_into_the_viewport_selects_an_object(planner):
    node = planner._viewport._objects.nodes["/objects/2"]
    happens(node._impl.click_cb[0].callback, node)
    assert planner.call(lambda e: e.selection) == (2,)


def test_an_edit_touches_only_the_rows_and_nodes_that_it_concerns(planner):
    row = planner._hierarchy._buttons[1]
    objects, ghosts = planner._viewport._objects.nodes, planner._viewport._ghosts.nodes
    before = objects | ghosts
    planner.call(lambda e: e.rename(1, "cat"))
    planner.call(lambda e: e.place(1, Pose(position_m=(1.0, 1.0, 1.0))))
    assert planner._hierarchy._buttons[1] is row
    assert row.label == "cat  #1"
    assert objects | ghosts == before
    assert ghosts["/ghosts/1/label"].text == "cat"
    assert tuple(ghosts["/ghosts/1/body"].position) == (1.0, 1.0, 1.0)
    planner.call(lambda e: e.set_property(1, "radius_m", 0.5))
    assert ghosts["/ghosts/1/body"] is not before["/ghosts/1/body"]


def test_conflicts_are_listed_and_lead_to_their_time_and_objects(planner):
    buttons = edited(planner, lambda _: planner._warnings._buttons)
    assert "dog is" in buttons[0].label
    assert "/conflicts/0/mark" in planner._viewport._conflicts.nodes
    planner.call(lambda e: e.select())
    clicked(buttons[0])
    assert planner.call(lambda e: e.selection) == (1, 2)
    planner.call(lambda e: e.place(1, Pose(position_m=(9.0, 0.0, 0.0))))
    edited(planner, lambda _: planner._warnings._head.content == "no conflicts")
    assert planner._viewport._conflicts.nodes == {}


def test_a_loaded_scene_takes_the_place_of_what_was_drawn(planner):
    planner.call(Editor.save)
    planner.call(lambda e: (e.remove(2), e.add("agent", "bird"), e.select(1)))
    planner.call(Editor.load)
    assert sorted(planner._hierarchy._buttons) == [1, 2]
    assert list(planner._viewport._objects.nodes) == ["/objects/2"]
    assert "/ghosts/3/body" not in planner._viewport._ghosts.nodes


def test_a_part_that_fails_to_draw_hides_no_edit_and_draws_all_the_next_time(planner, monkeypatch):
    with monkeypatch.context() as broken:
        broken.setattr(drawing, "add_body", Mock(side_effect=RuntimeError("broken")))
        planner.call(lambda e: e.remove(2))
        planner.call(lambda e: e.add("obstacle", "box"))
        assert sorted(planner._hierarchy._buttons) == [1, 3]
    planner.call(Editor.undo)
    planner.call(Editor.undo)
    assert sorted(planner._hierarchy._buttons) == [1, 2]
    assert list(planner._viewport._objects.nodes) == ["/objects/2"]
    assert "/ghosts/1/body" in planner._viewport._ghosts.nodes


def test_a_check_for_conflicts_that_fails_says_so_until_the_next_one(planner, monkeypatch):
    with monkeypatch.context() as broken:
        broken.setattr(Editor, "conflicts", Mock(side_effect=RuntimeError("broken")))
        planner.call(lambda e: e.rename(1, "cat"))
        edited(planner, lambda _: planner._warnings._head.content == "the check failed")
    planner.call(Editor.undo)
    edited(planner, lambda _: "1 conflict" in planner._warnings._head.content)


def test_reload_is_refused_where_it_would_lose_changes_also_if_its_button_looked_enabled(planner):
    planner.call(Editor.save)
    planner.call(lambda e: e.rename(1, "cat"))
    clicked(planner._toolbar._load)
    assert planner.call(lambda e: e.scene.get(1).name) == "cat"
    planner.call(Editor.undo)
    clicked(planner._toolbar._load)
    assert planner.call(lambda e: e.redo_label) is None  # it was read again


def state_of(planner, id_):
    return planner._sender.states.get(id_, Sending())


def test_a_trajectory_without_agent_and_a_wrong_action_are_reported(planner):
    planner.call(lambda e: e.select(e.add_trajectory(Trajectory.standing(Pose()), "walk")))
    id_ = planner.call(lambda e: e.selection[0])
    clicked(planner._inspector._send_form._send)
    assert planner.call(lambda _: state_of(planner, id_)) == Sending()
    planner.call(lambda e: e.set_property(id_, "agent", 1))
    form = planner._inspector._send_form
    form._action.value = "no name"
    clicked(form._send)
    wait_until(lambda: "no name" in form._text.content and not state_of(planner, id_).running)


def job_threads():
    return [thread for thread in threading.enumerate() if thread.name == "planner-jobs"]


def test_playing_moves_the_time_and_no_thread_outlives_the_planner(planner):
    others = len(job_threads()) - 1  # of planners that other tests show in notebooks
    clicked(planner._timeline._button)
    edited(planner, lambda e: e.time_s)
    planner.close()
    assert len(job_threads()) == others


def test_a_notebook_shows_a_frame_while_it_is_open_and_calls_end_with_it(planner):
    assert f'src="{planner.url}"' in planner._repr_html_()
    planner.close()
    assert "iframe" not in planner._repr_html_()
    with pytest.raises(SfglabError, match="closed"):
        planner.call(lambda _: None)


def test_an_editor_that_cannot_be_furnished_frees_its_port_and_leaves_no_thread(monkeypatch):
    monkeypatch.setattr(server, "Warnings", Mock(side_effect=RuntimeError("broken")))
    others = job_threads()
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    with pytest.raises(RuntimeError, match="broken"):
        Planner(Editor(), port=port)
    with socket.create_server(("127.0.0.1", port)):
        assert job_threads() == others


def test_a_port_in_use_and_viser_that_is_missing_are_one_clear_error(tmp_path, monkeypatch):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(SfglabError, match=rf"--port: given {port}, allowed: a free port"):
            show_planner(tmp_path / "new.yaml", port=port)
        monkeypatch.setattr(server, "_check_free", lambda _: None)  # it is taken a moment later
        with pytest.raises(SfglabError, match=rf"--port: given {port}, allowed: a free port"):
            show_planner(tmp_path / "new.yaml", port=port)
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(MissingExtraError, match=r"'.\[view\]' in a checkout"):
        Planner(Editor(), port=0)


def test_the_command_ends_at_ctrl_c_says_nothing_of_a_saved_scene_and_leaves_the_file(tmp_path):
    file = tmp_path / "s.yaml"
    editor = Editor()
    editor.add("agent", "a")
    editor.save(file)
    more = {"stderr": subprocess.PIPE, "env": os.environ | {"PYTHONUNBUFFERED": "1"}}
    with at_work("plan", file, "--port", "0", "--no-browser", **more) as process:
        assert "s.yaml: http://127.0.0.1:" in process.stdout.readline()
        process.send_signal(signal.SIGINT)
        _, said = process.communicate(timeout=60)
    assert (process.returncode, said) == (0, "")
    assert scene_text(load_scene(file)) == file.read_text()


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
    assert result.exit_code == 0
    assert result.stderr == "s.yaml: changes since the last save were not saved\n"
    assert file.read_text() == before
    assert list(tmp_path.iterdir()) == [file]

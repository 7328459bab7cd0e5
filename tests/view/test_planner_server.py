"""The scene editor's server and panels, without a browser: events, refused values, ports, ends."""

import asyncio
import os
import signal
import socket
import subprocess
import sys
import threading
from functools import partial
from types import SimpleNamespace

import pytest
from seen import at_work, edited
from waiting import wait_until

from sfglab.bus import Node
from sfglab.errors import MissingExtraError, SfglabError
from sfglab.spatial.poses import Pose
from sfglab.spatial.scene.editor import Editor
from sfglab.spatial.scene.files import load_scene, scene_text
from sfglab.spatial.trajectory.path import Trajectory
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


@pytest.mark.parametrize(
    ("path", "headers", "status"),
    [
        ("{token}/", {}, 200),
        ("{token}/", {"Origin": "http://{host}"}, 200),
        ("", {}, 403),
        ("{token}x/", {}, 403),
        ("{token}/", {"Origin": "https://evil.example"}, 403),
        ("{token}/", {"Origin": "null"}, 403),
        ("{token}/", {"Host": "evil.example:80", "Origin": "http://evil.example:80"}, 403),
    ],
)
@pytest.mark.parametrize("upgrade", [False, True])
def test_who_knows_the_token_and_comes_from_its_own_page_is_served(
    planner, path, headers, status, upgrade
):
    values = {"token": planner._guard.token, "host": f"127.0.0.1:{planner._server.get_port()}"}
    with socket.create_connection(("127.0.0.1", planner._server.get_port())) as asking:
        given = {
            "Host": values["host"],
            **{key: value.format_map(values) for key, value in headers.items()},
        }
        if upgrade:
            given |= {
                "Upgrade": "websocket",
                "Connection": "Upgrade",
                "Sec-WebSocket-Version": "13",
            }
            given |= {
                "Sec-WebSocket-Key": "AAAAAAAAAAAAAAAAAAAAAA==",
                "Sec-WebSocket-Protocol": "viser-v0",
            }
        lines = [
            f"GET /{path.format_map(values)} HTTP/1.1",
            *(f"{key}: {given[key]}" for key in given),
            "",
            "",
        ]
        asking.sendall("\r\n".join(lines).encode())
        answer = asking.recv(1000).split(b" ")[1]
    assert int(answer) == (101 if upgrade and status == 200 else status)


def typed(planner, key, value):
    """Do what viser does when a browser types a value."""
    widget = planner._inspector._widgets[key]
    widget._impl.value = value
    asyncio.run(widget._impl.update_cb[0](SimpleNamespace(client_id=1, client=None, target=widget)))


def clicked(part):
    event = SimpleNamespace(client_id=1, client=None, target=part, instance_index=None)
    asyncio.run(part._impl.update_cb[0](event))


def dragged(planner, phase, position=(0.0, 0.0, 0.0)):
    gizmo = planner._viewport._gizmo._handle
    target = SimpleNamespace(wxyz=(1.0, 0.0, 0.0, 0.0), position=position)
    asyncio.run(
        gizmo._impl_aux.update_cb[0](SimpleNamespace(client_id=1, phase=phase, target=target))
    )


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
    assert planner.call(lambda e: (e.scene.get(1).name, e.scene.get(1).pose.position_m)) == (
        "dog",
        (1.0, 0, 0),
    )


def test_numbers_typed_key_by_key_are_one_edit(planner):
    for value in (1.0, 1.2, 1.25):
        typed(planner, "radius_m", value)
    assert planner.call(lambda e: e.scene.get(1).radius_m) == 1.25
    planner.call(Editor.undo)
    assert planner.call(lambda e: e.scene.get(1).radius_m) == 0.3
    assert planner._inspector._widgets["radius_m"].value == 0.3


def test_a_refused_value_is_taken_out_of_its_field_and_the_scene_is_as_it_was(planner):
    before = planner.call(lambda e: e.scene)
    typed(planner, "radius_m", 0.0)
    planner.call(lambda _: None)
    assert planner.call(lambda e: e.scene) is before
    assert planner._inspector._widgets["radius_m"].value == 0.3


def test_a_row_selects_and_a_second_click_selects_nothing(planner):
    row = planner._hierarchy._buttons[2]
    clicked(row)
    assert planner.call(lambda e: e.selection) == (2,)
    assert row.color == "blue"
    clicked(row)
    assert planner.call(lambda e: e.selection) == ()
    assert row.color is None


def test_an_edit_touches_only_the_rows_and_nodes_that_it_concerns(planner):
    rows = planner.call(lambda _: dict(planner._hierarchy._buttons))
    nodes = planner.call(lambda _: dict(planner._viewport._nodes))
    planner.call(lambda e: e.rename(1, "cat"))
    planner.call(lambda e: e.place(1, Pose(position_m=(1.0, 1.0, 1.0))))
    assert planner.call(lambda _: planner._hierarchy._buttons) == rows
    assert rows[1].label == "cat  #1"
    assert planner.call(lambda _: planner._viewport._nodes[2]) is nodes[2]


def test_conflicts_are_listed_and_lead_to_their_time_and_objects(planner):
    planner.call(lambda e: e.rename(1, "cat"))
    buttons = edited(planner, lambda _: planner._warnings._buttons)
    assert "cat is" in buttons[0].label
    planner.call(lambda e: e.select())
    clicked(buttons[0])
    assert planner.call(lambda e: e.selection) == (1, 2)


def test_a_scene_that_cannot_be_checked_is_reported_and_the_next_one_is_checked(
    planner, monkeypatch
):
    def broken(_):
        raise ZeroDivisionError

    with monkeypatch.context() as patched:
        patched.setattr("sfglab.spatial.scene.editor.conflicts", broken)
        planner.call(lambda e: e.rename(1, "cat"))
        edited(planner, lambda _: "not checked" in planner._warnings._head.content)
    planner.call(lambda e: e.rename(1, "dog"))
    edited(planner, lambda _: planner._warnings._buttons)


def test_a_loaded_scene_takes_the_place_of_what_was_drawn(planner):
    planner.call(Editor.save)
    planner.call(lambda e: (e.remove(2), e.add("agent", "bird"), e.select(1)))
    planner.call(Editor.load)
    assert planner.call(lambda _: sorted(planner._hierarchy._buttons)) == [1, 2]
    assert planner.call(lambda _: sorted(planner._viewport._nodes)) == [2]
    assert planner.call(lambda _: sorted(planner._viewport._drawing._ghosts)) == [1]


def test_the_toolbar_removes_a_waypoint_back_to_its_trajectory_and_selects_a_copy(planner):
    def tool(word):
        planner.call(lambda _: planner._toolbar._selected((word, (0.0, 0.0, 0.0))))

    planner.call(lambda _: planner._toolbar._add(("trajectory", (0.0, 0.0, 0.0))))
    made, waypoint = planner.call(lambda e: (e.selection[0], e.scene.held_by(e.selection[0])[0]))
    planner.call(lambda e: e.select(waypoint))
    tool("remove")
    assert planner.call(lambda e: (e.selection, waypoint in e.scene.objects)) == ((made,), False)
    tool("duplicate")
    copy = planner.call(lambda e: e.selection[0])
    assert copy != made
    tool("remove")
    assert planner.call(lambda e: (e.selection, copy in e.scene.objects)) == ((), False)


@pytest.fixture
def sending(domain_id):
    """A planner in a domain with an agent's server, the id of the agent's trajectory, and the form to send it."""
    place = ("--domain", domain_id, "--interface", "lo")
    more = {"env": os.environ | {"PYTHONUNBUFFERED": "1"}}
    served = at_work("follow", "serve", "--agent", "dog", "--action", "/walk", *place, **more)
    editor = Editor()
    made = editor.add("agent", "dog")
    path = Trajectory.of([(0, Pose()), (60 * 10**9, Pose.at((3.0, 0.0, 0.0)))])
    id_ = editor.add_trajectory(path, "walk", agent=made)
    editor.select(id_)
    node = partial(Node, "planner", domain_id=domain_id, interface="lo")
    with served as agent, Planner(editor, port=0, node=node) as planner:
        assert "/walk moves it" in agent.stdout.readline()
        form = planner._inspector._send_form
        assert form._action.value == "/global/dog/execute_trajectory"
        form._action.value = "/walk"
        yield planner, id_, form


def state_of(planner, id_):
    return planner._sender.states.get(id_, Sending())


def test_a_trajectory_is_sent_shows_feedback_and_is_cancelled(sending):
    planner, id_, form = sending
    assert (form._send.disabled, form._cancel.disabled) == (False, True)
    clicked(form._send)
    wait_until(lambda: "m from the plan" in form._text.content and form._bar.value > 0.0)
    assert (form._send.disabled, form._cancel.disabled) == (True, False)
    clicked(form._cancel)
    wait_until(lambda: form._text.content.startswith("canceled"))
    assert (form._send.disabled, form._cancel.disabled) == (False, True)
    assert not state_of(planner, id_).running


def test_an_editor_that_is_closed_cancels_its_goals(sending):
    planner, id_, form = sending
    clicked(form._send)
    wait_until(lambda: state_of(planner, id_).share > 0.0)
    planner.close()
    assert state_of(planner, id_).text.startswith("canceled")


def test_no_server_and_no_agent_are_reported(planner):
    planner.call(lambda e: e.select(e.add_trajectory(Trajectory.standing(Pose()), "walk")))
    id_ = planner.call(lambda e: e.selection[0])
    clicked(planner._inspector._send_form._send)
    planner.call(lambda _: None)
    assert state_of(planner, id_) == Sending()
    planner.call(lambda e: e.set_property(id_, "agent", 1))
    assert planner._inspector._send_form._action.value == "/global/dog/execute_trajectory"
    planner._inspector._send_form._action.value = "no name"
    clicked(planner._inspector._send_form._send)
    wait_until(
        lambda: "no name" in state_of(planner, id_).text and not state_of(planner, id_).running
    )


def test_playing_moves_the_time_and_ends_with_the_planner(planner):
    others = set(threading.enumerate()) - {planner._jobs._thread}
    clicked(planner._timeline._button)
    edited(planner, lambda e: e.time_s)
    planner.close()
    left = [t for t in threading.enumerate() if t.name.startswith("planner-") and t not in others]
    assert not [thread for thread in left if thread.is_alive()]


def test_a_notebook_shows_a_frame_while_it_is_open_and_calls_end_with_it(planner):
    assert f'src="{planner.url}"' in planner._repr_html_()
    planner.close()
    assert "iframe" not in planner._repr_html_()
    with pytest.raises(SfglabError, match="closed"):
        planner.call(lambda _: None)


def test_a_port_in_use_is_one_clear_error(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with pytest.raises(SfglabError, match=rf"--port: given {port}, which something else uses"):
            show_planner(tmp_path / "new.yaml", port=port)


def test_without_viser_the_extra_is_named(monkeypatch):
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


def test_what_was_not_saved_at_ctrl_c_is_said_in_one_line_and_the_file_stays_as_it_was(
    tmp_path, monkeypatch
):
    from typer.testing import CliRunner

    from sfglab.cli import app

    def edited_then_interrupted(planner):
        planner.call(lambda e: e.add("agent", "late"))
        raise KeyboardInterrupt

    file = tmp_path / "s.yaml"
    Editor().save(file)
    before = file.read_text()
    monkeypatch.setattr(Planner, "wait", edited_then_interrupted)
    result = CliRunner().invoke(app, ["plan", str(file), "--port", "0", "--no-browser"])
    assert result.exit_code == 0
    told = "s.yaml: changes since the last save were not saved"
    assert result.stderr.splitlines() == [told]
    assert file.read_text() == before
    assert not list(tmp_path.glob(".*.part"))

"""A session at work: stage, replay of logs, notebook cell, panel, and the live bridge."""

import asyncio
import gzip
import subprocess
import sys
import threading
from functools import partial
from importlib.metadata import EntryPoint
from importlib.util import find_spec
from unittest.mock import Mock, call
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest
from seen import BEAT
from waiting import until

from sfglab.errors import InvalidValueError, MissingExtraError
from sfglab.fleet.fleet_file import load_fleet
from sfglab.lab.workers.picture_flow import image_message
from sfglab.messages import default_message, message_type, serialize, stamp_from_ns
from sfglab.qos import SENSOR_DATA
from sfglab.record import LogReader, LogWriter
from sfglab.spatial.poses import header_msg
from sfglab.view import Input, Parameter, Visualizer, cell
from sfglab.view.app import ViewOptions, view_log
from sfglab.view.arrivals import Arrival, arrivals_of, capture_ns, decoded
from sfglab.view.bridge import Bridge
from sfglab.view.panel import Panel
from sfglab.view.rerunning import (
    WINDOW_BYTES,
    RerunCanvas,
    layout_of_fleet,
    layout_of_topics,
    open_canvas,
)
from sfglab.view.session import GROUP, Session
from sfglab.view.stage import Stage, replay
from sfglab.view.visualizer import SinkError

world = pytest.fixture(lambda live: live)

S = 1_000_000_000
IMAGE, STRING = "sensor_msgs/msg/Image", "std_msgs/msg/String"
INFO = "sensor_msgs/msg/CameraInfo"
VIDEO = "foxglove_msgs/msg/CompressedVideo"
PICTURE = image_message(np.zeros((2, 3), np.uint8), "mono8", header_msg("camera", 5))
needs_rerun = pytest.mark.skipif(
    not find_spec("rerun_notebook"), reason="the extra 'view' is not installed"
)


class Word(Visualizer):
    """A visualizer of another package: text at its topic."""

    name = "word"
    inputs = (Input("text", STRING),)
    max_hz = None
    queue = 100
    parameters = (Parameter("prefix", "", "in front of every word"),)

    def show(self, update, canvas):
        if update.only.data == "crash":
            raise RuntimeError("a mistake in a plugin")
        canvas.log(self.entity, self["prefix"] + update.only.data)


class Taken(Word):
    name = "image"


class Blind(Word):
    inputs = ()


@pytest.fixture
def session():
    return Session()


def said(text, topic="/words"):
    return Arrival(topic, STRING, 1, serialize(message_type(STRING)(data=text)))


def words(paper):
    return [drawn.what[0] for drawn in paper.drawn]


@pytest.mark.parametrize(
    ("message", "captured_ns"),
    [
        (default_message(INFO, header=header_msg("camera", 5 * S + 7)), 5 * S + 7),
        (default_message(INFO), 9),
        (message_type(STRING)(data="x"), 9),
        (default_message(VIDEO, timestamp=stamp_from_ns(3 * S)), 3 * S),
    ],
)
def test_the_capture_stamp_is_read_and_without_one_is_the_reception(message, captured_ns):
    for known in (None, message):
        arrival = Arrival("/a", message.__msgtype__, 9, serialize(message), known)
        assert capture_ns(arrival) == captured_ns


def test_displays_are_added_tuned_and_removed_while_messages_flow(paper, session):
    stage = Stage(session)

    def say(text):
        stage.deliver(said(text))
        for job in stage.jobs(0):
            job(paper)

    say("no subscriber")
    id_ = session.add(Word, "/words").id
    say("one")
    session.tune(id_, "prefix", "> ")
    stage.deliver(said("still waiting when it is switched off"))
    session.enable(id_, enabled=False)
    say("off")
    session.enable(id_, enabled=True)
    say("two")
    session.remove(id_)
    say("three")
    assert words(paper) == ["one", "> two"]


def test_what_a_plugin_or_a_message_breaks_is_noted_at_its_display_and_hurts_no_other(
    paper, session
):
    first, second = session.add(Word, "/words"), session.add(Word, "/others")
    garbled = Arrival("/words", STRING, 1, b"\0\1\0\0garbage")
    replay([said("crash"), garbled, said("fine"), said("too", "/others")], session, paper)
    assert "cannot read 11 bytes of CDR" in first.last_error
    assert (first.errors, second.errors, words(paper)) == (2, 0, ["fine", "too"])


def test_a_type_that_only_the_log_knows_is_read_by_the_logs_definition(pytestconfig):
    with LogReader(pytestconfig.rootpath / "data/reference/visualisation.mcap") as log:
        row = decoded(next(arrivals_of(log, ["/table/check"])))
    assert 0 < row.held <= row.checked


@needs_rerun
@pytest.mark.parametrize(
    ("to", "error", "told"),
    [
        (["a.mcap"], InvalidValueError, "to: given 'a.mcap', allowed: FILE.rrd, viewer"),
        (["serve:x"], InvalidValueError, "to: given 'serve:x'"),
        (["gone/a.rrd"], SinkError, "there is no folder gone; create it"),
        ([], InvalidValueError, "at least one of FILE.rrd, viewer"),
    ],
)
def test_a_place_that_is_none_is_one_clear_sentence(tmp_path, monkeypatch, to, error, told):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(error, match=told):
        open_canvas(to)


def test_without_rerun_there_is_one_sentence_and_importing_the_view_loads_nothing_heavy(
    monkeypatch,
):
    monkeypatch.setitem(sys.modules, "rerun", None)
    told = r"the view needs 'rerun', .*; run pip install '.\[view\]' in a checkout"
    with pytest.raises(MissingExtraError, match=told):
        open_canvas(["a.rrd"])
    monkeypatch.setattr(cell, "find_spec", lambda _: None)
    with pytest.raises(MissingExtraError, match="the view in a notebook needs 'rerun_notebook'"):
        cell.CellViewer()
    heavy = {"rerun", "ipywidgets", "cv2", "scipy"}
    code = f"import sys, sfglab.view.app, sfglab.view.panel; assert not {heavy} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


@needs_rerun
def test_every_message_of_a_log_is_shown_whatever_the_budgets(tmp_path):
    with LogWriter(tmp_path / "a.mcap") as log:
        for number in range(100):
            log.write("/image", PICTURE, log_time_ns=number * S // 100)
    options = ViewOptions(to=(str(tmp_path / "a.rrd"),))
    (display,) = view_log(tmp_path / "a.mcap", options).displays
    assert (display.slot.shown, display.slot.dropped) == (100, 0)


def test_the_layout_has_a_view_for_every_camera_and_the_heartbeats_if_there_are_any(pytestconfig):
    layout = layout_of_fleet(load_fleet(pytestconfig.rootpath / "data/fleets/lab.yaml"))
    camera = "/agents/go2/global/camera_front"
    streams = ["color/ffmpeg", "aligned_depth/compressed_depth"]
    assert list(layout.cameras.values()) == [f"{camera}/{stream}" for stream in streams]
    assert (layout.frame, layout.heartbeats) == ("map", True)
    topics = {"/front/image": IMAGE, "/front/camera_info": INFO, "/a/image": IMAGE}
    layout = layout_of_topics(topics | {"/words": STRING})
    assert list(layout.cameras) == ["/a/image", "/front/image"]
    # Without a CameraInfo an image has no place in space.
    assert (layout.flat, layout.heartbeats) == (("/a/image",), False)
    assert layout_of_topics({"/global/agent_heartbeat": BEAT}).heartbeats


@needs_rerun
def test_a_canvas_waits_for_its_sinks_by_bytes_and_by_time_and_says_when_they_are_gone():
    recording = Mock()
    canvas = RerunCanvas(recording, ["the viewer"])
    for _ in range(100):
        canvas.settle(WINDOW_BYTES // 8)
    assert recording.flush.call_count == 12
    for second in range(1, 4):
        canvas.at(stamp_ns=0, received_ns=second * S)
        canvas.settle(0)
    assert recording.flush.call_count == 15
    recording.flush.side_effect = ValueError("no connection")
    with pytest.raises(SinkError, match="the viewer does not accept data any more: no connection"):
        canvas.close()
    canvas.close()
    recording.disconnect.assert_called_once_with()


@needs_rerun
def test_a_page_gets_the_viewers_program_by_the_way_it_asks_for_and_nothing_else():
    widget = cell.CellViewer().widget
    widget.wanted = "served"
    for name, kind in ((cell.PROGRAM, "text/javascript"), (cell.WASM, "application/wasm")):
        with urlopen(f"{widget.address}/{name}") as answer:  # noqa: S310
            assert answer.headers["Content-Type"] == kind
    other = widget.address.rpartition("/")[0]
    for wrong in (f"{widget.address}/widget.css", f"{other}/x/widget.js"):
        with pytest.raises(HTTPError, match="404"):
            urlopen(wrong)  # noqa: S310
    widget.wanted = "inline"
    assert cell.WASM in widget.program
    assert gzip.decompress(widget.packed)[:4] == b"\0asm"


@needs_rerun
def test_a_page_is_sent_what_waited_and_a_time_until_the_viewer_obeys():
    times = []
    viewer = cell.CellViewer(on_time=times.append)
    viewer.widget.send = Mock()

    def hear(*contents):
        for content in contents:
            viewer._heard(None, content, [])

    def shown(time_ns):
        return f'{{"type": "time_update", "time": {time_ns}.0}}'

    viewer.go_to("received", 7)
    viewer.send(b"part")
    hear("ready", '{"type": "recording_open"}')
    # It refuses a timeline of which it has read nothing yet, and goes on; later it is the user who scrubs.
    hear(shown(7000), shown(7), shown(8000))
    viewer.go_to("received", 8000)  # where it is: no event says that it obeys
    hear(shown(9000))
    part, *orders = viewer.widget.send.call_args_list
    assert part == call({"type": "rrd"}, buffers=[b"part"])
    assert [order.args[0]["timestamp_nanos"] for order in orders] == ["7", "7", "8000"]
    assert times == [7000, 7, 8000, 9000]


@pytest.mark.parametrize(
    ("value", "problem"),
    [
        (f"{__name__}:Gone", "AttributeError"),
        (f"{__name__}:Taken", "ValueError: the name 'image' is taken"),
        (f"{__name__}:S", "TypeError: 1000000000 is no class derived from Visualizer"),
        (f"{__name__}:Blind", "ValueError: it has no inputs"),
    ],
)
def test_an_entry_point_that_is_no_new_visualizer_is_a_problem_and_hides_no_other(
    monkeypatch, value, problem
):
    entries = [
        EntryPoint(name, at, GROUP) for name, at in (("a", value), ("b", f"{__name__}:Word"))
    ]
    monkeypatch.setattr("sfglab.view.session.entry_points", lambda **_: entries)
    session = Session()
    assert session.kinds["word"] is Word
    assert session.kinds["image"].__module__.startswith("sfglab.")
    assert [problem in told for told in session.problems] == [True]


def test_a_plugin_that_cannot_be_made_is_a_problem_and_hides_no_other(session):
    broken = type("Broken", (Word,), {"name": "broken", "__init__": None})
    session.kinds = {"broken": broken, "word": Word}
    for offer in session.offers({"/words": STRING}):
        session.add_offer(offer)
    assert [type(display.visualizer) for display in session.displays] == [Word]
    assert "visualizer 'broken': TypeError" in session.problems[-1]


@pytest.mark.live
async def test_a_topic_or_type_that_cannot_be_is_noted_at_its_display_and_others_go_on(
    here, paper, session
):
    unknown = type("Unknown", (Word,), {"inputs": (Input("text", "nobody_msgs/msg/Nothing"),)})
    bad = session.add(Word, "/not a topic"), session.add(unknown, "/words")
    good = session.add(Word, "/words")
    async with Bridge(here, session, paper):
        publisher = here.create_publisher(STRING, "/words", SENSOR_DATA)
        await publisher.wait_for_subscriptions(1)
        await until(lambda: good.slot.shown, lambda: publisher.publish_raw(said("word").cdr))
    for display, why in zip(bad, ("not a topic", "nobody_msgs/msg/Nothing"), strict=True):
        assert why in display.last_error
    assert not good.errors


@pytest.mark.live
async def test_a_viewer_that_hangs_costs_pictures_and_nothing_else(here, there, paper, session):
    go = threading.Event()
    others = set(threading.enumerate())
    paper.settle = lambda size_bytes: size_bytes and go.wait(60)
    slot = session.add(Word, "/words").slot
    async with Bridge(there, session, paper):
        publisher = here.create_publisher(STRING, "/words", SENSOR_DATA)
        await publisher.wait_for_subscriptions(1)
        say = partial(publisher.publish_raw, said("word").cdr)
        await until(lambda: slot.dropped >= 50, say, every_s=0.001)
        assert slot.waiting <= Word.queue
        assert slot.shown == 0, "the first one is not settled"
        go.set()
        await until(lambda: not slot.waiting)
    assert slot.received == slot.shown + slot.dropped
    assert (len(paper.drawn), paper.closed) == (slot.shown, 1)
    # Its thread may still be about to end.
    await until(lambda: not any("sfglab-view" in t.name for t in {*threading.enumerate()} - others))


@pytest.mark.live
async def test_a_display_that_was_removed_is_not_offered_again(here, paper, session):
    async with Bridge(here, session, paper, follow=("/",)):
        for topic in ("/a", "/b"):
            here.create_publisher(IMAGE, topic)
            await until(lambda: session.displays)
            [display] = session.displays
            assert display.topics == {"image": topic}
            session.remove(display.id)


@pytest.mark.live
async def test_a_sink_that_breaks_ends_the_view_with_its_reason(here, paper, session):
    paper.settle = Mock(side_effect=SinkError("the viewer is gone"))
    session.add("agent_heartbeats", "/global/agent_heartbeat")
    async with Bridge(here, session, paper) as bridge, asyncio.timeout(60):
        with pytest.raises(SinkError, match="the viewer is gone"):
            await bridge.failed()


def test_the_panel_is_the_session_as_widgets(session):
    pytest.importorskip("ipywidgets", reason="the notebook's widgets are not installed")
    topics = {}
    panel = Panel(session, lambda: topics)
    add_row, refused, rows = panel.widget.children
    kinds, topic, button = add_row.children
    topics["/a"] = IMAGE
    panel.refresh()
    assert topic.options == ("/a",)
    kinds.value, topic.value = "image", "/a"
    button.click()
    (display,) = session.displays
    (row,) = rows.children
    head, opacity, _, qos, counts = row.children
    on, _, rate, remove = head.children
    for value in (0.5, 7.0):
        opacity.value = value
    assert display.visualizer.settings["opacity"] == opacity.value == 0.5
    assert "opacity: given 7.0" in refused.value
    on.value, rate.value, qos.value = False, 5.0, "reliable, volatile"
    assert (display.enabled, display.slot.max_hz) == (False, 5.0)
    assert display.qos["image"].reliability.value == "reliable"
    display.fail("why")
    panel.refresh()
    assert counts.value == "0 received, 0 shown, 0 dropped; 1 failed: why"
    remove.click()
    assert session.displays == rows.children == ()
    panel.close()

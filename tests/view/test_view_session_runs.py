"""A session at work: stage, replay of real logs, the registry, the panel, and the live bridge."""

import asyncio
import gzip
import re
import subprocess
import sys
import threading
from dataclasses import make_dataclass
from functools import partial
from urllib.error import HTTPError
from urllib.request import urlopen

import numpy as np
import pytest
from seen import BEAT, heartbeat
from waiting import until

from sfglab.errors import InvalidValueError, MissingExtraError
from sfglab.fleet.fleet_file import load_fleet
from sfglab.messages import default_message, message_type, serialize, stamp_from_ns
from sfglab.qos import SENSOR_DATA
from sfglab.record import LogWriter
from sfglab.view import Input, Parameter, Visualizer
from sfglab.view.app import ViewOptions, session_for, view_log
from sfglab.view.arrivals import Arrival, capture_ns
from sfglab.view.bridge import Bridge
from sfglab.view.rerunning import (
    WINDOW_BYTES,
    RerunCanvas,
    layout_of_fleet,
    layout_of_topics,
    open_canvas,
)
from sfglab.view.session import Session
from sfglab.view.stage import Stage, replay
from sfglab.view.visualizer import SinkError

world = pytest.fixture(lambda live: live)

S = 1_000_000_000
IMAGE, STRING = "sensor_msgs/msg/Image", "std_msgs/msg/String"
INFO = "sensor_msgs/msg/CameraInfo"
VIDEO = "foxglove_msgs/msg/CompressedVideo"
needs_rerun = pytest.mark.skipif("not __import__('importlib').util.find_spec('rerun')")


class Word(Visualizer):
    """Somebody else's visualizer: text at its topic."""

    name = "word"
    inputs = (Input("text", STRING),)
    max_hz = None
    queue = 100
    parameters = (Parameter("prefix", "", "in front of every word"),)

    def show(self, update, canvas):
        if update.only.data == "crash":
            raise RuntimeError("a mistake in a plugin")
        canvas.log(self.entity, self["prefix"] + update.only.data)


@pytest.fixture
def session():
    return Session()


def said(text, topic="/words", received_ns=1):
    return Arrival(topic, STRING, received_ns, serialize(message_type(STRING)(data=text)))


def stamped(type_name, topic, stamp_ns, received_ns):
    message = default_message(type_name)
    message.header.stamp = stamp_from_ns(stamp_ns)
    return Arrival(topic, type_name, received_ns, serialize(message))


def words(paper):
    return [drawn.what[0] for drawn in paper.drawn]


def video(stamp_ns):
    return default_message(VIDEO, timestamp=stamp_from_ns(stamp_ns))


@pytest.mark.parametrize(
    ("arrival", "captured_ns"),
    [
        (stamped(IMAGE, "/a", 5 * S + 7, 9), 5 * S + 7),
        (stamped(IMAGE, "/a", 0, 9), 9),
        (said("x", received_ns=9), 9),
        (Arrival("/v", VIDEO, 9, serialize(video(3 * S))), 3 * S),
        (Arrival("/v", VIDEO, 9, b"", video(3 * S)), 3 * S),
    ],
)
def test_the_capture_stamp_is_read_from_the_bytes_and_without_one_is_the_reception(
    arrival, captured_ns
):
    assert capture_ns(arrival) == captured_ns


def test_displays_are_added_tuned_and_removed_while_messages_flow(paper, session):
    stage = Stage(session)

    def say(text):
        stage.deliver(said(text))
        for job in stage.jobs(0):
            job(paper)

    say("nobody listens")
    display = session.add(Word, "/words")
    say("one")
    session.tune(display.id, "prefix", "> ")
    say("two")
    stage.deliver(said("still waiting when it is switched off"))
    session.enable(display.id, enabled=False)
    say("off")
    session.enable(display.id, enabled=True)
    second = session.add(Word, "/words")
    say("three")
    session.remove(display.id)
    say("four")
    session.remove(second.id)
    say("five")
    assert words(paper)[:2] + words(paper)[4:] == ["one", "> two", "four"]
    assert set(words(paper)[2:4]) == {"> three", "three"}  # whose turn it is does not matter


def test_what_a_plugin_breaks_is_noted_at_its_display_and_hurts_no_other(paper, session):
    first, second = session.add(Word, "/words"), session.add(Word, "/others")
    garbled = Arrival("/words", STRING, 1, b"\0\1\0\0garbage")
    replay([said("crash"), garbled, said("fine"), said("too", "/others")], session, paper)
    assert (first.errors, second.errors, words(paper)) == (2, 0, ["fine", "too"])
    assert "not in these 11 bytes of CDR" in first.last_error


def test_a_type_that_only_the_log_knows_is_read_by_the_logs_definition(tmp_path):
    row = make_dataclass("ViewSpeedRow", [("speed_m_s", float)], frozen=True, kw_only=True)
    with LogWriter(tmp_path / "own.mcap") as log:
        log.write_row("speed", row(speed_m_s=2.5), log_time_ns=7)
    code = f"""
from sfglab.record import LogReader
from sfglab.view.arrivals import arrivals_of
with LogReader({str(tmp_path / "own.mcap")!r}) as log:
    (arrival,) = arrivals_of(log, log.topics)
    print(arrival.topic, arrival.message.speed_m_s, arrival.received_ns)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["/table/speed", "2.5", "7"]


@needs_rerun
@pytest.mark.parametrize(
    ("to", "error", "told"),
    [
        (["a.mcap"], InvalidValueError, "to: given 'a.mcap', allowed: FILE.rrd, viewer"),
        (["serve:x"], InvalidValueError, "to: given 'serve:x'"),
        (["gone/a.rrd"], SinkError, "there is no directory"),
        ([], InvalidValueError, "at least one place"),
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
    told = r"the view needs 'rerun', .*: pip install '.\[view\]' in a checkout"
    with pytest.raises(MissingExtraError, match=told):
        open_canvas(["a.rrd"])
    assert Session().add("image", "/a").visualizer.name == "image"
    heavy = {"rerun", "ipywidgets", "cv2", "scipy"}
    code = f"import sys, sfglab.view.app, sfglab.view.panel; assert not {heavy} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


@needs_rerun
def test_every_message_of_a_log_is_shown_whatever_the_budgets(tmp_path, make_image):
    image = make_image(np.zeros((2, 3), np.uint8), "mono8")
    with LogWriter(tmp_path / "a.mcap") as log:
        for number in range(100):
            log.write("/image", image, log_time_ns=number * S // 100)
    options = ViewOptions(to=(str(tmp_path / "a.rrd"),))
    (display,) = view_log(tmp_path / "a.mcap", options).displays
    assert (display.slot.shown, display.slot.dropped) == (100, 0)


def test_the_layout_has_a_view_for_every_camera_and_the_heartbeats_if_there_are_any(pytestconfig):
    layout = layout_of_fleet(load_fleet(pytestconfig.rootpath / "data/fleets/lab.yaml"))
    camera = "/agents/go2/global/camera_front"
    streams = ["color/ffmpeg", "aligned_depth/compressed_depth"]
    assert list(layout.cameras.values()) == [f"{camera}/{stream}" for stream in streams]
    assert (layout.frame, layout.heartbeats) == ("map", True)
    layout = layout_of_topics({"/b": IMAGE, "/a": IMAGE, "/words": STRING})
    assert (list(layout.cameras), layout.heartbeats) == (["/a", "/b"], False)
    assert layout_of_topics({"/global/agent_heartbeat": BEAT}).heartbeats


def test_silence_in_a_log_is_seen_when_it_begins_and_not_when_the_next_message_comes(
    paper, session
):
    topic = "/global/agent_heartbeat"
    session.add("agent_heartbeats", topic)
    beats = [("go2", 0), ("go2", S), ("pi1", 20 * S)]
    replay([Arrival(topic, BEAT, ns, b"", heartbeat(agent)) for agent, ns in beats], session, paper)
    life = "/agents/go2/heartbeat/life"
    changes = [d.time[1] / S for d in paper.drawn if d.entity == life and not d.static]
    assert changes == pytest.approx([0.0, 2.5, 4.0], abs=0.3)  # alive, late, lost


class Recording:
    """Stands for Rerun's recording: counts what is waited for, and breaks when told to."""

    flushed, broken, disconnected = 0, False, 0

    def set_time(self, *_, **__):
        pass

    def flush(self, **_):
        self.flushed += 1
        if self.broken:
            raise ValueError("nobody listens")

    def disconnect(self):
        self.disconnected += 1


@needs_rerun
def test_a_canvas_waits_for_its_sinks_by_bytes_and_by_time_and_says_when_they_are_gone():
    recording = Recording()
    canvas = RerunCanvas(recording, ["the viewer"])
    for number in range(100):
        canvas.at(stamp_ns=number, received_ns=number)
        canvas.settle(WINDOW_BYTES // 8)
    assert recording.flushed == 12
    for number in range(1, 4):
        canvas.at(stamp_ns=0, received_ns=number * S + 100)
        canvas.settle(0)
    assert recording.flushed == 15
    recording.broken = True
    with pytest.raises(SinkError, match="the viewer does not take what is shown: nobody listens"):
        canvas.close()
    canvas.close()
    assert recording.disconnected == 1


def test_a_notebook_without_rerun_s_widget_is_told_what_to_install(monkeypatch):
    from sfglab.view import cell

    monkeypatch.setattr(cell, "find_spec", lambda _: None)
    with pytest.raises(MissingExtraError, match="the view in a notebook needs 'rerun_notebook'"):
        cell.CellViewer()


def test_a_page_gets_the_viewer_by_the_way_it_asks_for_and_nothing_else():
    pytest.importorskip("rerun_notebook", reason="the extra 'view' is not installed")
    from sfglab.view import cell

    times, sent = [], []
    viewer = cell.CellViewer(still=b"png", on_time=times.append)
    viewer.go_to("received", 7)
    viewer.send(b"part")
    viewer.widget.send = lambda content, buffers=None: sent.append((content, buffers))
    viewer.widget.wanted = "served"
    address = viewer.widget.address
    for name, kind in ((cell.PROGRAM, "text/javascript"), (cell.WASM, "application/wasm")):
        with urlopen(f"{address}/{name}") as answer:  # noqa: S310
            assert answer.headers["Content-Type"] == kind
    for wrong in (f"{address}/widget.css", f"{address.rpartition('/')[0]}/x/widget.js"):
        with pytest.raises(HTTPError, match="404"):
            urlopen(wrong)  # noqa: S310
    viewer.widget.wanted = "inline"
    assert "re_viewer_bg.wasm" in viewer.widget.program
    assert gzip.decompress(viewer.widget.packed)[:4] == b"\0asm"
    viewer._heard(None, "ready", [])
    viewer._heard(None, '{"type": "recording_open"}', [])
    # It refuses a timeline of which it has read nothing yet, and goes on; later it is the user who scrubs.
    for shown_ns in (7000, 7, 8000):
        viewer._heard(None, f'{{"type": "time_update", "time": {shown_ns}.0}}', [])
    viewer.go_to("received", 8000)  # where it is: no event says that it obeys
    viewer._heard(None, '{"type": "time_update", "time": 9000.0}', [])
    orders = [(what["type"], what.get("timestamp_nanos")) for what, _ in sent]
    assert orders == [("rrd", None), ("time_ctrl", "7"), ("time_ctrl", "7"), ("time_ctrl", "8000")]
    assert sent[0][1] == [b"part"]
    assert times == [7000, 7, 8000, 9000]


def test_every_request_of_the_viewers_program_passes_the_one_that_refuses_the_network():
    pytest.importorskip("rerun_notebook", reason="the extra 'view' is not installed")
    from sfglab.view import cell

    program = (cell._files() / cell.PROGRAM).read_text("utf-8")
    call = re.compile(r"[^\w.\"/](?:\w+\.)?fetch\(")
    calls = [line.strip() for line in program.splitlines() if call.search(line)]
    others = [line for line in calls if not re.search(r"= (?:arg0\.)?fetch\(", line)]
    assert others == ["const response = await fetch(url);"]  # the viewer itself
    assert not re.search(r"new (XMLHttpRequest|WebSocket|EventSource|Worker)\(", program)
    assert program.count('new URL("./re_viewer_bg.wasm", import.meta.url)') == 1


def test_a_plugin_that_cannot_be_made_is_a_problem_of_a_logs_view_and_hides_no_other(monkeypatch):
    class Broken(Word):
        name = "broken"

        def __init__(self, *_):
            raise OSError("no model")

    kinds = {"broken": Broken, "word": Word}
    monkeypatch.setattr("sfglab.view.session.installed_visualizers", lambda: (kinds, []))
    session = session_for({"/words": STRING}, ViewOptions())
    assert [display.visualizer.name for display in session.displays] == ["word"]
    assert session.problems == ["visualizer 'broken': OSError: no model"]


@pytest.mark.live
async def test_the_bridge_shows_what_is_published_and_follows_new_topics(
    here, there, paper, make_image, session
):
    topic = "/global/go2/camera_front/color/image_raw"
    session.kinds["fails"] = type(
        "Fails", (Word,), {"name": "fails", "inputs": (Input("i", IMAGE),)}
    )
    session.kinds["fails"].__init__ = None  # a mistake in a plug-in
    async with Bridge(there, session, paper, follow=("/",)):
        publisher = here.create_publisher(IMAGE, topic, SENSOR_DATA)
        await publisher.wait_for_subscriptions(1)
        (display,) = session.displays
        assert "visualizer 'fails'" in session.problems[-1]
        picture = make_image(np.zeros((2, 3), np.uint8), "mono8")
        await until(lambda: paper.drawn, lambda: publisher.publish(picture))
        session.remove(display.id)
        display = session.add("depth_cloud", {"depth": topic, "info": "/info"})
        cdr = stamped(IMAGE, topic, 5, 5).cdr
        await until(lambda: display.slot.received, lambda: publisher.publish_raw(cdr))
        assert session.displays == (display,)  # what was removed stays away
    assert paper.closed == 1
    # Its thread may still be about to end.
    await until(lambda: not any(t.name.startswith("sfglab-view") for t in threading.enumerate()))


@pytest.mark.live
async def test_a_topic_or_type_that_cannot_be_is_noted_at_its_display_and_others_go_on(
    here, paper, session
):
    class Unknown(Word):
        name = "unknown"
        inputs = (Input("text", "nobody_msgs/msg/Nothing"),)

    bad, unknown = session.add(Word, "/not a topic"), session.add(Unknown, "/words")
    good = session.add(Word, "/words")
    async with Bridge(here, session, paper):
        publisher = here.create_publisher(STRING, "/words", SENSOR_DATA)
        await publisher.wait_for_subscriptions(1)
        await until(lambda: good.slot.shown, lambda: publisher.publish_raw(said("word").cdr))
    assert "not a topic" in bad.last_error
    assert "nobody_msgs/msg/Nothing" in unknown.last_error
    assert not good.errors


@pytest.mark.live
async def test_a_viewer_that_hangs_costs_pictures_and_nothing_else(here, there, paper, session):
    go = threading.Event()
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
    assert len(paper.drawn) == slot.shown


@pytest.mark.live
async def test_a_sink_that_breaks_ends_the_view_with_its_reason(here, paper, session):
    def settle(_size_bytes):
        raise SinkError("the viewer is gone")

    paper.settle = settle
    session.add("agent_heartbeats", "/global/agent_heartbeat")
    async with Bridge(here, session, paper) as bridge, asyncio.timeout(60):
        with pytest.raises(SinkError, match="the viewer is gone"):
            await bridge.failed()


def test_the_panel_is_the_session_as_widgets(session):
    pytest.importorskip("ipywidgets", reason="the notebook's widgets are not installed")
    from sfglab.view.panel import Panel

    topics = {}
    panel = Panel(session, lambda: topics)
    (kinds, topic, button), said_, rows = (
        panel.widget.children[0].children,
        *panel.widget.children[1:],
    )
    topics["/a"] = IMAGE
    panel.refresh()
    assert topic.options == ("/a",)
    kinds.value, topic.value = "image", "/a"
    button.click()
    (display,) = session.displays
    (row,) = rows.children
    head, opacity, depth, qos, counts = row.children
    on, _, rate, remove = head.children
    opacity.value = 0.5
    assert display.visualizer.settings["opacity"] == 0.5
    opacity.value = 7.0
    assert display.visualizer.settings["opacity"] == opacity.value == 0.5
    assert "opacity: given 7.0" in said_.value
    on.value, rate.value, depth.value, qos.value = False, 5.0, 3.0, "reliable, volatile"
    assert (display.enabled, display.slot.max_hz) == (False, 5.0)
    assert display.visualizer.settings["depth_max_m"] == 3.0
    assert display.qos["image"].reliability.value == "reliable"
    display.fail("why")
    panel.refresh()
    assert counts.value == "0 received, 0 shown, 0 dropped; 1 failed: why"
    remove.click()
    assert session.displays == rows.children == ()
    panel.close()

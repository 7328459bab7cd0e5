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
from sfglab.lab.experiments.visualisation.plugin import installed
from sfglab.lab.experiments.visualisation.recordings import read_recording
from sfglab.messages import default_message, message_type, serialize, stamp_from_ns
from sfglab.qos import SENSOR_DATA
from sfglab.record import LogError, LogWriter
from sfglab.view import Approximate, Input, Parameter, Visualizer
from sfglab.view.app import ViewOptions, view_log
from sfglab.view.arrivals import Arrival, capture_ns, open_log
from sfglab.view.bridge import Bridge
from sfglab.view.rerunning import (
    WINDOW_BYTES,
    RerunCanvas,
    layout_of_fleet,
    layout_of_topics,
    open_canvas,
)
from sfglab.view.session import Session, available
from sfglab.view.stage import Stage, replay
from sfglab.view.visualizer import SinkError

world = pytest.fixture(lambda live: live)

S = 1_000_000_000
IMAGE, STRING = "sensor_msgs/msg/Image", "std_msgs/msg/String"


class Word(Visualizer):
    """Somebody else's visualizer: text at its topic."""

    name = "word"
    inputs = (Input(role="text", type=STRING),)
    max_hz = None
    queue = 100
    parameters = (Parameter(name="prefix", default="", help="in front of every word"),)

    def show(self, update, canvas):
        if update.only.data == "crash":
            raise RuntimeError("a mistake in a plugin")
        canvas.log(self.entity, self["prefix"] + update.only.data)


class Pair(Visualizer):
    name = "pair"
    inputs = (
        Input(role="image", type=IMAGE),
        Input(role="info", type="sensor_msgs/msg/CameraInfo"),
    )
    sync = Approximate(slop_ns=5)

    def show(self, update, canvas):
        canvas.log(self.entity, (update.stamp_ns, update.received_ns, sorted(update.messages)))


@pytest.fixture
def session():
    return Session()


def said(text, topic="/words", received_ns=1):
    return Arrival(topic, STRING, received_ns, serialize(message_type(STRING)(data=text)))


def stamped(type_name, topic, stamp_ns, received_ns):
    message = default_message(type_name)
    message.header.stamp = stamp_from_ns(stamp_ns)
    return Arrival(topic, type_name, received_ns, serialize(message))


def test_the_capture_stamp_is_read_from_the_bytes_and_without_one_is_the_reception():
    assert capture_ns(stamped(IMAGE, "/a", 5 * S + 7, 9)) == 5 * S + 7
    assert capture_ns(stamped(IMAGE, "/a", 0, 9)) == 9
    assert capture_ns(said("x", received_ns=9)) == 9
    video = default_message("foxglove_msgs/msg/CompressedVideo", timestamp=stamp_from_ns(3 * S))
    assert (
        capture_ns(Arrival("/v", "foxglove_msgs/msg/CompressedVideo", 9, serialize(video))) == 3 * S
    )
    assert capture_ns(Arrival("/v", "foxglove_msgs/msg/CompressedVideo", 9, b"", video)) == 3 * S


def test_displays_are_added_tuned_and_removed_while_messages_flow(paper, session):
    stage = Stage(session)

    def say(text):
        stage.deliver(said(text))
        while (job := stage.ready()) is not None:
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
    shown = [d.what[0] for d in paper.drawn]
    assert shown[:2] == ["one", "> two"]
    assert sorted(shown[2:4]) == ["> three", "three"]  # whose turn it is first does not matter
    assert shown[4:] == ["four"]


def test_what_a_plugin_breaks_is_noted_at_its_display_and_hurts_no_other(paper, session):
    first, second = session.add(Word, "/words"), session.add(Word, "/others")
    garbled = Arrival("/words", STRING, 1, b"\0\1\0\0garbage")
    assert (
        replay([said("crash"), garbled, said("fine"), said("too", "/others")], session, paper) == 4
    )
    assert first.errors == 2
    assert "not in these 11 bytes of CDR" in first.last_error
    assert (second.errors, [d.what[0] for d in paper.drawn]) == (0, ["fine", "too"])


def test_messages_that_belong_together_are_shown_together_with_both_times(paper, session):
    display = session.add(Pair, {"image": "/image", "info": "/info"})
    info = "sensor_msgs/msg/CameraInfo"
    arrivals = [
        stamped(IMAGE, "/image", 100, 1000),
        stamped(info, "/info", 100, 1010),
        stamped(IMAGE, "/image", 200, 1020),
        stamped(info, "/info", 300, 1030),
    ]
    replay(arrivals, session, paper)
    assert [d.what[0] for d in paper.drawn] == [(100, 1010, ["image", "info"])]
    assert paper.drawn[0].time == (100, 1010)
    assert display.slot.counts.unmatched == 1


def test_while_the_sink_is_slow_one_picture_waits_and_the_others_are_dropped_and_told(
    session, paper, make_image
):
    display = session.add("image", "/image")
    session.limit(display.id, None)
    stage = Stage(session)
    cdr = serialize(make_image(np.zeros((2, 3), np.uint8), "mono8"))
    for number in range(300):
        stage.deliver(Arrival("/image", IMAGE, number, cdr))
        assert display.slot.counts.waiting == 1
        if number % 100 == 99:
            stage.ready()(paper)
    counts = display.slot.counts
    assert (counts.received, counts.shown, counts.waiting, counts.dropped) == (300, 3, 0, 297)


def test_a_type_that_only_the_log_knows_is_read_by_the_logs_definition(tmp_path):
    row = make_dataclass(
        "ViewSpeedRow", [("speed_m_s", float)], frozen=True, slots=True, kw_only=True
    )
    path = tmp_path / "own.mcap"
    with LogWriter(path) as log:
        log.write_row("speed", row(speed_m_s=2.5), log_time_ns=7)
    code = f"""
from sfglab.view.arrivals import open_log
with open_log({str(path)!r}) as log:
    (topic,) = log.topics
    (arrival,) = log.arrivals([topic])
    print(topic, arrival.message.speed_m_s, arrival.received_ns)
"""
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["/table/speed", "2.5", "7"]


def test_a_log_or_a_place_that_is_none_is_one_clear_sentence(tmp_path):
    with pytest.raises(LogError, match="nothing"), open_log(tmp_path / "nothing.mcap"):
        pass
    notes = tmp_path / "notes.txt"
    notes.write_text("no bag")
    with pytest.raises(LogError, match=r"notes\.txt: not an MCAP file, nor a bag"), open_log(notes):
        pass
    pytest.importorskip("rerun", reason="the extra 'view' is not installed")
    for place in ("a.mcap", "serve:x"):
        with pytest.raises(
            InvalidValueError, match=f"to: given '{place}', allowed: FILE.rrd, viewer"
        ):
            open_canvas([place])
    with pytest.raises(SinkError, match="there is no directory"):
        open_canvas([str(tmp_path / "gone" / "a.rrd")])
    with pytest.raises(InvalidValueError, match="at least one place"):
        open_canvas([])


def test_what_a_package_ships_that_is_no_visualizer_is_told(tmp_path):
    """What else a package may bring along, the experiment tries."""
    with installed(tmp_path):
        _, broken = available()
    assert len(broken) == 3
    for wrong, why in (("plugin:Gone", "cannot be loaded"), ("math:pi", "derived from Visualizer")):
        assert any(wrong in told and why in told for told in broken)


def test_without_rerun_there_is_one_sentence_and_importing_the_view_loads_nothing_heavy(
    monkeypatch,
):
    monkeypatch.setitem(sys.modules, "rerun", None)
    with pytest.raises(
        MissingExtraError,
        match=r"the view needs 'rerun', .*: pip install '.\[view\]' in a checkout",
    ):
        open_canvas(["a.rrd"])
    assert Session().add("image", "/a").visualizer.name == "image"
    heavy = {"rerun", "ipywidgets", "cv2", "scipy"}
    code = f"import sys, sfglab.view.app, sfglab.view.panel; assert not {heavy} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_a_log_is_thinned_by_the_budgets_where_that_is_asked_for(tmp_path, make_image):
    pytest.importorskip("rerun", reason="the extra 'view' is not installed")
    with LogWriter(tmp_path / "a.mcap") as log:
        for number in range(100):
            log.write(
                "/image",
                make_image(np.zeros((2, 3), np.uint8), "mono8"),
                log_time_ns=number * S // 100,
            )
    for thin, shown in ((False, 100), (True, 30)):
        (report,) = view_log(
            tmp_path / "a.mcap", ViewOptions(to=(str(tmp_path / "a.rrd"),), thin=thin)
        )
        assert (report.shown, report.dropped) == (shown, 100 - shown)


def test_the_layout_has_a_view_for_every_camera_and_the_heartbeats_if_there_are_any(pytestconfig):
    from sfglab.fleet.fleet_file import load_fleet

    layout = layout_of_fleet(load_fleet(pytestconfig.rootpath / "data/fleets/lab.yaml"))
    assert list(layout.cameras.values()) == [
        "/agents/go2/global/camera_front/color/ffmpeg",
        "/agents/go2/global/camera_front/aligned_depth/compressed_depth",
    ]
    assert (layout.frame, layout.heartbeats) == ("map", True)
    topics = {"/b": IMAGE, "/a": "sensor_msgs/msg/CompressedImage", "/words": STRING}
    layout = layout_of_topics(topics)
    assert list(layout.cameras.values()) == ["/a", "/b"]
    assert not layout.heartbeats
    assert layout_of_topics({**topics, "/global/agent_heartbeat": BEAT}).heartbeats


class Slow:
    """A surface that takes its time: nothing is done until it is let go."""

    def __init__(self, paper):
        self._paper = paper
        self.go = threading.Event()

    def __getattr__(self, name):
        return getattr(self._paper, name)

    def settle(self, size_bytes):
        if size_bytes:
            assert self.go.wait(60)


def test_silence_in_a_log_is_seen_when_it_begins_and_not_when_the_next_message_comes(paper):
    session, topic = Session(), "/global/agent_heartbeat"
    session.add("agent_heartbeats", topic)
    beats = (("go2", 0), ("go2", S), ("pi1", 20 * S))
    replay(
        [Arrival(topic, BEAT, ns, serialize(heartbeat(agent))) for agent, ns in beats],
        session,
        paper,
    )
    said_ = [d for d in paper.at_entity("/agents/go2/heartbeat/life") if not d.static]
    assert len(said_) == 3  # alive, late, lost
    assert said_[1].time[1] == pytest.approx(2.5 * S, abs=0.3 * S)
    assert said_[2].time[1] == pytest.approx(4.0 * S, abs=0.3 * S)


def test_an_interrupted_replay_leaves_a_whole_file(tmp_path):
    """Ctrl-C in the middle: what was drawn up to then is in the file."""
    rr = pytest.importorskip("rerun", reason="the extra 'view' is not installed")

    class Interrupting(Word):
        def show(self, update, canvas):
            if update.only.data == "word 2":
                raise KeyboardInterrupt
            canvas.log(self.entity, rr.TextLog(update.only.data))

    with LogWriter(tmp_path / "words.mcap") as log:
        for number in range(4):
            log.write("/words", message_type(STRING)(data=f"word {number}"), log_time_ns=number)
    session, out = Session(), tmp_path / "words.rrd"
    session.add(Interrupting, "/words")
    with pytest.raises(KeyboardInterrupt):
        view_log(tmp_path / "words.mcap", ViewOptions(to=(str(out),)), session=session)
    assert [s.content for s in read_recording(out)["/words", "TextLog:text"]] == [
        ["word 0"],
        ["word 1"],
    ]


class Recording:
    """Stands for Rerun's recording: counts what is waited for, and breaks when told to."""

    def __init__(self):
        self.flushed, self.broken, self.disconnected = 0, False, 0

    def set_time(self, *_, **__):
        pass

    def flush(self, **_):
        self.flushed += 1
        if self.broken:
            raise ValueError("nobody listens")

    def disconnect(self):
        self.disconnected += 1


def test_a_canvas_waits_for_its_sinks_by_bytes_and_by_time_and_says_when_they_are_gone():
    pytest.importorskip("rerun", reason="the extra 'view' is not installed")
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
        canvas.flush()
    with pytest.raises(SinkError):
        canvas.close()
    canvas.close()
    assert recording.disconnected == 1


def test_a_notebook_without_rerun_s_widget_is_told_what_to_install(monkeypatch):
    pytest.importorskip("rerun", reason="the extra 'view' is not installed")
    monkeypatch.setattr("sfglab.view.cell.find_spec", lambda _: None)
    with pytest.raises(MissingExtraError, match="the view in a notebook needs 'rerun_notebook'"):
        open_canvas(["notebook"]).show_in_notebook()
    with pytest.raises(InvalidValueError, match="the notebook alone"):
        open_canvas(["notebook", "a.rrd"])


def test_a_page_gets_the_viewer_by_the_way_it_asks_for_and_nothing_else():
    pytest.importorskip("rerun_notebook", reason="the extra 'view' is not installed")
    from sfglab.view import cell

    times = []
    viewer = cell.CellViewer(still=b"png", on_time=times.append)
    viewer.go_to("received", 7)
    viewer.send(b"part")
    sent = []
    viewer.widget.send = lambda content, buffers=None: sent.append((content, buffers))
    viewer.widget.wanted = "served"
    for name, kind in ((cell.PROGRAM, "text/javascript"), (cell.WASM, "application/wasm")):
        with urlopen(f"{viewer.widget.address}/{name}") as answer:  # noqa: S310
            assert answer.headers["Content-Type"] == kind
    address = viewer.widget.address
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
    calls = [line for line in program.splitlines() if call.search(line)]
    others = [line for line in calls if not re.search(r"= (?:arg0\.)?fetch\(", line)]
    assert [line.strip() for line in others] == [
        "const response = await fetch(url);"
    ]  # the viewer itself
    assert not re.search(r"new (XMLHttpRequest|WebSocket|EventSource|Worker)\(", program)
    assert program.count('new URL("./re_viewer_bg.wasm", import.meta.url)') == 1


@pytest.mark.live
async def test_the_bridge_shows_what_is_published_and_follows_new_topics(
    here, there, paper, make_image, session
):
    topic = "/global/go2/camera_front/color/image_raw"
    async with Bridge(there, session, paper, follow=("/",)):
        publisher = here.create_publisher(IMAGE, topic, SENSOR_DATA)
        await publisher.wait_for_subscriptions(1)
        assert [d.visualizer.name for d in session.displays] == ["image"]
        picture = make_image(np.zeros((2, 3), np.uint8), "mono8")
        await until(lambda: paper.drawn, lambda: publisher.publish(picture))
        session.remove(session.displays[0].id)
        display = session.add(Pair, {"image": topic, "info": "/info"})
        removed = session.offers({topic: IMAGE})[0].kind
        cdr = stamped(IMAGE, topic, 5, 5).cdr
        await until(lambda: display.slot.counts.received, lambda: publisher.publish_raw(cdr))
        assert removed not in [d.visualizer.name for d in session.displays]  # it stays away
    assert paper.closed == 1
    # Its thread may still be about to end.
    await until(lambda: not [t for t in threading.enumerate() if t.name.startswith("sfglab-view")])


@pytest.mark.live
async def test_a_topic_or_type_that_cannot_be_is_noted_at_its_display_and_others_go_on(
    here, paper, session
):
    class Unknown(Word):
        name = "unknown"
        inputs = (Input(role="text", type="nobody_msgs/msg/Nothing"),)

    bad, unknown = session.add(Word, "/not a topic"), session.add(Unknown, "/words")
    good = session.add(Word, "/words")
    async with Bridge(here, session, paper):
        publisher = here.create_publisher(STRING, "/words", SENSOR_DATA)
        await publisher.wait_for_subscriptions(1)
        await until(lambda: paper.drawn, lambda: publisher.publish_raw(said("word").cdr))
    assert "not a topic" in bad.last_error
    assert "nobody_msgs/msg/Nothing" in unknown.last_error
    assert good.slot.counts.shown > 0
    assert (good.errors, good.last_error) == (0, "")


@pytest.mark.live
async def test_a_viewer_that_hangs_costs_pictures_and_nothing_else(here, there, paper, session):
    slow = Slow(paper)
    display = session.add(Word, "/words")
    async with Bridge(there, session, slow):
        publisher = here.create_publisher(STRING, "/words", SENSOR_DATA)
        await publisher.wait_for_subscriptions(1)
        say = partial(publisher.publish_raw, said("word").cdr)
        await until(lambda: display.slot.counts.pushed_out >= 50, say, every_s=0.001)
        assert display.slot.counts.waiting <= Word.queue
        assert display.slot.counts.shown == 0, "the first one is not settled"
        slow.go.set()
        await until(lambda: not display.slot.counts.waiting)
    counts = display.slot.counts
    assert counts.received == counts.shown + counts.dropped
    assert len(paper.drawn) == counts.shown


@pytest.mark.live
async def test_a_sink_that_breaks_ends_the_view_with_its_reason(here, paper, session):
    class Broken(type(paper)):
        def settle(self, _size_bytes):
            raise SinkError("the viewer is gone")

    session.add("agent_heartbeats", "/global/agent_heartbeat")
    async with Bridge(here, session, Broken()) as bridge:
        async with asyncio.timeout(60):
            with pytest.raises(SinkError, match="the viewer is gone"):
                await bridge.failed()


def test_the_panel_is_the_session_as_widgets_which_are_found_by_display_and_parameter(session):
    pytest.importorskip("ipywidgets", reason="the notebook's widgets are not installed")
    from sfglab.view.panel import Panel

    panel = Panel(session, lambda: {"/a": IMAGE})
    adding, said_, rows = panel.widget.children
    kinds, topic, button = adding.children
    kinds.value, topic.value = "image", "/a"
    button.click()
    (display,) = session.displays
    (row,) = rows.children
    head, opacity, *_ = row.children
    opacity.value = 0.5
    assert display.visualizer.settings["opacity"] == 0.5
    opacity.value = 7.0
    assert display.visualizer.settings["opacity"] == opacity.value == 0.5
    assert "opacity: given 7.0" in said_.value
    panel.parameter(display.id, "opacity").value = 0.25
    assert display.visualizer.settings["opacity"] == 0.25
    with pytest.raises(
        InvalidValueError, match="parameter: given 'speed', allowed: depth_max_m, opacity"
    ):
        panel.parameter(display.id, "speed")
    head.children[2].value = 5.0
    assert display.slot.budget.max_hz == 5.0
    reliable = next(w for w in row.children if getattr(w, "description", "").startswith("QoS"))
    reliable.value = "reliable, volatile"
    assert display.qos["image"].reliability.value == "reliable"
    panel.refresh()
    assert row.children[-1].value == "0 received, 0 shown, 0 dropped"
    head.children[3].click()
    assert session.displays == rows.children == ()
    with pytest.raises(InvalidValueError, match="display: given 'image-1'"):
        panel.parameter(display.id, "opacity")
    panel.close()

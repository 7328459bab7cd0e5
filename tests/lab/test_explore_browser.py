"""An explorer as readers have it: in a real JupyterLab, in a real browser, with a mouse."""

import json
import time
from contextlib import closing, suppress
from urllib.request import Request, urlopen

import cv2
import numpy as np
import pytest
from bags import write_bag
from lab_page import ANSWER_S, HANDLE, ROOT, run_all, served_lab, write_notebook
from machine import open_browser
from waiting import wait_until

from sfglab.lab.experiments.transfer import transfer_curves
from sfglab.lab.explore.viewer import LogViewer
from sfglab.messages import default_message, message_type, stamp_from_ns
from sfglab.record import LogWriter
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.scene.files import load_scene

pytestmark = [pytest.mark.live, pytest.mark.browser, pytest.mark.timeout(1800)]

PICTURES = """from IPython.display import display
from sfglab import soc
from sfglab.errors import InvalidValueError
from sfglab.lab.experiments import gateways, lifecycle, transmission
from sfglab.lab.explore import Pressed, part
from sfglab.lab.explore.mapping import PressedMapping
from sfglab.lab.paths import find_project
from sfglab.spatial.scene.files import load_scene
class Lights(Pressed):
    '''A figure with lights.'''
    on = set()
    def take(self, name):
        if name == "c":
            raise InvalidValueError("light", name, "a, b")
        self.on.symmetric_difference_update({name})
    def draw(self, figure):
        axes = figure.subplots()
        for x, name in enumerate("abc"):
            part(name, axes.bar(x, 1, color="gold" if name in self.on else "grey", label=name)[0])
    def titles(self):
        return {"a": f"light a, {'on' if 'a' in self.on else 'off'}"}
display(
    Lights((6, 2)),
    lifecycle.press_lifecycle(), transmission.Timeline(), gateways.press_core(),
    PressedMapping(soc.load_graph(find_project().data / "graphs/driving.yaml"), soc.ZCU104))"""
TITLE = "document.querySelector('.jp-OutputArea [id=\"press:%s\"] title')?.textContent"
SAYS = "document.querySelector('.jp-OutputArea')?.textContent.includes(%r)"
PRESSED = [
    ("a", "document.querySelector('.jp-OutputArea title').textContent === 'light a, on'"),
    ("c", SAYS % "light: given 'c'"),
    ("UNKNOWN/HEARD", SAYS % "1: HEARD in UNKNOWN leads to QUERYING: QUERY"),
    ("LOST", SAYS % "put into LOST"),
    ("REJOINING/SILENT", SAYS % "agent in LOST: given SILENT, allowed: CHANGED"),
    ("a/DATA/2", TITLE % "a/DATA/2" + "?.endsWith('lost; press to let it pass')"),
    ("START/LOCATED", SAYS % "1: LOCATED in START leads to REQUEST"),
    ("CLAIM/GRANTED", SAYS % "gateway core in REQUEST: given GRANTED, allowed: SENT"),
    ("topic:/A", SAYS % "/A is mapped to gateway"),
    ("node:camera", SAYS % "fixed in hardware, where it has no implementation"),
]
"""Parts to press one after the other, and what is true afterwards."""
VIEWER = """from sfglab.lab.explore.viewer import LogViewer
LogViewer({log!r})"""
STEP = "document.querySelector('.jp-OutputArea')?.innerText.includes('shown: step %d of')"
ASKED = "performance.getEntriesByType('resource').map(e => new URL(e.name)).map(u => u.hostname || u.protocol)"
PART = """(() => { const part = document.querySelector('.jp-OutputArea [id="press:%s"]');
  if (!part) return null;
  part.scrollIntoView({block: 'center'});
  const box = part.getBoundingClientRect();
  return [box.x + box.width / 2, box.y + box.height / 2]; })()"""
REDRAWN = (
    "void (onpointerdown = e => (b => b && (b.innerHTML += ''))(e.target.closest('.sfglab-press')))"
)
LOOKS = "getComputedStyle(document.querySelector('.jp-OutputArea [id=\"press:%s\"] path')).fill"
FRAME = "document.querySelector('.jp-OutputArea iframe')"
INSIDE = """(() => {
  const frame = document.querySelector('.jp-OutputArea iframe');
  frame.scrollIntoView({block: 'center'});
  const seen = [...frame.contentDocument.querySelectorAll('legend, label, button, p, div')].filter(
    e => (e.innerText || '').trim() === %s || e.getAttribute('aria-label') === %s);
  const shown = seen.map(e => e.getBoundingClientRect()).find(r => r.width > 0 && r.height > 0);
  const at = frame.getBoundingClientRect();
  return shown ? [at.x + shown.x + shown.width / 2, at.y + shown.y + shown.height / 2] : null;
})()"""


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A checkout that JupyterLab serves, and its address."""
    folder = tmp_path_factory.mktemp("lab")
    for name in ("data", "figures", "notebooks"):
        (folder / name).symlink_to(ROOT / name)
    option = "--ServerApp.disable_check_xsrf=True"
    with served_lab(folder, tmp_path_factory.mktemp("home"), option) as address:
        yield folder, address


@pytest.fixture
def browser(lab):
    """One browser per test: a page that is closed may ask whether to save, and no test would answer."""
    with closing(open_browser(1300, 1100)) as made:
        yield made


@pytest.fixture(name="run")
def _run(lab, browser):
    """A function that opens a notebook of one cell and runs it; its kernel ends with the test."""
    folder, address = lab

    def run(cell):
        write_notebook(folder / "explore.ipynb", cell)
        browser.open(f"{address}/lab/tree/explore.ipynb?reset")
        run_all(browser)

    yield run
    api = f"{address}/api"
    for session in json.loads(served(f"{api}/sessions")):
        served(f"{api}/sessions/{session['id']}", "DELETE")
    # The next notebook of this name would be given a kernel that is about to end, and never be ready.
    wait_until(lambda: served(f"{api}/sessions") == served(f"{api}/kernels") == b"[]", ANSWER_S)


def served(address, method="GET"):
    with suppress(OSError), urlopen(Request(address, method=method), timeout=ANSWER_S) as answer:  # noqa: S310
        return answer.read()
    return b""


DRAWN = """from sfglab.lab.experiments import transfer
from sfglab.lab.explore import explore
explore(transfer.exp)"""
FIGURE = "document.querySelector('.sfglab-vega svg')"
DOTS = "[...document.querySelectorAll('.sfglab-vega .mark-symbol [aria-label]')]"
RECORD = f"""void (() => {{
  const seen = globalThis.seen = {{moves: [], frames: []}};
  const row = [...document.querySelectorAll('.widget-slider')].find(
    r => r.querySelector('label').innerText.trim() === 'message bytes');
  const readout = row.querySelector('.widget-readout');
  const move = () => seen.moves.at(-1)?.[1] === +readout.textContent ||
    seen.moves.push([performance.now(), +readout.textContent]);
  new MutationObserver(move).observe(readout, {{childList: true, characterData: true, subtree: true}});
  let last = '';
  // The time that a frame is given may lie before events that it shows, if the page is late.
  const look = () => {{
    const words = {DOTS}.map(d => d.ariaLabel);
    if (words.join() !== last) seen.frames.push([performance.now(), words]);
    last = words.join();
    requestAnimationFrame(look);
  }};
  requestAnimationFrame(look);
}})()"""
"""Records each move of the slider, and each frame in which the figure shows other values."""
LAST_MOVE_IS_SHOWN = (
    "seen.frames.at(-1)[1][0].includes(` at ${seen.moves.at(-1)[1].toLocaleString('en-US')} B`)"
)
DARK = "void jupyterapp.commands.execute('apputils:change-theme', {theme: 'JupyterLab Dark'})"
FITS = f"(w => w > 200 && w <= {FIGURE}.closest('.sfglab-vega').clientWidth)({FIGURE}.clientWidth)"


def words_of(picture):
    return [row["words"] for row in picture.values() if row["kind"] == "dot"]


def size_of(words):
    return int(words[0].split(" at ")[1].removesuffix(" B").replace(",", ""))


def test_a_drawn_figure_follows_a_drag_with_the_values_of_python(run, browser):
    run(DRAWN)
    browser.wait_for(f"{FIGURE}?.clientWidth > 300", ANSWER_S)
    start = browser.wait_for(f"{DOTS}.length === 8 && {DOTS}.map(d => d.ariaLabel)", ANSWER_S)
    assert start == words_of(transfer_curves())  # sliders that are shown change nothing
    x, y, left, width = browser.evaluate(HANDLE % "message bytes")
    browser.evaluate(RECORD)
    browser.drag((x, y), (left + 0.95 * width, y), steps=80)
    browser.drag((left + 0.95 * width, y), (left + 0.1 * width, y), steps=120)
    time.sleep(1)  # the last events of the drag arrive
    browser.wait_for(LAST_MOVE_IS_SHOWN, ANSWER_S)
    moves, frames = (browser.evaluate(f"seen.{name}") for name in ("moves", "frames"))
    shown = [(at, size_of(words)) for at, words in frames[1:]]
    assert all(
        words == words_of(transfer_curves(message_bytes=size_of(words))) for _, words in frames
    )
    assert shown[-1][1] == moves[-1][1]
    # From an input to the frame with its values. Alone on two cores: 10 updates/s and 100 ms; here other
    # tests may run beside it.
    delays = [at - max(t for t, size in moves if size == value and t <= at) for at, value in shown]
    assert len(shown) / (moves[-1][0] - moves[0][0]) > 3e-3
    assert np.median(delays) < 400

    # A press prints the values and the call that repeats them; a theme and the cell's width are followed.
    dot = f"{DOTS}[0].getBoundingClientRect()"
    middle = f"(b => [b.x + b.width / 2, b.y + b.height / 2])({dot})"
    browser.evaluate(f"{FIGURE}.scrollIntoView({{block: 'center'}})")
    browser.click(*browser.still(middle, ANSWER_S))
    printed = browser.wait_for("document.querySelector('.jp-OutputArea pre')?.innerText", ANSWER_S)
    size = shown[-1][1]
    assert f"transfer_curves(message_bytes={size}).at('hardware to hardware', {size})" in printed
    tooltip = "document.querySelector('#vg-tooltip-element.visible')?.innerText"
    assert browser.wait_for(tooltip, ANSWER_S) == words_of(transfer_curves(message_bytes=size))[0]
    color = f"getComputedStyle({DOTS}[0]).fill"
    light = browser.evaluate(color)
    browser.evaluate(DARK)
    browser.wait_for(f"{color} !== '{light}'", ANSWER_S)
    screen = {"width": 700, "height": 1000, "deviceScaleFactor": 1, "mobile": False}
    browser.call("Emulation.setDeviceMetricsOverride", **screen)
    browser.wait_for(FITS, ANSWER_S)


LAPPED = """from sfglab.lab.experiments import cooperation
from sfglab.lab.explore import explore
explore(cooperation.exp)"""
SIZES = """(() => {
  const all = (name) => [...document.querySelectorAll(`.sfglab-explore ${name}`)];
  const size = (of) => [+of.getAttribute('width'), +of.getAttribute('height')];
  const explorer = document.querySelector('.sfglab-explore').getBoundingClientRect();
  const cell = document.querySelector('.jp-OutputArea-output');
  return {
    clips: [...new Set(all('clipPath rect').map(size).map(String))],
    frames: [...new Set(all('path.background').map((path) => path.getAttribute('d')))],
    tracks: all('.noUi-base').map((track) => track.clientWidth),
    text: Math.max(...all('.sfglab-vega text').map((t) => t.getBoundingClientRect().right)) - explorer.right,
    width: explorer.width, scrolls: cell.scrollWidth > cell.clientWidth,
  }; })()"""


def test_an_explorer_is_whole_and_to_scale_at_every_width(run, browser):
    def at(width):
        screen = {"width": width, "height": 1400, "deviceScaleFactor": 1, "mobile": False}
        browser.call("Emulation.setDeviceMetricsOverride", **screen)
        time.sleep(2)  # the page, the cell and then the figure take their width
        return browser.evaluate(SIZES)

    run(LAPPED)
    browser.wait_for(f"{DOTS}.length === 6", ANSWER_S)
    browser.evaluate("jupyterapp.shell.collapseLeft()")
    for width in (1280, 1920, 390):
        sizes = at(width)
        [clip] = sizes["clips"]
        side, height = clip.split(",")
        assert side == height, "a hallway is to scale"
        assert f"M0,0h{side}v{side}h-{side}Z" in sizes["frames"], "lines end where the panel does"
        assert min(sizes["tracks"]) > 100
        assert sizes["text"] <= 0
        assert sizes["width"] <= 1100
        assert not sizes["scrolls"]


SIMULATED = """import time
from typing import Annotated
from sfglab.fields import Bounds
from sfglab.lab.explore import Axis, Panel, Picture, Series, explore
def simulate(*, loss: Annotated[float, Bounds(0, 1)] = 0.5):
    for pause in (0.5, 1.5):
        time.sleep(pause)
        curve = Series(name="a", color="#00528A", x=[0, 1], y=[0, loss])
        panel = Panel(title="a", x=Axis("x", "", 0, 1), y=Axis("y", "", 0, 1), series=(curve,))
        yield Picture(said=f"loss {loss:g} in {pause:g} s", panels=(panel,))
explore(simulate)"""
STATUS = "document.querySelector('.sfglab-vega [role=status]')?.textContent"
STALE = "document.querySelector('.sfglab-vega').classList.contains('stale')"


def test_a_simulation_dims_its_figure_until_a_coarse_and_then_the_whole_one_is_there(run, browser):
    run(SIMULATED)
    browser.wait_for(f"{STATUS} === 'loss 0.5 in 1.5 s'", ANSWER_S)
    browser.wait_for(f"{FIGURE}?.clientWidth > 300", ANSWER_S)
    for share in (0.25, 0.75):  # a second slow answer dims the figure like the first
        x, y, left, width = browser.evaluate(HANDLE % "loss")
        browser.drag((x, y), (left + share * width, y), steps=5)
        browser.wait_for(f"{STATUS}.endsWith('1.5 s (computing ...)') && {STALE}", ANSWER_S)
        browser.wait_for(f"{STATUS}.endsWith('(coarse, computing ...)') && !{STALE}", ANSWER_S)
        browser.wait_for(f"{STATUS}.endsWith(' in 1.5 s') && !{STALE}", ANSWER_S)
    assert not browser.evaluate(STATUS).startswith("loss 0.5 ")


def test_parts_of_pictures_are_pressed_and_python_answers_or_refuses(run, browser):
    """All pictures stand below one cell, so that one kernel answers."""
    run(PICTURES)
    before = {name: browser.wait_for(LOOKS % name, ANSWER_S) for name in "ab"}
    browser.evaluate(REDRAWN)
    for part, answer in PRESSED:
        browser.click(*browser.still(PART % part, ANSWER_S))  # plots above it are drawn again
        browser.wait_for(answer, ANSWER_S)
    assert browser.evaluate(LOOKS % "a") != before["a"]
    assert browser.evaluate("document.querySelector('.jp-OutputArea svg').ariaLabel").startswith(
        "A figure with"
    )
    assert browser.evaluate(LOOKS % "b") == before["b"]


def test_the_viewer_is_scrubbed_without_a_mouse_and_asks_nothing_of_a_network(
    run, browser, pytestconfig
):
    log = pytestconfig.rootpath / "data/reference/mocap.mcap"
    first = LogViewer(log).slider.value
    run(VIEWER.format(log=str(log)))
    browser.wait_for(STEP % first, ANSWER_S)
    browser.evaluate("document.querySelector('.jp-OutputArea .noUi-handle').focus()")
    for step in (first + 1, first + 2):
        for kind in ("keyDown", "keyUp"):
            browser.call(
                "Input.dispatchKeyEvent", type=kind, key="ArrowRight", windowsVirtualKeyCode=39
            )
        browser.wait_for(STEP % step, ANSWER_S)
    assert set(browser.evaluate(ASKED)) <= {"127.0.0.1", "blob:"}
    browser.evaluate("void Object.defineProperty(window, 'isSecureContext', {value: false})")
    run_all(browser)  # an address that the browser does not trust has a still and a sentence
    browser.wait_for(SAYS % "A picture only: Rerun's viewer needs an address", ANSWER_S)
    assert browser.evaluate("document.querySelector('.jp-OutputArea img').naturalWidth") > 100


def test_a_waypoint_is_added_and_saved_in_the_scene_editors_cell(run, browser, lab):
    """Other actions of the mouse are in tests/view/test_planner_browser.py."""
    folder, _ = lab
    run("from sfglab.lab.experiments import planning\nplanning.SceneCell()")
    browser.wait_for(f"{FRAME}?.getAttribute('src').startsWith('/proxy/')", ANSWER_S)
    for button in ("go2 patrol #8", "append", "Save *"):
        in_frame(browser, button)
    buttons = f"[...{FRAME}.contentDocument.querySelectorAll('button')]"
    browser.wait_for(f"!{buttons}.some(b => b.innerText == 'Save *')")
    before, after = (load_scene(folder / f"{where}/scenes/hall.yaml") for where in ("data", "runs"))
    assert len(after.held_by(8)) == len(before.held_by(8)) + 1


def in_frame(browser, text):
    """Press what is in the editor's page with a text or label, once it is there."""
    browser.click(*browser.still(INSIDE % (json.dumps(text), json.dumps(text)), ANSWER_S))


BADGE = (236, 0, 79)  #: Colour of the mark that Rerun puts beside a view with error reports.
AXIS = (90, 129, 255)  #: Colour of the upward axis that Rerun draws at the origin of a frame.


def pixels_of(browser, color, file):
    """Return how many pixels of a screenshot have a colour."""
    browser.screenshot(file)
    picture = cv2.imread(str(file))[..., ::-1].astype(int)
    return int((abs(picture - color).max(axis=2) < 4).sum())


@pytest.fixture
def bag(tmp_path):
    """A rosbag2 of an ordinary robot, whose transforms come after what is measured in their frames."""
    odometry = default_message("nav_msgs/msg/Odometry", child_frame_id="base_link")
    odometry.header.frame_id = "odom"
    with LogWriter(tmp_path / "robot.mcap") as log:
        for step in range(20):
            at_ns = 10**18 + step * 10**8
            moved = Pose.at((0.1 * step, 0.0, 0.0))
            place = StampedTransform(parent="odom", child="base_link", stamp_ns=at_ns, pose=moved)
            odometry.header.stamp, odometry.pose.pose.position.x = stamp_from_ns(at_ns), 0.1 * step
            log.write("/odom", odometry, log_time_ns=at_ns)
            transforms = message_type("tf2_msgs/msg/TFMessage")(transforms=[place.to_msg()])
            log.write("/tf", transforms, log_time_ns=at_ns + 10**6)
    return write_bag(tmp_path / "robot.mcap", tmp_path / "robot")


@pytest.mark.slow
def test_space_is_drawn_without_error_reports(run, browser, bag, pytestconfig, tmp_path):
    driving = pytestconfig.rootpath / "data/reference/driving.mcap"
    shot = tmp_path / "page.png"
    wrong = VIEWER.format(log=str(bag)).replace(")", ", frame='nowhere')")
    run(wrong)
    wait_until(lambda: pixels_of(browser, BADGE, shot) > 50, ANSWER_S)  # this is how reports look
    for log, root, first in ((bag, "odom", 1), (driving, "map", 0)):
        run(VIEWER.format(log=str(log)))
        browser.wait_for(SAYS % f"space is drawn in {root}, the root of the largest TF tree")
        browser.wait_for(STEP % first, ANSWER_S)
        wait_until(lambda: pixels_of(browser, AXIS, shot) > 20, ANSWER_S)
        time.sleep(3)  # a report would stand there as soon as the view is drawn
        assert pixels_of(browser, BADGE, shot) == 0

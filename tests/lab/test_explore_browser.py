"""An explorer as readers have it: in a real JupyterLab, in a real browser, with a mouse."""

import json
import os
import subprocess
import sys
import time
import urllib.request
from contextlib import closing
from pathlib import Path

import machine
import nbformat
import pytest

from sfglab.errors import MissingExtraError
from sfglab.lab.browser import Browser, BrowserError, free_port
from sfglab.lab.paths import find_project

pytestmark = [pytest.mark.live, pytest.mark.browser]

EXPLORER = """from sfglab.lab.experiments import transmission
from sfglab.lab.explore import explore
explorer = explore(transmission.exp)
explorer"""
LIGHTS = """from sfglab.errors import InvalidValueError
from sfglab.lab.explore import Pressed, part
on = set()
def press(name):
    if name == "c":
        raise InvalidValueError("light", name, "a, b")
    on.symmetric_difference_update({name})
def draw(figure):
    axes = figure.subplots()
    for x, name in enumerate("abc"):
        part(name, axes.bar(x, 1, color="gold" if name in on else "grey", label=name)[0])
Pressed(draw, size=(6, 2), press=press, titles=lambda: {"a": f"light a, {'on' if 'a' in on else 'off'}"})"""
VIEWER = """from sfglab.lab.explore.viewer import LogViewer
LogViewer({log!r})"""
STEP = "document.querySelector('.jp-OutputArea')?.innerText.includes('shown: step %d of')"
ASKED = "performance.getEntriesByType('resource').map(e => new URL(e.name)).map(u => u.hostname || u.protocol)"
PICTURE = (
    "(() => { const i = document.querySelector('.jp-OutputArea img'); return i && i.naturalWidth && i.src; })()"
)
PART = """(() => { const part = document.querySelector('.jp-OutputArea [id="press:%s"]');
  if (!part) return null;
  part.scrollIntoView({block: 'center'});
  const box = part.getBoundingClientRect();
  return [box.x + box.width / 2, box.y + box.height / 2]; })()"""
LOOKS = "getComputedStyle(document.querySelector('.jp-OutputArea [id=\"press:%s\"] path')).fill"
HANDLE = """(() => { const row = [...document.querySelectorAll('.widget-slider')].find(
  r => r.querySelector('label').innerText.trim() === '%s');
  row.scrollIntoView({block: 'center'});
  const track = row.querySelector('.noUi-base').getBoundingClientRect();
  const handle = row.querySelector('.noUi-handle').getBoundingClientRect();
  return [handle.x + handle.width / 2, handle.y + handle.height / 2, track.x, track.width]; })()"""
LEAVE = """jupyterapp.shell.currentWidget.context.model.dirty = false;
  void jupyterapp.serviceManager.sessions.shutdownAll();"""
"""End the kernel; the page does not ask whether to save when the next one is opened."""
ANSWER_S = 180


@pytest.fixture(scope="module")
def lab(tmp_path_factory):
    """A JupyterLab on an empty folder: the folder and its address."""
    folder = tmp_path_factory.mktemp("lab")
    settings = folder / "config" / "labconfig"
    settings.mkdir(parents=True)
    news = {"disabledExtensions": {"@jupyterlab/apputils-extension:announcements": True}}
    (settings / "page_config.json").write_text(json.dumps(news))
    port = free_port()
    argv = [sys.executable, "-m", "jupyterlab", "--no-browser", "--allow-root", f"--ServerApp.port={port}"]
    argv += ["--IdentityProvider.token=", "--LabApp.expose_app_in_browser=True"]
    environment = os.environ | {
        "JUPYTER_CONFIG_DIR": str(folder / "config"),
        "IPYTHONDIR": str(folder / "ipython"),
    }
    server = subprocess.Popen(argv, cwd=folder, env=environment, stderr=subprocess.DEVNULL)
    yield folder, f"http://127.0.0.1:{port}"
    server.terminate()
    server.wait(60)


@pytest.fixture(scope="module")
def browser(lab):
    try:
        made = Browser(1300, 1100)
    except (MissingExtraError, BrowserError) as error:
        machine.skip("browser", str(error))
    with closing(made):
        until_served(lab[1].removeprefix("http://"))
        yield made


@pytest.fixture(name="run")
def _run(lab, browser):
    """A function that opens a notebook of one cell and runs it; its kernel ends with the test."""
    folder, address = lab

    def run(cell):
        notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell)])
        notebook.metadata.kernelspec = {"name": "python3", "display_name": "Python 3", "language": "python"}
        nbformat.write(notebook, folder / "explore.ipynb")
        browser.open(f"{address}/lab/tree/explore.ipynb?reset")
        run_all(browser)

    yield run
    browser.evaluate(LEAVE)


def until_served(address):
    end = time.monotonic() + ANSWER_S
    while True:
        try:
            with urllib.request.urlopen(f"http://{address}/api", timeout=5):
                return
        except OSError:
            assert time.monotonic() < end, "JupyterLab does not serve its page"
            time.sleep(0.2)


def run_all(browser):
    ready = "window.jupyterapp?.shell.currentWidget?.sessionContext"
    browser.wait_for(f"{ready}?.isReady && {ready}.session?.kernel?.status === 'idle'", ANSWER_S)
    browser.evaluate("void jupyterapp.commands.execute('notebook:run-all-cells')")


def slide(browser, label, share):
    """Drag a slider's handle to a share of its track."""
    x, y, left, width = browser.evaluate(HANDLE % label)
    browser.drag((x, y), (left + share * width, y), steps=5)


def test_a_figure_follows_the_sliders_that_a_reader_drags(run, browser):
    run(EXPLORER)
    before = browser.wait_for(PICTURE, ANSWER_S)
    for share in (0.3, 0.6):
        slide(browser, "loss", share)
        before = browser.wait_for(
            f"(() => {{ const s = {PICTURE}; return s !== {before!r} && s; }})()", ANSWER_S
        )
    browser.press("Copy as code")
    code = browser.wait_for("document.querySelector('.jp-OutputArea textarea')?.value", ANSWER_S)
    assert "loss=0.1" in code


def test_a_part_of_a_figure_is_pressed_and_python_answers(run, browser):
    run(LIGHTS)
    before = {name: browser.wait_for(LOOKS % name, ANSWER_S) for name in "ab"}
    browser.click(*browser.wait_for(PART % "a"))
    browser.wait_for(f"{LOOKS % 'a'} !== {before['a']!r}")
    assert browser.evaluate(LOOKS % "b") == before["b"]
    assert browser.evaluate("document.querySelector('.jp-OutputArea title').textContent") == "light a, on"
    browser.click(*browser.wait_for(PART % "c"))
    browser.wait_for("document.querySelector('.jp-OutputArea').innerText.includes(\"light: given 'c'\")")


def test_an_automaton_is_stepped_by_its_edges_and_refuses_what_its_table_does(run, browser):
    run("from sfglab.lab.experiments import lifecycle\nlifecycle.press_lifecycle()")
    browser.click(*browser.wait_for(PART % "UNKNOWN/HEARD", ANSWER_S))
    said = "document.querySelector('.jp-OutputArea').innerText.includes(%r)"
    browser.wait_for(said % "1: HEARD in UNKNOWN leads to QUERYING: QUERY")
    browser.click(*browser.wait_for(PART % "LOST"))
    browser.wait_for(said % "put into LOST")
    browser.click(*browser.wait_for(PART % "REJOINING/SILENT"))
    browser.wait_for(said % "agent in LOST: given SILENT, allowed are CHANGED")


def test_a_name_is_pressed_and_read_anew(run, browser):
    run("from sfglab.lab.experiments import naming\nnaming.NamePicture()")
    browser.click(*browser.wait_for(PART % "component", ANSWER_S))
    browser.wait_for(
        "document.querySelector('.jp-OutputArea input').value === '/global/go2/depth_camera/color/ffmpeg'"
    )


def test_a_frame_of_the_time_line_is_pressed_and_lost(run, browser):
    run("from sfglab.lab.experiments import transmission\ntransmission.Timeline()")
    title = "document.querySelector('.jp-OutputArea [id=\"press:a/DATA/2\"] title')?.textContent"
    place = browser.wait_for(PART % "a/DATA/2", ANSWER_S)
    browser.click(*place)
    browser.wait_for(f"{title}?.endsWith('lost; press to let it pass')")


def test_the_viewer_is_scrubbed_without_a_mouse_and_asks_nothing_of_a_network(run, browser, pytestconfig):
    run(VIEWER.format(log=str(pytestconfig.rootpath / "data/reference/mocap.mcap")))
    browser.wait_for(STEP % 0, ANSWER_S)
    browser.evaluate("document.querySelector('.jp-OutputArea .noUi-handle').focus()")
    for step in (1, 2):
        for kind in ("keyDown", "keyUp"):
            browser.call("Input.dispatchKeyEvent", type=kind, key="ArrowRight", windowsVirtualKeyCode=39)
        browser.wait_for(STEP % step, ANSWER_S)
    assert set(browser.evaluate(ASKED)) <= {"127.0.0.1", "blob:"}


def test_paper_cs_pictures_answer_and_refuse(run, browser):
    root = str(find_project(Path(__file__)).root)
    mapping = f"from pathlib import Path\ngraph = soc.load_graph(Path({root!r}) / 'data/graphs/driving.yaml')"
    cells = ["from IPython.display import display", "from sfglab import soc", mapping]
    cells += [
        "from sfglab.lab.experiments import gateways",
        "from sfglab.lab.explore.mapping import PressedMapping",
    ]
    run("\n".join([*cells, "display(gateways.press_core(), PressedMapping(graph, soc.ZCU104))"]))
    said = "document.querySelector('.jp-OutputArea').textContent.includes(%r)"
    for part, answer in (
        ("START/LOCATED", "1: LOCATED in START leads to REQUEST"),
        ("CLAIM/GRANTED", "gateway core in REQUEST: given GRANTED, allowed are SENT"),
        ("topic:/A", "/A is mapped to gateway"),
        ("node:camera", "fixed in hardware, where it has no implementation"),
    ):
        browser.click(*browser.wait_for(PART % part, ANSWER_S))
        browser.wait_for(said % answer, ANSWER_S)


def test_the_scene_editor_stands_in_its_cell_below_the_servers_address(run, browser):
    run("from sfglab.lab.experiments import planning\nplanning.SceneCell()")
    frame = "document.querySelector('.jp-OutputArea iframe')"
    browser.wait_for(f"{frame}?.getAttribute('src').startsWith('/proxy/')", ANSWER_S)
    browser.wait_for(f"{frame}.contentDocument?.body?.innerText.includes('Save')", ANSWER_S)

"""A film of an explorer for the README, from a real JupyterLab: sliders are dragged, the figure follows.

PYTHONPATH=tools python tests/lab/film_explorer.py figures/explore.gif
"""

import base64
import io
import subprocess
import sys
import time
from contextlib import closing
from pathlib import Path

from browser import Browser
from lab_page import ANSWER_S, HANDLE, OPTIONS, run_all, write_notebook
from PIL import Image, ImageDraw

from sfglab.lab.paths import find_project
from sfglab.lab.testbed import free_port

CELL = """from sfglab.lab.experiments import transmission
from sfglab.lab.explore import explore
explore(transmission.exp)"""
PICTURE = "document.querySelector('.sfglab-vega svg')?.clientWidth > 300"
PLACE = """(() => { const b = document.querySelector('.jp-OutputArea').getBoundingClientRect();
  return [b.x, b.y, b.width, b.height]; })()"""
MOVES = (("rate max", (0.55, 0.7, 0.85)), ("loss", (0.25, 0.5)))
WIDTH, HEIGHT, BAR, WIDEST_PX = 1180, 900, 30, 860
SETTLES_S = 4.0


def shoot(browser, frames, pointer):
    """Keep what the output shows now, with the mouse's place."""
    x, y, width, height = browser.evaluate(PLACE)
    clip = {"x": x, "y": y, "width": width, "height": min(height, HEIGHT - y - BAR), "scale": 1}
    shot = browser.call("Page.captureScreenshot", format="png", clip=clip)["data"]
    picture = Image.open(io.BytesIO(base64.b64decode(shot))).convert("RGB")
    px, py = pointer[0] - x, pointer[1] - y
    ImageDraw.Draw(picture).ellipse((px - 7, py - 7, px + 7, py + 7), outline="#D55E00", width=3)
    frames.append((time.monotonic(), picture))


def drag(browser, frames, label, shares):
    """Drag a slider in steps, and watch what follows each: a coarse picture may come first."""
    for share in shares:
        x, y, left, width = browser.evaluate(HANDLE % label)
        at = (left + share * width, y)
        browser.drag((x, y), at, steps=5)
        end = time.monotonic() + SETTLES_S
        while time.monotonic() < end:
            shoot(browser, frames, at)


def write(frames, to):
    """Write a GIF: equal pictures once, each as long as it was seen, at most two seconds."""
    kept = [frames[0]]
    for taken, picture in frames[1:]:
        if picture.tobytes() != kept[-1][1].tobytes():
            kept.append((taken, picture))
    ends = [taken for taken, _ in kept[1:]] + [kept[-1][0] + 2.0]
    kept[-1][1].thumbnail((WIDEST_PX, HEIGHT))
    palette = kept[-1][1].quantize(64)
    pictures, durations = [], []
    for (taken, picture), end in zip(kept, ends, strict=True):
        picture.thumbnail((WIDEST_PX, HEIGHT))
        pictures.append(picture.quantize(palette=palette, dither=Image.Dither.NONE))
        durations.append(min(2000, int(1000 * (end - taken))))
    pictures[0].save(
        to, save_all=True, append_images=pictures[1:], duration=durations, loop=0, optimize=True
    )


def main(to):
    root = find_project().root
    (root / "runs").mkdir(exist_ok=True)
    write_notebook(root / "runs" / "film.ipynb", CELL)
    port = free_port()
    argv = [sys.executable, "-m", "sfglab", "lab", "--", *OPTIONS, f"--ServerApp.port={port}"]
    server = subprocess.Popen(argv, stderr=subprocess.PIPE, text=True)
    try:
        next(line for line in server.stderr if "is running at" in line)
        with closing(Browser(WIDTH, HEIGHT)) as browser:
            browser.open(f"http://127.0.0.1:{port}/lab/tree/runs/film.ipynb?reset")
            run_all(browser)
            browser.evaluate("void jupyterapp.commands.execute('application:toggle-left-area')")
            browser.wait_for(PICTURE, ANSWER_S)
            time.sleep(2 * SETTLES_S)
            frames = []
            for label, shares in MOVES:
                drag(browser, frames, label, shares)
    finally:
        server.terminate()
        server.wait(60)
        (root / "runs" / "film.ipynb").unlink()
    write(frames, to)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

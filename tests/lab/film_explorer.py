"""A film of an explorer for the README, from a real JupyterLab: sliders are dragged, the figure follows.

PYTHONPATH=tools python tests/lab/film_explorer.py figures/explore.gif
"""

import base64
import io
import sys
import time
from contextlib import closing
from pathlib import Path
from tempfile import TemporaryDirectory

from browser import Browser
from lab_page import ANSWER_S, HANDLE, ROOT, run_all, served_lab, write_notebook
from PIL import Image, ImageDraw

CELL = """from sfglab.lab.experiments import transmission
from sfglab.lab.explore import explore
explore(transmission.exp)"""
PICTURE = "document.querySelector('.sfglab-vega svg')?.clientWidth > 300"
PLACE = """(() => { const b = document.querySelector('.jp-OutputArea').getBoundingClientRect();
  return [b.x, b.y, b.width, b.height]; })()"""
MOVES = [("rate max", 0.55), ("rate max", 0.7), ("rate max", 0.85), ("loss", 0.25), ("loss", 0.5)]
WIDTH, HEIGHT, BAR, WIDEST_PX = 1180, 900, 30, 860
SETTLES_S = 2.0


def drag(browser, label, share):
    """Drag a slider, and return pictures of what the output shows until it has settled."""
    x, y, left, width = browser.evaluate(HANDLE % label)
    pointer = (left + share * width, y)
    browser.drag((x, y), pointer, steps=5)
    left, top, width, height = browser.evaluate(PLACE)
    clip = {"x": left, "y": top, "width": width, "height": min(height, HEIGHT - top - BAR)}
    pictures, end_s = [], time.monotonic() + SETTLES_S
    while time.monotonic() < end_s:
        shot = browser.call("Page.captureScreenshot", format="png", clip=clip | {"scale": 1})
        picture = Image.open(io.BytesIO(base64.b64decode(shot["data"]))).convert("RGB")
        mouse = (pointer[0] - left, pointer[1] - top)
        ImageDraw.Draw(picture).circle(mouse, 7, outline="#D55E00", width=3)
        picture.thumbnail((WIDEST_PX, HEIGHT))
        pictures.append(picture)
    return pictures


def main(to):
    pictures = []
    with TemporaryDirectory() as folder, served_lab(ROOT, folder) as address:
        notebook = ROOT / "runs" / "film.ipynb"
        write_notebook(notebook, CELL)
        with closing(Browser(WIDTH, HEIGHT)) as browser:
            browser.open(f"{address}/lab/tree/runs/film.ipynb?reset")
            run_all(browser)
            browser.evaluate("void jupyterapp.commands.execute('application:toggle-left-area')")
            browser.wait_for(PICTURE, ANSWER_S)
            time.sleep(2 * SETTLES_S)
            start_s = time.monotonic()
            for label, share in MOVES:
                pictures += drag(browser, label, share)
            frame_ms = 1000 * (time.monotonic() - start_s) / len(pictures)
        notebook.unlink()
    palette = pictures[-1].quantize(64)
    first, *others = (picture.quantize(palette=palette, dither=0) for picture in pictures)
    # Equal pictures become one, which is shown for as long.
    first.save(to, save_all=True, append_images=others, duration=frame_ms, loop=0, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

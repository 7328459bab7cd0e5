"""A film of an explorer for the README, from a real JupyterLab: sliders are dragged, the figure follows.

PYTHONPATH=tools python tests/lab/film_explorer.py figures/explore.gif
"""

import base64
import io
import json
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
RATES = [("rate max", share) for share in (0.5, 0.55, 0.6, 0.65, 0.7, 0.75, 0.8, 0.85)]
LOSSES = [("loss", share) for share in (0.1, 0.2, 0.3, 0.4, 0.5)]
SAYS = "document.querySelector('.sfglab-vega [role=status]').textContent"
#: True when the figure shows what the sentence above it says, and that is new and not preliminary.
SETTLED = f"""((said) => said !== %s && !said.includes('computing') &&
  said === document.querySelector('.sfglab-vega > div').ariaLabel)({SAYS})"""
WIDTH, HEIGHT, BAR, WIDEST_PX = 1180, 900, 30, 860
SHOWN_MS = 900
PAUSE_S = 4.0  # until the page has its final width


def drag(browser, label, share):
    """Drag a slider, and return a picture of what the output shows once it has settled."""
    before = browser.evaluate(SAYS)
    x, y, left, width = browser.evaluate(HANDLE % label)
    pointer = (left + share * width, y)
    browser.drag((x, y), pointer, steps=5)
    browser.wait_for(SETTLED % json.dumps(before), ANSWER_S)
    left, top, width, height = browser.evaluate(PLACE)
    clip = {"x": left, "y": top, "width": width, "height": min(height, HEIGHT - top - BAR)}
    shot = browser.call("Page.captureScreenshot", format="png", clip=clip | {"scale": 1})
    picture = Image.open(io.BytesIO(base64.b64decode(shot["data"]))).convert("RGB")
    mouse = (pointer[0] - left, pointer[1] - top)
    ImageDraw.Draw(picture).circle(mouse, 7, outline="#D55E00", width=3)
    picture.thumbnail((WIDEST_PX, HEIGHT))
    return picture


def main(to):
    with TemporaryDirectory() as folder, served_lab(ROOT, folder) as address:
        notebook = ROOT / "runs" / "film.ipynb"
        notebook.parent.mkdir(exist_ok=True)
        write_notebook(notebook, CELL)
        with closing(Browser(WIDTH, HEIGHT)) as browser:
            browser.open(f"{address}/lab/tree/runs/film.ipynb?reset")
            run_all(browser)
            browser.evaluate("void jupyterapp.commands.execute('application:toggle-left-area')")
            browser.wait_for(PICTURE, ANSWER_S)
            time.sleep(PAUSE_S)
            pictures = [drag(browser, *move) for move in RATES + LOSSES]
        notebook.unlink()
    palette = pictures[-1].quantize(64)
    first, *others = (picture.quantize(palette=palette, dither=0) for picture in pictures)
    first.save(to, save_all=True, append_images=others, duration=SHOWN_MS, loop=0, optimize=True)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

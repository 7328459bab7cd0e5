"""Figures on pages: letters at the width of a notebook; no words on others, cut or pale.

Read from the committed SVG files, whose letters are paths between a comment with the text and the next one.
"""

import re
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from sfglab.lab.figures import save_figure

FIGURES = sorted((Path(__file__).parents[2] / "figures").glob("*.svg"))
NOTEBOOK_PT = 720.0
LEAST_PT = 7.0
_TEXT = re.compile(
    r"<!-- (.*?) -->\s*<g(?: style=\"fill: #(\w+)[^>]*?)?[^>]*? transform=\"translate\(([-\d. ]+)\)"
    r"(?: rotate\(([-\d.]+)\))? scale\(([\d.]+)[^>]*>(.*?)</g>",
    re.DOTALL,
)
_LETTER = re.compile(r"<use [^>]*?(?:translate\(([-\d.]+)[^>]*)?/>")
LEAST_CONTRAST = 4.5
"""WCAG 2.1's ratio of luminances, success criterion 1.4.3, level AA."""
_LETTER_WIDTH, _ASCENT, _OVERLAP_PT = 60.0, 70.0, 1.5
"""Width and ascent of a letter of a font whose size is 100; overlap that is allowed, at the figure's own size."""


def texts_of(content):
    """The texts of a figure: size, points; box, shape (2, 2), points from the upper left; colour."""
    found = []
    for text, color, place, angle, scale, letters in _TEXT.findall(content):
        size = float(scale)
        width = max(float(x or 0) for x in _LETTER.findall(letters)) + _LETTER_WIDTH
        turn = np.radians(float(angle or 0))
        along = np.array([np.cos(turn), np.sin(turn)]) * size * width
        up = np.array([np.sin(turn), -np.cos(turn)]) * size * _ASCENT
        start = np.array(place.split(), float)
        corners = np.array([start, start + along, start + up, start + along + up])
        box = np.array([corners.min(axis=0), corners.max(axis=0)])
        found.append((text, 100 * size, box, bytes.fromhex(color or "000000")))
    return found


@pytest.mark.parametrize("svg", FIGURES, ids=lambda svg: svg.stem)
def test_words_are_large_enough_in_a_notebook_whole_dark_and_never_on_others(svg):
    content = svg.read_text()
    page = np.array(re.search(r'viewBox="0 0 ([\d. ]+)"', content)[1].split(), float)
    texts = texts_of(content)
    scale = min(1.0, NOTEBOOK_PT / page[0])
    assert round(scale * min(size for _, size, *_ in texts), 1) >= LEAST_PT
    for text, _, box, _ in texts:
        assert (box > -_OVERLAP_PT).all(), f"cut: {text}"
        assert (box < page + _OVERLAP_PT).all(), f"cut: {text}"
    for (text, _, box, _), (other, _, behind, _) in combinations(texts, 2):
        overlap = np.minimum(box[1], behind[1]) - np.maximum(box[0], behind[0])
        assert not (overlap > _OVERLAP_PT).all(), (text, other)
    with Image.open(svg.with_suffix(".png")) as png:
        assert png.width / png.height == pytest.approx(page[0] / page[1], abs=0.01)
        pixels = np.asarray(png.convert("RGB"))
    for text, _, box, color in texts:
        (left, top), (right, bottom) = (box * len(pixels) / page[1]).round().astype(int).clip(0)
        around = pixels[top:bottom, left:right].reshape(-1, 3)
        colors, counts = np.unique(around, axis=0, return_counts=True)
        both = [luminance(each) + 0.05 for each in (color, colors[counts.argmax()])]
        assert max(both) / min(both) >= LEAST_CONTRAST, f"pale: {text}"


def luminance(rgb):
    """WCAG 2.1's relative luminance of a colour of three bytes."""
    part = np.array([*rgb]) / 255
    linear = np.where(part <= 0.03928, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    return linear @ (0.2126, 0.7152, 0.0722)


def test_a_picture_is_the_same_where_a_processor_rounds_a_last_digit_otherwise(tmp_path):
    def drawn(name, right):
        figure = Figure(figsize=(5, 3))
        axes = figure.subplots(subplot_kw={"xticks": [], "yticks": []})
        axes.plot([0, 1], [0, right], marker="o")
        axes.imshow(np.eye(2), extent=(0, 1, 0, right))
        return save_figure(figure, tmp_path / name, {})[0].read_text()

    text = drawn("one", 1.0)
    assert drawn("other", 1.0 + 2**-51) == text
    marks = re.findall(r'(?:href="#|url\(#)([a-z]+\d+)', text)
    assert {mark[0] for mark in marks} == {"m", "p"}
    assert all(f'id="{mark}"' in text for mark in marks)

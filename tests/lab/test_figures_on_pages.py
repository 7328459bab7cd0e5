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
NOTEBOOK_INCHES = 10.0
LEAST_PT = 7.0
_TEXT = re.compile(
    r"<!-- (.*?) -->\s*<g(?: style=\"fill: (#\w+)[^>]*?)?[^>]*? transform=\"translate\(([-\d. ]+)\)"
    r"(?: rotate\(([-\d.]+)\))? scale\(([\d.]+)[^>]*>(.*?)</g>",
    re.DOTALL,
)
_LETTER = re.compile(r"<use [^>]*?(?:translate\(([-\d.]+)[^>]*)?/>")
_PT_PER_INCH, _LETTER_WIDTH, _ASCENT, _OVERLAP_PT = 72, 60.0, 70.0, 1.5
"""Width and ascent of a letter of a font whose size is 100; overlap that is allowed, at the figure's own size."""
LEAST_CONTRAST = 4.5
"""WCAG 2.1's ratio of luminances, success criterion 1.4.3, level AA."""


def texts_of(svg):
    """The texts of a figure: size, points; box, shape (2, 2), points from the upper left; colour."""
    found = []
    for text, color, place, angle, scale, letters in _TEXT.findall(svg.read_text()):
        size = float(scale)
        width = max(float(x or 0) for x in _LETTER.findall(letters)) + _LETTER_WIDTH
        turn = np.radians(float(angle or 0))
        along = np.array([np.cos(turn), np.sin(turn)]) * size * width
        up = np.array([np.sin(turn), -np.cos(turn)]) * size * _ASCENT
        start = np.array([float(x) for x in place.split()])
        corners = np.array([start, start + along, start + up, start + along + up])
        box = np.array([corners.min(axis=0), corners.max(axis=0)])
        found.append((text, 100 * size, box, color or "#000000"))
    return found


def width_inches(svg):
    return float(re.search(r'width="([\d.]+)pt"', svg.read_text())[1]) / _PT_PER_INCH


@pytest.mark.parametrize("svg", FIGURES, ids=lambda svg: svg.stem)
def test_words_are_large_enough_in_a_notebook_and_never_on_top_of_others(svg):
    scale = min(1.0, NOTEBOOK_INCHES / width_inches(svg))
    assert round(scale * min(size for _, size, *_ in texts_of(svg)), 1) >= LEAST_PT
    for (text, _, box, _), (other, _, behind, _) in combinations(texts_of(svg), 2):
        overlap = np.minimum(box[1], behind[1]) - np.maximum(box[0], behind[0])
        assert not (overlap > _OVERLAP_PT).all(), (text, other)
    with Image.open(svg.with_suffix(".png")) as png:
        size = re.search(r'viewBox="0 0 ([\d.]+) ([\d.]+)"', svg.read_text())
        width, height = map(float, size.groups())
        assert png.width / png.height == pytest.approx(width / height, abs=0.01)


def luminance(rgb):
    """WCAG 2.1's relative luminance of a colour of three bytes."""
    part = np.asarray(rgb) / 255
    return np.where(part <= 0.03928, part / 12.92, ((part + 0.055) / 1.055) ** 2.4) @ (
        0.2126,
        0.7152,
        0.0722,
    )


@pytest.mark.parametrize("svg", FIGURES, ids=lambda svg: svg.stem)
def test_words_are_whole_and_stand_out_from_what_is_behind_them(svg):
    with Image.open(svg.with_suffix(".png")) as png:
        pixels = np.asarray(png.convert("RGB"))
    per_point = pixels.shape[1] / (width_inches(svg) * _PT_PER_INCH)
    for text, _, box, color in texts_of(svg):
        corners = box * per_point
        assert (corners > -_OVERLAP_PT).all(), f"cut: {text}"
        assert (corners < np.array(pixels.shape[1::-1]) + _OVERLAP_PT).all(), f"cut: {text}"
        (left, top), (right, bottom) = (
            np.clip(np.add(corners, [[-2], [2]]), 0, None).round().astype(int)
        )
        colors, counts = np.unique(
            pixels[top:bottom, left:right].reshape(-1, 3), axis=0, return_counts=True
        )
        ink, behind = luminance(list(bytes.fromhex(color[1:]))), luminance(colors[counts.argmax()])
        ratio = (max(ink, behind) + 0.05) / (min(ink, behind) + 0.05)
        assert ratio >= LEAST_CONTRAST, (
            f"{text}: {color} on {colors[counts.argmax()]}, {ratio:.1f} to 1"
        )


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

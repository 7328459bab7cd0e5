"""Helpers of figures draw what a table holds, and lay axes out for bytes."""

import pandas as pd
import pytest
from matplotlib.figure import Figure

from sfglab.lab.figures import bytes_axis, lines, paper_line

FRAME = pd.DataFrame({2: [1.0, 2.0], 8: [3.0, 4.0]}, index=[10_000, 10_000_000])
STYLES = {2: {"color": "#E69F00", "label": "2 nodes"}}


@pytest.fixture
def axes():
    return Figure().subplots()


def test_a_line_for_each_column_with_its_style_and_that_of_all(axes):
    lines(axes, FRAME, STYLES, linestyle="--")
    first, second = axes.lines
    assert (first.get_color(), first.get_label()) == ("#E69F00", "2 nodes")
    assert [line.get_linestyle() for line in axes.lines] == ["--", "--"]
    assert second.get_ydata().tolist() == [3, 4]


def test_a_bytes_axis_has_ticks_with_prefixes(axes):
    lines(axes, FRAME, STYLES)
    bytes_axis(axes)
    axes.figure.canvas.draw()
    texts = [tick.get_text() for tick in axes.get_xticklabels()]
    assert {"10 kB", "10 MB"} <= set(texts)
    assert axes.get_xlabel() == "message size"


def test_the_papers_value_is_drawn_across_and_named(axes):
    paper_line(axes, 7.95)
    (line,) = axes.lines
    assert set(line.get_ydata()) == {7.95}
    assert [text.get_text() for text in axes.texts] == ["paper: 7.95"]

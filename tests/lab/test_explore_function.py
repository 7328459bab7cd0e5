"""Explorers of functions: a form from the parameters, pictures as values, a still without a browser."""

import base64
import gzip
import io
import json
import threading
from html import unescape
from typing import Annotated

import numpy as np
import pytest
from PIL import Image

from sfglab.errors import InvalidValueError
from sfglab.fields import Bounds
from sfglab.lab.explore import explore, interactive, vega
from sfglab.lab.pictures import Axis, Panel, Picture, Series

pytest.importorskip("altair", reason="the extra view is not installed")
pytest.importorskip("vl_convert", reason="the extra view is not installed")
X = Axis("distance", "m", 0, 10)
Y = Axis("time", "s", 0, 100)
WAIT_S = 60


def line(
    *, slope: Annotated[float, Bounds(1, 9)] = 2.0, points: Annotated[int, Bounds(2, 9)] = 3
) -> Picture:
    """Return a line.

    Args:
        slope: Time for one metre [s/m].
        points: Number of points, which
            are one metre apart.
    """
    if points == 7:
        raise InvalidValueError("points", points, "not seven")
    if points == 8:
        raise RuntimeError("a mistake")
    xs = range(points)
    curve = Series(name="walk", color="#00528A", x=xs, y=[slope * x for x in xs])
    dot = Series(name="walk", color="#00528A", kind="dot", x=[1], y=[slope])
    panel = Panel(title="way", x=X, y=Y, series=(curve, dot))
    return Picture(said=f"A line of {slope:g} s/m.", panels=(panel,))


@pytest.fixture
def walk():
    return explore(line)


def test_parameters_become_sliders_with_their_bounds_texts_and_units(walk):
    slope, points = walk.form.controls["slope"], walk.form.controls["points"]
    assert (slope.min, slope.max, slope.value) == (1, 9, 2)
    assert slope.tooltip == "Time for one metre [s/m]."
    assert points.tooltip == "Number of points, which are one metre apart."


def test_the_figure_has_the_values_of_the_function_and_a_press_prints_their_call(walk):
    walk.form.controls["slope"].value = 3.5
    walk.wait()
    assert walk._figure.rows == vega.rows_of(line(slope=3.5))
    walk._figure._handle_custom_msg({"place": 0, "x": 2}, [])
    assert "line(slope=3.5).at(&#x27;way&#x27;, 2)" in walk._printed.value
    printed = unescape(walk._printed.value).removeprefix("<pre>").removesuffix("</pre>")
    values, call = printed.split("\n\n")
    names = {}
    exec(call.replace("\nline(", "\ntable = line("), names)  # noqa: S102
    assert names["table"].to_string(index=False) == values
    walk._figure._handle_custom_msg({"place": 0, "x": 0.5}, [])
    assert "given (&#x27;way&#x27;, 0.5)" in walk._printed.value


def test_outlines_show_the_start_and_the_setting_before_a_pause(walk, monkeypatch):
    control = walk.form.controls["slope"]
    start = vega.ghosts_of(line(), "reference")
    assert walk._figure.ghosts == start
    monkeypatch.setattr(interactive, "_REST_S", 60.0)
    control.value = 4.0
    walk.wait()
    assert walk._figure.ghosts == start
    monkeypatch.setattr(interactive, "_REST_S", 0.0)
    control.value = 5.0
    walk.wait()
    assert walk._figure.ghosts == start | vega.ghosts_of(line(slope=4.0), "last")


def test_a_setting_without_a_picture_is_refused_and_the_next_one_is_shown(walk):
    for points, reason in ((7, "points: given 7"), (8, "it cannot be drawn: RuntimeError")):
        walk.form.controls["points"].value = points
        walk.wait()
        assert walk._figure.answer["is"] == "refused"
        assert f"points={points}" not in walk.code()  # of the picture that is still shown
        assert reason in walk._figure.answer["why"]
        walk.form.controls["points"].value = 4
        walk.wait()
        assert walk._figure.answer == {"of": walk._figure.asked, "is": "whole"}
        assert walk.form.values["points"] == 4
        assert len(walk._figure.rows["line0"]) == 4


def test_a_simulation_shows_coarse_pictures_and_leaves_settings_that_are_passed_over():
    shown, may_go_on, began = [], threading.Event(), threading.Event()
    may_go_on.set()

    def simulate(*, slope: Annotated[int, Bounds(1, 9)] = 1):
        yield None
        yield line(slope=slope)
        began.set()
        may_go_on.wait(WAIT_S)
        yield None
        yield line(slope=slope, points=4)

    explorer = explore(simulate)
    figure = explorer._figure
    figure.observe(lambda change: shown.append((*change["new"].values(), figure.said)), "answer")
    may_go_on.clear()
    began.clear()
    for slope in range(2, 6):
        explorer.form.controls["slope"].value = slope
        assert began.wait(WAIT_S)
    may_go_on.set()
    explorer.wait()
    first, last = line(slope=2).said, line(slope=5).said
    assert shown == [
        (1, "coarse", first),
        (4, "coarse", last),
        (4, "whole", last),
    ]
    assert explorer.picture == line(slope=5, points=4)


def test_a_cell_that_runs_again_ends_the_simulation_of_its_former_explorer():
    computed, is_coarse, may_go_on = [], threading.Event(), threading.Event()

    def simulate(*, slope: Annotated[int, Bounds(1, 9)] = 1):
        yield line(slope=slope)
        for points in range(4, 7):
            computed.append((slope, points))
            if slope == 2:
                is_coarse.set()
                may_go_on.wait(WAIT_S)
            yield line(slope=slope, points=points)

    former = explore(simulate)
    former.form.controls["slope"].value = 2
    assert is_coarse.wait(WAIT_S)
    computed.clear()
    again = explore(simulate)
    may_go_on.set()
    former.wait()
    assert computed == [(1, 4), (1, 5), (1, 6)], "nothing more of slope 2"
    former.form.controls["slope"].value = 3
    former.wait()
    assert (former.picture, again.picture) == (line(slope=3, points=6), line(points=6, slope=1))


def simulated(*, slope: Annotated[float, Bounds(1, 9)] = 2.0):
    yield line(points=2)
    yield line(slope=slope)


def test_the_call_of_a_simulation_returns_its_whole_picture():
    explorer = explore(simulated)
    explorer.form.controls["slope"].value = 3.0
    explorer.wait()
    assert explorer.picture == line(slope=3.0)
    assert explorer.code().endswith("[*simulated(slope=3.0)][-1]")


def test_the_output_holds_a_small_still_with_alt_text_made_without_a_browser(walk):
    data, metadata = walk._repr_mimebundle_()
    assert metadata["image/png"]["alt"] == "A line of 2 s/m."
    assert "application/vnd.jupyter.widget-view+json" in data
    assert len(json.dumps(data)) < 100_000
    with Image.open(io.BytesIO(base64.b64decode(data["image/png"]))) as still:
        colors = np.array(still.convert("RGB"), int)
    assert (abs(colors - (0, 0x52, 0x8A)).sum(axis=2) < 30).any(), "the line's colour"


def test_the_script_is_an_es_module_that_is_made_once_and_needs_no_writable_home(
    tmp_path, monkeypatch
):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    made = vega._packed_script()
    assert gzip.decompress(made).decode().rstrip().endswith(" as default};")
    (file,) = (tmp_path / "sfglab").iterdir()
    file.write_bytes(b"kept")
    assert vega._packed_script() == b"kept"
    monkeypatch.setenv("XDG_CACHE_HOME", "/proc/none")
    assert vega._packed_script() == made

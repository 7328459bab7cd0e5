"""The time line of one writer and one reader: what is drawn is what the engine came to, whatever is pressed."""

import numpy as np
import pytest
from matplotlib.figure import Figure

from sfglab.lab.experiments.transmission.timeline import Exchange, Timeline
from sfglab.rtps import Drop, Frame, run, trace

pytest.importorskip("anywidget")


@pytest.mark.parametrize("vendor", ["fast_dds", "cyclone_dds"])
@pytest.mark.parametrize(("depth", "loss"), [(1, 0.3), (50, 0.0), (50, 0.3)])
def test_what_is_drawn_comes_to_what_the_engine_came_to(vendor, depth, loss):
    line = Timeline(["a/DATA/5", "a/DATA/5.1"], vendor=vendor, depth=depth, loss=loss, samples=40)
    for press in ("a/DATA/7", "a/ACKNACK/1", "a/DATA/7", "a/HEARTBEAT/1"):
        if press in {frame.name for frame in line.frames}:
            line.press(press)
        agrees(line)


def agrees(line):
    """The drawn frames alone tell what the engine's own counters and arrays say."""
    figure = Figure()
    line.draw(figure)
    drawn = {artist.get_gid() for artist in figure.axes[0].lines} - {None}
    assert drawn == {f"press:{frame.name}" for frame in line.frames}
    assert len({frame.name for frame in line.frames}) == len(line.frames)
    lost = {frame.name: frame.lost for frame in line.frames}
    assert all(lost[name] == wished for name, wished in line.lost.items() if name in lost)
    outcome = line.outcome
    firsts = [f"a/DATA/{i + 1}" for i in range(len(outcome.fate))]
    assert [lost[name] for name in firsts] == np.equal(outcome.dropped, Drop.MEDIUM).tolist()
    arrived = {s for f in line.frames if f.kind in (Frame.DATA, Frame.BURST) and not f.lost for s in f.samples}
    taken = set((np.flatnonzero(outcome.delivered) + 1).tolist())
    assert taken <= arrived
    if line.form.config.depth == 50:  # nothing is overwritten, and what waits behind a gap is under way
        assert taken == set(range(1, next(i for i in range(1, 99) if i not in arrived)))
    numbers = [text.get_text() for text in figure.axes[0].texts]
    assert sum(text.isdecimal() for text in numbers) >= len(outcome.fate)


def test_a_trace_changes_nothing_and_counts_as_the_engine_does():
    scenario = Exchange(loss=0.3, samples=40, depth=4).scenario()
    (traced, frames), plain = trace(scenario, seed=3), run(scenario, seed=3)
    assert traced.counts == plain.counts
    for column in ("published_ns", "received_ns", "fate", "dropped"):
        assert np.array_equal(getattr(traced.flows["a"], column), getattr(plain.flows["a"], column))
    kinds = [frame.kind for frame in frames]
    assert all(kinds.count(kind) == plain.counts[kind.name.lower()] for kind in Frame if kind < Frame.BURST)
    assert sum(frame.lost for frame in frames) == plain.counts["lost"]
    assert sum(frame.repairs for frame in frames) == plain.counts["repeated"]


def test_a_frame_that_the_seed_loses_is_made_to_pass_and_the_rest_of_the_losses_stay():
    line = Timeline([], loss=0.3, samples=40)
    first = next(frame for frame in line.frames if frame.lost)
    line.press(first.name)
    assert line.lost == {first.name: False}
    assert not next(frame.lost for frame in line.frames if frame.name == first.name)
    line.form.controls["depth"].value = 1
    assert line.lost == {first.name: False}, "what was pressed stays when something else is set"

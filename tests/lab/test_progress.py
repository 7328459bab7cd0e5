"""Progress as those see it who listen, read lines, or sit before JupyterLab."""

import pytest

from sfglab.lab import progress
from sfglab.lab.progress import is_line, progress_bar, progress_to


def test_who_listens_is_told_every_step_and_lines_come_now_and_then_known_as_such(capsys):
    told = []
    with progress_to(told.append), progress_bar(2, "naming") as advance:
        advance("a")
        advance("b")
    assert [(s.what, s.done, s.total) for s in told] == [("naming, a", 1, 2), ("naming, b", 2, 2)]
    assert told[-1].left_s == 0
    with progress_bar(1000, "naming") as advance:
        for number in range(1000):
            advance(str(number))
    line = capsys.readouterr().err
    assert line == "naming, 999: 1000/1000 steps, 0 s left\n"
    assert is_line(line)
    assert not is_line("12 steps, 0 s left over")


def test_jupyterlab_has_a_widget_and_a_line_in_its_place_at_the_end(monkeypatch):
    pytest.importorskip("ipywidgets")
    shown = []

    class Handle:
        def update(self, data, raw):
            shown.append((data, raw))

    monkeypatch.setattr("IPython.display.display", lambda widget, **_: shown.append(widget) or Handle())
    monkeypatch.setattr(progress, "_in_jupyterlab", lambda: True)
    with progress_bar(2, "a<b") as advance:
        bar, text = shown[0].children
        advance("one")
        advance("two")
        assert (bar.value, bar.max, text.value) == (2, 2, "a&lt;b, two: 2/2 steps, 0 s left")
    assert shown[1] == ({"text/plain": "a<b: 2 of 2 steps"}, True)

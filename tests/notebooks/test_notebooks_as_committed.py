"""Committed figures, twins and what notebooks show are what today's code makes of committed logs."""

import base64
import json
import re
from pathlib import Path

import cv2
import nbformat
import numpy as np
import pytest
from IPython.core.displayhook import DisplayHook
from IPython.core.interactiveshell import InteractiveShell
from IPython.display import Image, publish_display_data
from IPython.utils.capture import capture_output
from made_logs import reference

from sfglab.fields import to_json
from sfglab.lab import notebook
from sfglab.lab.experiments import EXPERIMENTS, experiment
from sfglab.lab.figures import file_sha256, settled
from sfglab.lab.notebooks import COMMANDS, experiments_of, find_notebooks
from sfglab.lab.paths import Project

ROOT = Path(__file__).parents[2]

PIXEL = cv2.imencode(".png", np.zeros((1, 1), np.uint8))[1].tobytes()
# A line that runs an experiment: variable and name.
RUN = re.compile(r"^(\w+) = await notebook\.run\((\w+)\.exp.*\n?", re.MULTILINE)
# Lines that run something, wait for a reader, or print where files are.
ELSEWHERE = re.compile(
    r"await |live\.session|(setup|explore|Viewer|PressedMapping|press_core|save_figures)\("
)


def cells_of(name):
    """Return the code cells of an experiment's notebook."""
    [path] = [p for p in find_notebooks(Project(root=ROOT)) if name in experiments_of(p)]
    return [c for c in nbformat.read(path, as_version=4).cells if c.cell_type == "code"]


def words_of(outputs):
    """Return the tables and words of outputs, in order; not what has a picture, which has a test of its own."""
    shown = [o.get("data", {"text/plain": o.get("text", "")}) for o in outputs]
    texts = [d.get("text/html", d.get("text/plain", "")) for d in shown if "image/png" not in d]
    return "".join(texts).replace(f"{ROOT}/", "").split()


class Shown(DisplayHook):
    """A display hook that keeps the value of a cell's last line like other outputs."""

    def write_output_prompt(self):
        """Write nothing: a notebook has its own."""

    def write_format_data(self, format_dict, md_dict=None):
        """Show it."""
        publish_display_data(format_dict, md_dict)


@pytest.fixture
def shell(monkeypatch):
    """A shell that runs cells as a kernel does. It draws no figures, which another test does."""
    monkeypatch.chdir(ROOT / "notebooks")
    monkeypatch.setattr(notebook, "picture", lambda *_: Image(PIXEL))
    shell = InteractiveShell.instance(displayhook_class=Shown)
    shell.display_formatter.active_types = shell.display_formatter.format_types
    yield shell
    InteractiveShell.clear_instance()


def figures_are_as_drawn(run, name):
    """Compare twins, and the pictures of a notebook."""
    outputs = [] if name in COMMANDS else [o for cell in cells_of(name) for o in cell.outputs]
    pictures = [output.get("data", {}).get("image/png") for output in outputs]
    shown_there = {base64.b64decode(picture) for picture in pictures if picture}
    for stem, (figure, shown) in experiment(name).figures(run).items():
        twin = json.loads((ROOT / "figures" / f"{stem}.json").read_text())
        assert twin["log"] == f"data/reference/{name}.mcap"
        assert twin["log_sha256"] == file_sha256(run.log)
        assert twin["shown"] == json.loads(json.dumps(settled(to_json(shown))))
        if outputs:
            assert notebook.image_of(figure).data in shown_there, f"{stem}: run its cell anew"


def words_are_as_computed(shell, name):
    """Compare tables, sentences and verdicts of what follows the run."""
    is_run = False
    for cell in cells_of(name):
        for variable, runs in RUN.findall(cell.source):
            shell.user_ns[variable] = reference(experiment(runs))
        source = RUN.sub("", cell.source)
        if ELSEWHERE.search(source):
            continue
        with capture_output() as captured:
            done = shell.run_cell(source)
        assert done.success, cell.source
        made = [{"text": captured.stdout}, *({"data": output.data} for output in captured.outputs)]
        assert not is_run or words_of(made) == words_of(cell.outputs), (
            f"to be run anew: {cell.source}"
        )
        is_run = is_run or source != cell.source
    assert is_run


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_figures_twins_pictures_and_tables_follow_from_the_committed_log(name, shell):
    run = reference(experiment(name))
    figures_are_as_drawn(run, name)
    if name not in COMMANDS:
        words_are_as_computed(shell, name)

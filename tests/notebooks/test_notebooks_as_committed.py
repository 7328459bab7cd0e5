"""Committed figures, their twins and the notebooks' pictures are what today's code draws from the committed logs."""

import base64
import json
from pathlib import Path

import nbformat
import pytest

from sfglab.fields import to_json
from sfglab.lab import notebook
from sfglab.lab.experiments import EXPERIMENTS, experiment
from sfglab.lab.figures import file_sha256
from sfglab.lab.notebooks import experiment_of, find_notebooks
from sfglab.lab.paths import Project

ROOT = Path(__file__).parents[2]


def pictures_of(name):
    """Return the pictures that an experiment's notebook holds."""
    notebooks = (nbformat.read(path, as_version=4) for path in find_notebooks(Project(root=ROOT)))
    [page] = [page for page in notebooks if experiment_of(page) == name]
    outputs = [output for cell in page.cells for output in cell.get("outputs", ())]
    return {base64.b64decode(o.data["image/png"]) for o in outputs if "image/png" in o.get("data", {})}


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_figures_twins_and_pictures_follow_from_the_committed_log(name):
    log, shown_there = ROOT / "data" / "reference" / f"{name}.mcap", pictures_of(name)
    for stem, (figure, shown) in experiment(name).figures(experiment(name).load(log)).items():
        twin = json.loads((ROOT / "figures" / f"{stem}.json").read_text())
        assert (twin["log"], twin["log_sha256"]) == (f"data/reference/{name}.mcap", file_sha256(log))
        assert twin["shown"] == json.loads(json.dumps(to_json(shown)))
        assert notebook.image_of(figure).data in shown_there, f"{stem}: its cell is to be run anew"

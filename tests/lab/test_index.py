"""Every experiment has profiles, claims, figures and a place in the index; figures have texts for the blind."""

import json
import re
from pathlib import Path

import nbformat
import pytest
from made_logs import reference

from sfglab.lab import notebook, summary
from sfglab.lab.claims import load_claims
from sfglab.lab.experiments import EXPERIMENTS, experiment
from sfglab.lab.index import make_result
from sfglab.lab.ledger import compute_ledger
from sfglab.lab.notebook_outputs import normalise
from sfglab.lab.notebooks import notebook_of
from sfglab.lab.paths import Project

PROJECT = Project(root=Path(__file__).parents[2])


def test_a_result_has_its_values_figure_verdicts_notebook_and_citations():
    ledger = compute_ledger(PROJECT, committed=True, only=["C-MAP", "C-FSM"])
    edges = {entry.claim.id: entry.value for entry in ledger}["C-MAP"]
    result = make_result(PROJECT, ledger, "There are {C-MAP} edges.", "graph_mapping")
    assert repr(result) == f"There are {edges} edges."
    html = result._repr_html_()
    assert html.count("claim C-MAP") == 1
    assert "C-FSM" not in html
    for part in (f'alt="{experiment("gateways").caption("graph_mapping")}"', "reproduced"):
        assert part in html


def test_pictures_carry_their_text_into_the_notebook(tmp_path):
    _, metadata = notebook.picture(reference(experiment("naming")), "naming_schema")._repr_png_()
    assert metadata == {"alt": experiment("naming").caption("naming_schema")}
    output = nbformat.v4.new_output("display_data", metadata={"image/png": metadata})
    made = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("a", outputs=[output])])
    [kept] = normalise(made, Project(root=tmp_path)).cells[0].outputs
    assert kept.metadata == output.metadata


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_experiment_has_the_three_profiles_with_the_seed_that_is_asked_for(name):
    config = experiment(name).config
    shortest, *longer = (config(profile, seed=7) for profile in ("smoke", "quick", "paper"))
    assert shortest.seed == 7
    assert all(other.seed == 7 and other != shortest for other in longer)


def test_every_claim_is_answered_by_the_experiment_that_the_ledger_names():
    asked = [
        (claim.id, each.experiment)
        for claim in load_claims(PROJECT.claims)
        for each in (claim, claim.criterion)
        if each and each.experiment
    ]
    assert {(claim, name) for name in EXPERIMENTS for claim in experiment(name).claims} == {*asked}


def test_every_figure_has_a_sentence_and_a_line_of_the_list_with_its_notebook():
    """The list is figures/README.md, and its last column the number of the notebook."""
    folder = PROJECT.figures
    listed = re.findall(
        r"^\| `(\w+)` \|.*\| (\w+) \|$", (folder / "README.md").read_text(), re.MULTILINE
    )
    rows = dict(listed)
    assert sorted(rows) == sorted(p.stem for p in folder.iterdir() if p.suffix in {".png", ".gif"})
    captions = {"summary": summary.CAPTION}
    for name in EXPERIMENTS:
        exp = experiment(name)
        number = notebook_of(PROJECT, name)[:2] or "book"  # ros2 has a page of the book
        for drawing in exp.drawings:
            captions[drawing] = exp.caption(drawing)
            assert rows[drawing] == number
            assert json.loads((folder / f"{drawing}.json").read_text())["experiment"] == name
    assert {path.stem for path in folder.glob("*.json")} == {*captions}
    assert [text for text in captions.values() if not re.fullmatch(r"[A-Z].{15,}\.", text)] == []
    pages = "".join((PROJECT.root / page).read_text() for page in ("README.md", "DESIGN.md"))
    for text, name in re.findall(r"!\[(.*?)\]\(figures/(\w+)\.png\)", pages):
        assert text == captions[name]

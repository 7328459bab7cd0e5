"""Every experiment has profiles, claims, figures and a place in the index; figures have texts for the blind."""

import json
import re
from pathlib import Path

import nbformat
import pytest
from made_logs import reference

from sfglab.lab import notebook, summary
from sfglab.lab.claims import Ledger, entry_for, load_claims
from sfglab.lab.experiments import EXPERIMENTS, experiment
from sfglab.lab.index import make_index, make_result
from sfglab.lab.ledger import compute_ledger
from sfglab.lab.notebook_outputs import normalise
from sfglab.lab.notebooks import notebook_of
from sfglab.lab.paths import Project

PROJECT = Project(root=Path(__file__).parents[2])


def test_the_index_has_every_notebook_under_its_paper_with_figure_and_verdicts():
    ledger = Ledger(entry_for(claim, None) for claim in load_claims(PROJECT.claims))
    html = make_index(PROJECT, ledger)._repr_html_()
    papers = html.split("<h3>")[1:]
    assert [paper.count("<tr>") for paper in papers] == [11, 4, 3]
    assert html.count("<img alt=") == len(EXPERIMENTS) - 1, "all but ros2, which has no notebook"
    assert html.count(">not yet<") == len(ledger)
    assert 'href="22_loss.ipynb"' in papers[1]
    assert papers[0].index("12_discovery") < papers[0].index("13_decode_once"), "by section"


def test_the_index_has_a_line_for_each_experiment_of_a_notebook(tmp_path):
    sources = ["# Names and gateways", "notebook.run(naming.exp)", "notebook.run(gateways.exp)"]
    cells = [nbformat.v4.new_markdown_cell(source) for source in sources]
    (tmp_path / "notebooks").mkdir()
    made = nbformat.v4.new_notebook(cells=cells)
    nbformat.write(made, tmp_path / "notebooks" / "01_both.ipynb")
    ledger = Ledger(entry_for(claim, None) for claim in load_claims(PROJECT.claims))
    html = make_index(Project(root=tmp_path), ledger)._repr_html_()
    papers = html.split("<h3>")[1:]
    assert [paper.count('href="01_both.ipynb"') for paper in papers] == [1, 0, 1]
    assert "A-FQN" in papers[0]
    assert "C-MAP" in papers[2]


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


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_figure_has_a_sentence_that_says_what_it_shows(name):
    exp = experiment(name)
    for drawing in exp.drawings:
        assert re.fullmatch(r"[A-Z].{15,}\.", exp.caption(drawing)), drawing


def test_pictures_carry_their_text_into_the_notebook(tmp_path):
    _, metadata = notebook.picture(reference(experiment("naming")), "naming_schema")._repr_png_()
    assert metadata == {"alt": experiment("naming").caption("naming_schema")}
    output = nbformat.v4.new_output("display_data", metadata={"image/png": metadata})
    made = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell("a", outputs=[output])])
    assert normalise(made, Project(root=tmp_path)).cells[0].outputs[0].metadata == {
        "image/png": metadata
    }


def test_pictures_on_the_repositorys_pages_have_their_figures_texts():
    captions = {d: exp.caption(d) for exp in map(experiment, EXPERIMENTS) for d in exp.drawings}
    captions["summary"] = summary.CAPTION
    for page in ("README.md", "DESIGN.md"):
        for text, name in re.findall(
            r"!\[(.*?)\]\(figures/(\w+)\.png\)", (PROJECT.root / page).read_text()
        ):
            assert text == captions[name]


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_experiment_has_the_three_profiles_with_the_seed_that_is_asked_for(name):
    config = experiment(name).config
    shortest, *longer = (config(profile, seed=7) for profile in ("smoke", "quick", "paper"))
    assert shortest.seed == 7
    assert all(other.seed == 7 and other != shortest for other in longer)


def test_every_claim_is_answered_by_the_experiment_that_the_ledger_names():
    ledger = load_claims(PROJECT.claims)
    claims = {(c.id, c.experiment) for c in ledger if c.experiment}
    claims |= {(c.id, c.criterion.experiment) for c in ledger if c.criterion}
    assert {(claim, name) for name in EXPERIMENTS for claim in experiment(name).claims} == claims


def test_every_committed_figure_of_an_experiment_is_declared_by_it():
    twins = [
        json.loads(path.read_text()) | {"stem": path.stem}
        for path in PROJECT.figures.glob("*.json")
    ]
    committed = {(twin["experiment"], twin["stem"]) for twin in twins if twin["stem"] != "summary"}
    declared = {(name, drawing) for name in EXPERIMENTS for drawing in experiment(name).drawings}
    assert committed == declared


def test_the_list_of_figures_names_the_notebook_of_each():
    listed = (PROJECT.figures / "README.md").read_text("utf-8")
    rows = dict(re.findall(r"^\| `(\w+)` \|.*\| (\w+) \|$", listed, re.MULTILINE))
    for name in EXPERIMENTS:
        number = notebook_of(PROJECT, name)[:2] or "book"  # ros2 has a page of the book
        drawings = experiment(name).drawings
        assert {rows[drawing] for drawing in drawings} == ({number} if drawings else set()), name

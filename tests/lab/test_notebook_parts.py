"""Parts of notebooks: the header with its links and verdicts, and the table with its fold."""

import json
import re
from pathlib import Path

import nbformat
import pandas as pd
import pytest

from sfglab.lab import notebook
from sfglab.lab.experiments import experiment
from sfglab.lab.notebooks import COMMANDS, COPY_VARIABLE, RENAMED, NotebookError, find_notebooks
from sfglab.lab.paths import Project

ROOT = Path(__file__).parents[2]
PROJECT = Project(root=ROOT)
# Experiments, and the notebooks before and after theirs.
CHAPTER = {
    "transmission": ("21_caches_and_qos", "23_hallway"),
    "latency": ("13_decode_once", "15_frames"),
}
FOLDERS = ("notebooks", "runs/notebooks", "runs/try/gateways-1")


def links_of(html):
    """Return the targets of links by their text."""
    return {text: target for target, text in re.findall(r'<a href="([^"]+)">([^<]+)</a>', html)}


@pytest.mark.parametrize("folder", FOLDERS)
@pytest.mark.parametrize("name", CHAPTER)
def test_each_link_of_a_header_leads_to_a_file_from_the_notebook_and_from_a_copy(
    name, folder, monkeypatch
):
    monkeypatch.chdir(ROOT / "notebooks")
    monkeypatch.setenv(COPY_VARIABLE, str(ROOT / folder / "copy.ipynb"))
    links = links_of(notebook.header(experiment(name)).data)
    before, after = CHAPTER[name]
    assert [*links] == ["start", f"previous: {before}", f"next: {after}", "ledger", "glossary"]
    targets = [Path(ROOT / folder, target).resolve() for target in links.values()]
    assert [target for target in targets if not target.is_file()] == []
    assert {target.parent for target in targets} == {PROJECT.notebooks, ROOT / "book"}


def test_a_header_without_a_notebook_of_the_experiment_has_no_neighbours(monkeypatch):
    monkeypatch.setattr(notebook, "notebook_of", lambda *_: "")
    links = links_of(notebook.header(experiment("driving")).data)
    assert [*links] == ["start", "ledger", "glossary"]


@pytest.mark.parametrize("name", CHAPTER)
def test_a_committed_header_has_the_verdicts_of_committed_logs(name, monkeypatch):
    [path] = find_notebooks(PROJECT, [name])
    monkeypatch.chdir(path.parent)
    html = notebook.header(experiment(name)).data
    assert json.dumps(html)[1:-1] in json.dumps(nbformat.read(path, as_version=4))
    assert all(claim in html for claim in experiment(name).claims)


@pytest.mark.parametrize(
    ("name", "said"),
    [
        *((former, f"{former} is now called {name}") for former, name in RENAMED.items()),
        *((name, f"{name} has no notebook: {run} runs and") for name, run in COMMANDS.items()),
    ],
)
def test_a_former_name_is_refused_with_what_to_use(name, said):
    with pytest.raises(NotebookError, match=said):
        find_notebooks(PROJECT, [name])


def test_todays_name_of_a_renamed_notebook_is_found():
    names = sorted({*RENAMED.values()})
    assert [path.stem for path in find_notebooks(PROJECT, names)] == names


def test_cells_are_escaped_numbers_are_short_and_missing_values_empty():
    frame = pd.DataFrame({("a", ""): ["<b>", None], ("b", "c"): [1234.5678, 0.0012345]})
    frame["d", ""] = [float("nan"), 2.0]
    html = notebook.table(frame).data
    assert re.findall(r"<t[hd] [^>]*>([^<]*)<", html) == [
        *("a", "b: c", "d"),
        *("&lt;b&gt;", "1235", ""),
        *("", "0.00123", "2"),
    ]
    assert html.count("text-align: right") == 3 * 2

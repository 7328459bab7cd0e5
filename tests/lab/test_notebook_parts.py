"""Parts of notebooks: the header with its links and verdicts, and the table with its fold."""

import re
from pathlib import Path

import nbformat
import pandas as pd
import pytest
from nbformat.v4 import new_code_cell, new_notebook, new_output

from sfglab.lab import notebook
from sfglab.lab.experiments import experiment
from sfglab.lab.notebook_outputs import normalise
from sfglab.lab.notebooks import COMMANDS, COPY_VARIABLE, RENAMED, NotebookError, find_notebooks
from sfglab.lab.paths import Project

ROOT = Path(__file__).parents[2]
PROJECT = Project(root=ROOT)
# Experiments of chapters B and C, whose notebooks have headers, and the notebooks before and after.
CHAPTER = {
    "balancing": ("18_deployment", "22_loss"),
    "transmission": ("21_caches_and_qos", "23_hallway"),
    "cooperation": ("22_loss", "31_mapping_and_gateway"),
    "gateways": ("23_hallway", "32_transfer"),
    "transfer": ("31_mapping_and_gateway", "33_driving"),
    "latency": ("13_decode_once", "15_frames"),
}
FOLDERS = ("notebooks", "runs/notebooks", "runs/try/gateways-1")


def links_of(html):
    """Return the targets of links by their text."""
    return {text: target for target, text in re.findall(r'<a href="([^"]+)">([^<]+)</a>', html)}


def tables_of(path):
    """Yield the HTML of a notebook's outputs."""
    for cell in nbformat.read(path, as_version=4).cells:
        for output in cell.get("outputs", ()):
            yield output.get("data", {}).get("text/html", "")


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


@pytest.mark.parametrize("name", CHAPTER)
def test_a_committed_header_has_working_links_and_the_verdicts_of_committed_logs(name, monkeypatch):
    [path] = find_notebooks(PROJECT, [name])
    monkeypatch.chdir(path.parent)
    [committed] = [html for html in tables_of(path) if ">start</a>" in html]
    assert committed == notebook.header(experiment(name)).data
    assert all(claim in committed for claim in experiment(name).claims)


def test_a_header_without_a_notebook_of_the_experiment_has_no_neighbours(monkeypatch):
    monkeypatch.setattr(notebook, "notebook_of", lambda *_: "")
    links = links_of(notebook.header(experiment("driving")).data)
    assert [*links] == ["start", "ledger", "glossary"]


def test_links_from_a_copy_become_those_from_the_folder_of_notebooks(monkeypatch):
    monkeypatch.chdir(PROJECT.notebooks)
    here = notebook.header(experiment("driving")).data
    monkeypatch.setenv(COPY_VARIABLE, str(ROOT / "runs/try/driving-1/copy.ipynb"))
    copy = notebook.header(experiment("driving")).data
    output = new_output("execute_result", {"text/html": copy}, execution_count=1)
    made = normalise(new_notebook(cells=[new_code_cell(outputs=[output])]), PROJECT)
    assert made.cells[0].outputs[0].data["text/html"] == here != copy


@pytest.mark.parametrize(("former", "name"), RENAMED.items())
def test_a_notebook_that_was_renamed_is_refused_with_its_new_name(former, name):
    with pytest.raises(NotebookError, match=f"{former} is now called {name}"):
        find_notebooks(PROJECT, [f"notebooks/{former}.ipynb"])
    assert find_notebooks(PROJECT, [name])


@pytest.mark.parametrize(("name", "command"), COMMANDS.items())
def test_what_has_no_notebook_is_refused_with_the_command_that_runs_it(name, command):
    with pytest.raises(NotebookError, match=f"{name} has no notebook: {command} runs and records"):
        find_notebooks(PROJECT, [name])


@pytest.mark.parametrize(("count", "shown"), [(0, 0), (10, 10), (11, 10)])
def test_rows_after_the_tenth_are_behind_show_all(count, shown):
    html = notebook.table(pd.DataFrame({"place": range(count)})).data
    first, fold, whole = html.partition(f"<details><summary>show all {count} rows</summary>")
    assert first.count("<tr>") == 1 + shown
    assert bool(fold) == (count > shown)
    assert whole.count("<tr>") == (1 + count if fold else 0)


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

"""Working copies begin with the committed logs, have links that lead somewhere, and keep what a user changed."""

import re
import shutil
import sys
from pathlib import Path
from unittest.mock import Mock

import nbformat
import pytest
from commands import called
from jupyter_client import KernelManager
from jupyter_server.services.kernels.websocket import KernelWebsocketHandler
from made_logs import reference

from sfglab.lab import notebook
from sfglab.lab.connection import PromptConnection
from sfglab.lab.copies import copy_notebooks
from sfglab.lab.experiments import naming
from sfglab.lab.log_switch import log_switch
from sfglab.lab.notebook import ExperimentError
from sfglab.lab.paths import Project

ROOT = Path(__file__).parents[2]


@pytest.fixture
def project(tmp_path):
    """A checkout with one notebook."""
    (tmp_path / "notebooks").mkdir()
    shutil.copy(ROOT / "notebooks" / "12_discovery.ipynb", tmp_path / "notebooks")
    return Project(root=tmp_path)


def change(path, text):
    page = nbformat.read(path, as_version=4)
    page.cells[0].source = text
    nbformat.write(page, path)


def test_a_copy_reads_the_committed_logs_and_says_how_to_run(project):
    assert copy_notebooks(project) == []
    page = nbformat.read(project.runs / "lab" / "12_discovery.ipynb", as_version=4)
    nbformat.validate(page)
    [parameters] = [c.source for c in page.cells if "parameters" in c.metadata.get("tags", ())]
    assert 'log_lifecycle: str = "reference"\n' in parameters
    assert 'log_discovery: str = "reference"\n' in parameters
    assert parameters.endswith('or "" to run now.')
    [switch] = [c.source for c in page.cells if c.id == "log-switch"]
    assert switch.endswith('log_switch(globals(), "7.5 min")')


def test_the_switch_chooses_all_logs_and_is_heard_again_after_the_parameters_cell():
    parameters = {"log_naming": "reference", "log_routing": "reference"}
    cells = {**parameters, "logarithm": "2", "seed": 0}
    for choice in ("newest", ""):
        buttons, _ = log_switch(cells, "1 min").children  # Run Selected Cell
        buttons.value = choice
    assert [label for label, _ in buttons.options][-1] == "run now (1 min)"
    assert cells == {"log_naming": "", "log_routing": "", "logarithm": "2", "seed": 0}
    cells.update(parameters)  # Run All
    buttons, _ = log_switch(cells, "1 min").children
    assert (cells["log_naming"], buttons.value) == ("", "")
    cells.update(log_naming="mine.mcap", log_routing="")  # another parameters cell
    buttons, text = log_switch(cells, "1 min").children
    assert (cells["log_naming"], buttons.value) == ("mine.mcap", None)
    assert text.value == "The parameters cell names other logs."


def test_without_widgets_the_parameters_cell_chooses(monkeypatch):
    monkeypatch.setitem(sys.modules, "ipywidgets", None)
    cells = {"log": "mine.mcap"}
    assert "ipywidgets" in log_switch(cells, "1 min")
    assert cells == {"log": "mine.mcap"}


def test_a_changed_copy_is_kept_and_one_that_was_only_saved_follows_its_notebook(project):
    source, copy = project.notebooks / "12_discovery.ipynb", project.runs / "lab/12_discovery.ipynb"
    copy_notebooks(project)
    nbformat.write(nbformat.read(copy, as_version=4), copy)  # as JupyterLab does: lists of lines
    change(source, "# Newer")
    assert copy_notebooks(project) == []
    assert "# Newer" in copy.read_text("utf-8")
    change(copy, "# Mine")
    assert copy_notebooks(project) == [], "its notebook is not newer"
    change(source, "# Newest")
    [said] = copy_notebooks(project)
    assert said.endswith("has your changes and is kept; 12_discovery.ipynb is newer")
    assert "# Mine" in copy.read_text("utf-8")


@pytest.mark.parametrize("text", [b"", b"[]", b'{"cells": [{}]}', b"\xff"])
def test_a_damaged_copy_is_set_aside_and_replaced(project, text):
    copy = project.runs / "lab/12_discovery.ipynb"
    copy_notebooks(project)
    whole = copy.read_bytes()
    copy.write_bytes(text)
    [said] = copy_notebooks(project)
    [aside] = copy.parent.glob("*.txt")
    assert (aside.read_bytes(), copy.read_bytes()) == (text, whole)
    assert said.startswith("12_discovery.ipynb: not a notebook")
    assert aside.name in said


def test_without_a_folder_for_copies_the_notebooks_themselves_open(project, monkeypatch):
    (project.root / "data").mkdir()
    (project.root / "data/claims.yaml").write_text("[]")
    project.runs.write_text("a file in the way")
    monkeypatch.setenv("SFGLAB_ROOT", str(project.root))
    started = []
    monkeypatch.setattr("os.execve", lambda *call: started.append(call))
    said = called("lab")
    assert "so the notebooks themselves open: " in said
    [(_, argv, _)] = started
    assert "--LabApp.default_url=/lab/tree/notebooks/00_start.ipynb" in argv
    [chosen] = [one for one in argv if "kernel_websocket_connection_class" in one]
    assert chosen.endswith(f"={PromptConnection.__module__}.{PromptConnection.__name__}")


def test_the_page_s_connection_to_a_kernel_waits_for_no_acknowledgement(monkeypatch):
    base = PromptConnection.__bases__[0]
    monkeypatch.setattr(base, "connect", lambda connection: connection)
    page = Mock(spec=KernelWebsocketHandler)
    kernel = KernelManager()
    connection = PromptConnection(parent=kernel, websocket_handler=page)
    assert connection.connect() is connection
    page.set_nodelay.assert_called_once_with(True)


def test_all_copies_have_links_to_files_and_a_switch_with_the_time_of_a_run(tmp_path):
    shutil.copytree(ROOT / "notebooks", tmp_path / "notebooks")
    copy_notebooks(Project(root=tmp_path))
    for copy in (tmp_path / "runs" / "lab").glob("*.ipynb"):
        assert "time not stated" not in copy.read_text("utf-8"), copy.name
        for cell in nbformat.read(copy, as_version=4).cells:
            shown = [output.get("data", {}) for output in cell.get("outputs", ())]
            pages = [data.get("text/html", "") for data in shown]
            if cell.cell_type == "markdown":
                pages.append(cell.source)
            for link in re.findall(r'\]\((?!http)([^)#]+)|href="(?!http)([^"#]+)', "".join(pages)):
                target = (copy.parent / "".join(link)).resolve().relative_to(tmp_path)
                assert (ROOT / target).exists() or (tmp_path / target).exists(), (copy, link)


@pytest.mark.parametrize("root", [".", "../..", "link"])
def test_a_header_in_a_copy_leads_to_copies(monkeypatch, tmp_path, root):
    for name in ("notebooks", "data"):
        (tmp_path / name).symlink_to(ROOT / name)
    folder = tmp_path / "runs" / "lab"
    folder.mkdir(parents=True)
    (folder / "link").symlink_to(tmp_path)
    monkeypatch.chdir(folder)
    monkeypatch.setenv("SFGLAB_ROOT", str(tmp_path) if root == "." else root)
    html = notebook.header(naming.exp).data
    assert 'href="./00_start.ipynb"' in html
    assert 'href="../../book/glossary.md"' in html


async def test_a_log_is_named_by_a_word(project, monkeypatch):
    monkeypatch.setenv("SFGLAB_ROOT", str(project.root))
    project.reference_logs.mkdir(parents=True)
    (project.data / "claims.yaml").write_text("[]")
    with pytest.raises(ExperimentError, match="there is no reference log"):
        await notebook.run(naming.exp, "quick", "reference")
    committed = project.reference_logs / "naming.mcap"
    shutil.copy(reference(naming.exp).log, committed)
    logs = project.runs / "logs" / "naming"
    newest = logs / "20260102T000000-quick.mcap"
    logs.mkdir(parents=True)
    for log in (newest, logs / "20260101T000000-quick.mcap"):
        shutil.copy(committed, log)
    assert (await notebook.run(naming.exp, "quick", "reference")).log == committed
    assert (await notebook.run(naming.exp, "quick", "newest")).log == newest

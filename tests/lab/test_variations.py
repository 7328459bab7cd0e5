"""A variation is reported as what it is: it counts for no claim, asserts nothing, and replaces no file."""

import os
import subprocess
import sys
from pathlib import Path

import pytest
from commands import called
from made_logs import CLAIMS, make_checkout, ran

from sfglab.errors import SfglabError
from sfglab.lab import notebook
from sfglab.lab.claims import Finding, How, entry_for
from sfglab.lab.experiment import SMOKE_TITLE
from sfglab.lab.experiments import experiment
from sfglab.lab.ledger import figures_folder, save_figures
from sfglab.lab.notebooks import Outcome, try_experiment
from sfglab.lab.paths import find_project
from sfglab.lab.stats import Estimate

ROOT = Path(__file__).parents[2]


@pytest.fixture
def checkout(tmp_path, monkeypatch):
    """A checkout with notebooks, inputs and the committed logs."""
    make_checkout(tmp_path)
    monkeypatch.setenv("SFGLAB_ROOT", str(tmp_path))
    return tmp_path


def sfglab(*words):
    argv = [sys.executable, "-P", "-m", "sfglab", *words]
    return subprocess.run(argv, env=os.environ, capture_output=True, text=True, check=False)


async def run_without_notebook(task, _nice):
    """Run the experiment itself and save its figures, instead of the notebook."""
    task.copy.write_text("the executed copy")
    project = find_project()
    run = await experiment("naming").run("smoke", **task.parameters["settings_naming"])
    save_figures(project, run, figures_folder(project, run.log, task.copy))
    return ""


def test_a_variation_prints_its_claims_and_files_and_replaces_nothing(checkout, monkeypatch):
    monkeypatch.setattr("sfglab.lab.notebooks._run_papermill", run_without_notebook)
    others = []
    for name in ("notebooks/11_names_and_border.ipynb", "figures/naming_schema.svg"):
        file = checkout / "runs" / name
        file.parent.mkdir(parents=True)
        file.write_text("of another run")
        others.append(file)
    words = ["reproduce", "naming", "--profile", "smoke", "-p", "settings_naming={samples: 10}"]
    printed = called(*words)
    assert "warning: reproduce -p is now called sfglab try\n" in printed
    assert "This run counts for no claim: " in printed
    assert "A-FQN" in printed
    assert "A-CPU-SFG" not in printed, "claims of other experiments"
    assert [file.read_text() for file in others] == ["of another run"] * 2
    for kind in ("  notebook: ", "  log: ", "  figures: "):
        ran, *_read = [line for line in printed.splitlines() if line.startswith(kind)]
        assert (checkout / ran.removeprefix(kind)).exists()


@pytest.mark.slow
def test_a_try_has_notebook_log_figures_and_summary_in_a_folder_of_its_own(checkout):
    words = ["try", "naming", "samples=10", "--profile", "smoke", "--name", "few"]
    done = sfglab(*words)
    assert done.returncode == 0, done.stderr
    folder = checkout / "runs" / "try" / "few"
    files = {file.relative_to(folder).as_posix() for file in folder.rglob("*.*")}
    own = {"11_names_and_border.ipynb", "naming.mcap", "summary.txt"}
    drawn = {f"figures/naming_schema.{suffix}" for suffix in ("json", "png", "svg")}
    assert own | drawn <= files
    assert done.stdout.startswith("naming: profile smoke, samples=10\n")
    assert "A-FQN" in done.stdout
    assert "This run counts for no claim: " in done.stdout
    for file in own:
        assert f": runs/try/few/{file}" in done.stdout
    assert (folder / "summary.txt").read_text() in done.stdout
    assert sorted(path.name for path in (checkout / "runs").iterdir()) == ["cache", "try"]
    with pytest.raises(SfglabError, match="--name: given 'few', allowed: another name, because"):
        called(*words)


def test_a_try_without_a_name_has_the_next_number(checkout, monkeypatch):
    folders = []

    def run(name, folder, **_):
        folders.append(folder.name)
        folder.mkdir(parents=True)
        return Outcome(name=name, error="", notebook=folder / "a.ipynb", logs={})

    monkeypatch.setattr("sfglab.lab.notebooks.try_experiment", run)
    for _ in range(2):
        called("try", "naming", "--profile", "smoke")
    assert folders == ["naming-1", "naming-2"]


@pytest.mark.parametrize(
    ("name", "claims"), [("naming", ["A-FQN"]), ("ros2", []), ("", ["A-FQN", "B-COOP"])]
)
def test_the_claims_of_the_notebooks_that_ran_are_printed_and_no_others(
    checkout, monkeypatch, name, claims
):
    logs = {name: checkout / "a.mcap"} if name else {}
    done = Outcome(name=name, error="", notebook=checkout / "a.ipynb", logs=logs)
    monkeypatch.setattr("sfglab.lab.notebooks.run_notebooks", lambda *_, **__: [done])
    printed = called("reproduce", *(["naming"] if name else []))
    assert [claim for claim in ("A-FQN", "B-COOP") if claim in printed] == claims
    assert ("No claim of the ledger was measured." in printed) is not bool(claims)


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        ("nonesuch", "experiment: given 'nonesuch', allowed: naming, .*, ros2$"),
        ("naming sample=1", "naming: sample: given 'sample', allowed: .*; did you mean 'samples'"),
        ("naming samples=few", "samples: given 'few', allowed: a whole number"),
        ("naming samples", "parameter: given 'samples', allowed: FIELD=VALUE"),
        ("naming log=a.mcap", "naming: log: given 'log', allowed: "),
        ("naming path=a.mcap", "naming: path: given 'path', allowed: "),
        ("naming profile=fast", "profile: given 'fast', allowed: smoke, quick, paper"),
        ("naming --name ../few", "--name: given '../few', allowed: the name of a folder, without"),
        ("naming --name .", "--name: given '.', allowed: the name of a folder, without"),
    ],
)
def test_a_try_refuses_what_it_cannot_use_in_one_sentence(checkout, words, sentence):
    with pytest.raises(SfglabError, match=sentence):
        called("try", *words.split())
    assert not (checkout / "runs" / "try").exists()


def test_a_try_is_refused_if_its_notebook_declares_no_settings(checkout):
    notebook = checkout / "notebooks" / "32_transfer.ipynb"
    text = notebook.read_text()
    notebook.unlink()  # the copy may be a link to the committed notebook
    notebook.write_text(text.replace("settings: dict = {}", "other: dict = {}"))
    with pytest.raises(SfglabError, match="its parameters cell must declare settings"):
        try_experiment(
            "transfer",
            checkout / "runs" / "try" / "a",
            project=find_project(),
            parameters={"profile": "smoke"},
        )


def test_of_a_changed_run_nothing_is_asserted_and_of_another_everything(checkout, tmp_path):
    exp = experiment("naming")
    usual, changed = ran(exp, tmp_path / "a.mcap"), ran(exp, tmp_path / "b.mcap", samples=10)
    assert not usual.is_changed
    assert changed.is_changed
    with pytest.raises(AssertionError, match="A-FQN: reproduced; expected better"):
        notebook.check(usual, "better")
    assert notebook.check(changed, "better").startswith("nothing is asserted: this run counts for")
    with pytest.raises(AssertionError, match="nonsense"):
        notebook.require(usual, condition=False, what="nonsense")
    notebook.require(changed, condition=False, what="nonsense")


@pytest.mark.parametrize("name", ["naming", "gateways"])
def test_each_title_of_a_smoke_test_says_so(name, tmp_path):
    exp = experiment(name)
    for figure, _ in exp.figures(ran(exp, tmp_path / "a.mcap")).values():
        titles = [figure.get_suptitle(), *(axes.get_title() for axes in figure.axes)]
        assert any(title.startswith(SMOKE_TITLE) for title in titles)


def test_the_ledger_prints_a_negative_saving_as_more():
    claim = CLAIMS["A-CPU-SFG"]
    saving = Estimate(value=-101.0, low=-150.0, high=-50.0, unit=claim.unit)
    entry = entry_for(claim, Finding(estimate=saving, how=How.LIVE))
    assert entry.value == "101 [50, 150]"
    assert entry.unit.startswith("% more CPU per subscriber")

"""The runner: stricter than papermill, one failure hides nothing, outputs are normalised."""

import asyncio
import os
import shutil
import signal
import threading
import time
from pathlib import Path
from unittest.mock import Mock

import nbformat
import psutil
import pytest
from nbformat.v4 import new_code_cell, new_notebook, new_output

from sfglab.errors import SfglabError
from sfglab.lab import notebook, notebooks, progress
from sfglab.lab.experiments import naming
from sfglab.lab.notebook_outputs import normalise
from sfglab.lab.paths import Project, find_project
from sfglab.lab.progress import is_line, progress_bar
from sfglab.record import LogWriter

ROOT = Path(__file__).parents[2]


@pytest.fixture
def project(tmp_path):
    (tmp_path / "notebooks").mkdir()
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "claims.yaml").write_text("[]")
    return Project(root=tmp_path)


def write(project: Project, name: str, *sources: str, tagged: int = 1) -> None:
    cells = [new_code_cell(source) for source in sources]
    for cell in cells[:tagged]:
        cell.metadata["tags"] = ["parameters"]
    nbformat.write(new_notebook(cells=cells), project.notebooks / f"{name}.ipynb")


PROFILE = 'profile: str = "quick"'
PLAIN = PROFILE, "print(profile)"
DEPTH = (
    f'{PROFILE}\nsource: str = "stereo"\nsettings: dict = {{}}',
    "notebook.run(depth_codecs.exp)",
)


PARAMETERS = f"""{PROFILE}
seed: int = 0
log_naming: str = ""
settings_naming: dict = {{}}
log_gateways: str = ""
settings_gateways: dict = {{}}"""
IMPORTS = """from sfglab.lab import notebook
from sfglab.lab.experiments import gateways, naming"""
RUN = "run = await notebook.run({0}.exp, profile, log_{0}, settings_{0}, seed=seed)"
SHOWN = "shown = run.experiment, len(run['{}'])\nprint(*shown)"
SEVERAL = [PARAMETERS, IMPORTS]
SEVERAL += [RUN.format("naming"), SHOWN.format("check"), "print(shown)"]
SEVERAL += [RUN.format("gateways"), SHOWN.format("stage")]


@pytest.mark.parametrize(
    ("sources", "given", "fitted"),
    [
        (DEPTH, {"frames": 3, "settings": {"seed": 2}}, {"settings": {"seed": 2, "frames": 3}}),
        (SEVERAL, {"settings_naming": {"samples": 10}}, {"settings_naming": {"samples": 10}}),
    ],
)
def test_fields_of_experiments_travel_as_settings(project, sources, given, fitted):
    write(project, "02_a", *sources)
    assert notebooks.fit_parameters(project.notebooks / "02_a.ipynb", given) == fitted


@pytest.mark.parametrize(
    ("sources", "given", "sentence"),
    [
        (PLAIN, {"speed": 1}, "declares no parameter speed; its parameters are profile"),
        (DEPTH, {"speed": 1}, "depth_codecs: speed: given 'speed', allowed: .*frames"),
        (DEPTH, {"profile": "fast"}, "profile: given 'fast', allowed: smoke, quick, paper"),
        (SEVERAL, {"samples": 10}, "declares no parameter samples; its parameters are"),
        (SEVERAL, {"settings_naming": 3}, "settings: given 3, allowed: a mapping of fields"),
        (
            SEVERAL,
            {"settings_naming": {"samples": "few"}},
            "samples: given 'few', allowed: a whole",
        ),
    ],
)
def test_what_no_parameter_or_field_can_hold_is_said_before_anything_runs(
    project, sources, given, sentence
):
    write(project, "02_a", *sources)
    found = notebooks.find_notebooks(project)
    with pytest.raises(notebooks.NotebookError, match=sentence):
        notebooks.run_notebooks(found, project=project, parameters=given)
    assert not project.runs.exists()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        (("quick", "nowhere.mcap"), "no such file"),
        (("quick", "", [1]), "settings: given .*, allowed: a mapping of fields"),
        (("quick", "a.mcap"), "log: given .*a.mcap', allowed: a log of the experiment naming"),
    ],
)
def test_a_notebook_refuses_its_parameters_in_one_sentence(
    project, arguments, sentence, monkeypatch
):
    monkeypatch.setenv("SFGLAB_ROOT", str(project.root))
    with LogWriter(project.root / "a.mcap") as log:
        log.write_metadata("config", {"experiment": "routing"})
    with pytest.raises(SfglabError, match=sentence):
        asyncio.run(notebook.run(naming.exp, *arguments))


@pytest.mark.parametrize("tagged", [0, 2])
def test_a_notebook_needs_exactly_one_parameters_cell(project, tagged):
    write(project, "01_a", "x: int = 1", "y: int = 2", tagged=tagged)
    with pytest.raises(notebooks.NotebookError, match=f"{tagged} cells have the tag"):
        notebooks.fit_parameters(project.notebooks / "01_a.ipynb", {})


MEASURED = "# notebook.run(depth_codecs.exp)"
COMPUTED = "# notebook.run(naming.exp)"
WAITS = """
import os, time
from pathlib import Path
until = time.monotonic() + 60
while not Path("../{0}").exists() and time.monotonic() < until:
    time.sleep(0.05)
assert Path("../{0}").exists()
print(os.getpriority(os.PRIO_PROCESS, 0))
"""
BEGINS = "from pathlib import Path; Path('../{}').touch()"
PRIORITY = """
import os
from pathlib import Path
group = Path(f"/proc/{os.getpid()}/autogroup")
print(os.getpriority(os.PRIO_PROCESS, 0))
print(group.read_text().split()[-1] if group.exists() else 19)
"""


@pytest.fixture
def two_cores(monkeypatch):
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0, 1})


def outputs(outcome):
    return nbformat.read(outcome.notebook, as_version=4).cells[-1].outputs[0].text.split()


@pytest.mark.slow
def test_notebooks_that_only_compute_run_beside_those_that_measure_at_low_priority(
    project, two_cores, capfd
):
    asks_all = "assert Path('../measured').exists() and Path('../computed').exists()"
    write(project, "00_start", "x: int = 1", f"from pathlib import Path; {asks_all}")
    begins = BEGINS.format("measured")
    write(project, "01_a", "x: int = 1", begins, MEASURED, WAITS.format("computed"))
    begins = BEGINS.format("computed")
    write(project, "02_b", "x: int = 1", WAITS.format("measured"), begins, COMPUTED, PRIORITY)
    found = notebooks.find_notebooks(project)
    outcomes = notebooks.run_notebooks(found, project=project, parameters={"x": 4})
    assert [(o.name, o.error) for o in outcomes] == [(p.stem, "") for p in found]
    assert outcomes[-1].name == "00_start", "it reports on all others"
    assert outputs(outcomes[0]) == [str(os.nice(0))]
    assert outputs(outcomes[1]) == ["19", "19"]
    said = capfd.readouterr().err
    assert [said.count(words) for words in (" ...", " done after ")] == [3, 3]


@pytest.mark.slow
def test_a_failed_notebook_does_not_stop_the_others_and_is_not_replaced(
    project, tmp_path, monkeypatch
):
    monkeypatch.setenv("TMPDIR", str(tmp_path))  # a killed process leaves its sockets
    kills = "import os, signal; os.kill(os.getppid(), signal.SIGKILL)"
    write(project, "01_a", "x: int = 1", kills)
    write(project, "02_b", "x: int = 1", "import os; os._exit(1)")
    write(project, "03_c", "x: int = 1", "1 / 0")
    monkeypatch.setattr("os.sched_getaffinity", lambda _: {0})
    write(project, "04_d", "x: int = 1", COMPUTED, "import os; print(x, os.getpriority(0, 0))")
    found = notebooks.find_notebooks(project)
    outcomes = notebooks.run_notebooks(
        [*found, *found], project=project, parameters={"x": 4}, write=True
    )
    killed = "papermill: it ended with status -9"
    failed = "cell 3: ZeroDivisionError: division by zero"
    assert [o.error for o in outcomes] == [killed, "Kernel died", failed, ""]
    assert outputs(outcomes[3]) == ["4", str(os.nice(0))], "on one core, in the only process"
    assert "ZeroDivisionError" in outcomes[2].notebook.read_text()
    cells = [nbformat.read(path, as_version=4).cells for path in found]
    assert [len(notebook) for notebook in cells] == [2, 2, 2, 3], "no injected cell"
    assert [cells[at][-1].outputs != [] for at in (2, 3)] == [False, True]


LINGERS = """import time
kernel = get_ipython().kernel
reply = kernel.shell_handlers["kernel_info_request"]
async def reply_and_linger(*given):
    await reply(*given)
    time.sleep(1)
kernel.shell_handlers["kernel_info_request"] = reply_and_linger"""


@pytest.mark.slow
def test_the_end_of_a_notebook_does_not_interrupt_its_kernel(project, capfd):
    write(project, "01_a", "x: int = 1", LINGERS)
    found = notebooks.find_notebooks(project)
    [outcome] = notebooks.run_notebooks(found, project=project, parameters={})
    assert outcome.error == ""
    assert "KeyboardInterrupt" not in capfd.readouterr().err


@pytest.mark.slow
def test_ctrl_c_ends_both_processes_and_their_kernels(project, two_cores, tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    sleeps = "import time; time.sleep(600)"
    write(project, "01_a", "x: int = 1", BEGINS.format("measured"), sleeps)
    write(project, "02_b", "x: int = 1", COMPUTED, BEGINS.format("computed"), sleeps)

    sessions = []

    def interrupt():
        both = [project.root / "measured", project.root / "computed"]
        while not all(file.exists() for file in both):
            time.sleep(0.05)
        children = [child for child in psutil.Process().children() if child.pid not in before]
        runs = [child for child in children if "sfglab.lab.notebook_process" in child.cmdline()]
        sessions.extend(os.getsid(child.pid) for child in runs)
        os.kill(os.getpid(), signal.SIGINT)

    before = {process.pid for process in psutil.Process().children(recursive=True)}
    threading.Thread(target=interrupt, daemon=True).start()
    with pytest.raises(KeyboardInterrupt):
        notebooks.run_notebooks(notebooks.find_notebooks(project), project=project, parameters={})
    left = [p for p in psutil.Process().children(recursive=True) if p.pid not in before]
    _, alive = psutil.wait_procs(left, timeout=10)
    assert [p for p in alive if "resource_tracker" not in str(p.cmdline())] == []
    assert list(tmp_path.glob("tmp*")) == [], "no sockets"
    assert len({*sessions, os.getsid(0)}) == 3, "a terminal interrupts neither process itself"


def test_a_notebook_without_a_log_of_its_own_has_none_of_former_runs(project):
    write(project, "01_a", *SEVERAL)
    task = notebooks._Task(project.notebooks / "01_a.ipynb", project.runs / "01_a.ipynb", {})
    log = project.runs / "logs" / "naming" / "a.mcap"
    log.parent.mkdir(parents=True)
    log.touch()
    assert task.logs(project, [log]) == {}
    assert task.logs(project, []) == {"naming": log}


@pytest.fixture
def several(project, monkeypatch):
    """A notebook with two experiments, and the committed log of one of them."""
    monkeypatch.setenv("SFGLAB_ROOT", str(project.root))
    write(project, "01_both", *SEVERAL)
    project.reference_logs.mkdir()
    shutil.copy(ROOT / "data" / "reference" / "gateways.mcap", project.reference_logs)
    return project.notebooks / "01_both.ipynb"


@pytest.mark.slow
def test_an_experiments_name_runs_it_and_reads_the_others(project, several):
    parameters = {"profile": "smoke"}
    assert notebooks.find_notebooks(project, ["naming"]) == [several]
    [outcome] = notebooks.run_notebooks(
        [several], project=project, parameters=parameters, only=["naming"]
    )
    assert outcome.error == ""
    assert [log.parent.name for log in outcome.logs.values()] == ["naming", "reference"]
    assert [path.name for path in (project.runs / "logs").iterdir()] == ["naming"]
    with pytest.raises(notebooks.NotebookError, match="naming: there is no log data/reference/na"):
        notebooks.run_notebooks(
            [several], project=project, parameters=parameters, only=["gateways"]
        )


@pytest.mark.slow
def test_a_failed_experiment_leaves_a_sentence_and_the_next_one_runs(project, several):
    parameters = {"log_naming": "nowhere.mcap", "log_gateways": "data/reference/gateways.mcap"}
    [outcome] = notebooks.run_notebooks([several], project=project, parameters=parameters)
    assert outcome.error.startswith("cell 4: ExperimentError: naming failed: ")
    assert [*outcome.logs] == ["gateways"]
    cells = nbformat.read(outcome.notebook, as_version=4).cells
    _, _, failed, skipped, skipped_too, ran, shown = cells[-7:]
    [output] = failed.outputs
    [sentence] = output.traceback
    assert sentence == output.evalue
    assert skipped.outputs == skipped_too.outputs == ran.outputs == []
    assert shown.outputs[0].text.startswith("gateways ")


def test_notebooks_are_found_by_name_beginning_or_topic(project):
    names = ["01_naming", "02_depth", "03_depth_more"]
    for name in names:
        write(project, name, "x: int = 1")
    assert [p.stem for p in notebooks.find_notebooks(project)] == names
    for given in ("01", "naming", "01_naming.ipynb", "notebooks/01_naming.ipynb"):
        assert [p.stem for p in notebooks.find_notebooks(project, [given])] == ["01_naming"]
    with pytest.raises(notebooks.NotebookError, match="fits several"):
        notebooks.find_notebooks(project, ["0"])
    with pytest.raises(
        notebooks.NotebookError, match="is no notebook and no experiment; allowed: 01_naming"
    ):
        notebooks.find_notebooks(project, ["nothing"])


def test_parameters_are_read_as_yaml():
    read = notebooks.read_parameters(["seed=3", "source=drive.mp4", "ok=true"])
    assert read == {"seed": 3, "source": "drive.mp4", "ok": True}
    with pytest.raises(notebooks.NotebookError, match="allowed: FIELD=VALUE"):
        notebooks.read_parameters(["seed"])


def test_outputs_lose_paths_progress_and_traces_of_the_run(project):
    root = project.root.resolve()
    traces = {"execution": {"iopub": "12:00:00"}, "papermill": {"duration": 1}}
    cell = new_code_cell("x", metadata=traces, execution_count=17)
    cell.outputs = [
        new_output("stream", name="stdout", text="naming: checks, b: 1/2 steps, 3 s left\n"),
        new_output("stream", name="stdout", text=f"{root}/figures/a.svg\n"),
        new_output("stream", name="stdout", text="a line that came later\n"),
        new_output("stream", name="stderr", text="a warning\n"),
        new_output("execute_result", data={"text/plain": f"'{root}/x'"}, execution_count=17),
        new_output("display_data", data={"text/html": '<a href="../../../book/a.md">'}),
    ]
    injected = new_code_cell("x = 2", metadata={"tags": ["injected-parameters"]})
    made = new_notebook(cells=[injected, cell], metadata={"papermill": {"start": "now"}})
    [normal] = normalise(made, project).cells
    assert (normal.execution_count, normal.metadata) == (1, {})
    lines, warning, result, page = normal.outputs
    assert lines.text == "figures/a.svg\na line that came later\n"
    assert (warning.text, result.data["text/plain"]) == ("a warning\n", "'x'")
    assert page.data["text/html"] == '<a href="../book/a.md">', "from the folder of notebooks"


def test_the_project_is_found_from_below_and_by_its_variable(project, monkeypatch, tmp_path):
    monkeypatch.delenv("SFGLAB_ROOT", raising=False)
    monkeypatch.chdir(project.notebooks)
    assert find_project().root == project.root.resolve()
    monkeypatch.setenv("SFGLAB_ROOT", str(tmp_path))
    assert find_project().root == tmp_path
    monkeypatch.setenv("SFGLAB_ROOT", str(tmp_path / "nowhere"))
    with pytest.raises(SfglabError, match="SFGLAB_ROOT"):
        find_project()


def test_lines_of_progress_come_now_and_then_and_are_known_as_such(capsys):
    with progress_bar(1000, "naming") as advance:
        for number in range(1000):
            advance(str(number))
    line = capsys.readouterr().err
    assert line == "naming, 999: 1000/1000 steps, 0 s left\n"
    assert is_line(line)
    assert not is_line("12 steps, 0 s left over")


def test_jupyterlab_has_a_widget_and_a_line_in_its_place_at_the_end(monkeypatch):
    pytest.importorskip("ipywidgets")
    display = Mock()
    monkeypatch.setattr("IPython.display.display", display)
    monkeypatch.setattr(progress, "_in_jupyterlab", lambda: True)
    with progress_bar(2, "a<b") as advance:
        bar, text = display.call_args.args[0].children
        advance("one")
        advance("two")
        assert (bar.value, bar.max, text.value) == (2, 2, "a&lt;b, two: 2/2 steps, 0 s left")
    display.return_value.update.assert_called_once_with(
        {"text/plain": "a<b: 2 of 2 steps"}, raw=True
    )

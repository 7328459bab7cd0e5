"""Every notebook in the smoke profile, in a checkout of its own.

The cells run in this process. A process and a kernel for each notebook would import all libraries again.
The tests of `sfglab try` and of the runner have kernels.
"""

import asyncio
import builtins
import contextlib
import os
import warnings
from pathlib import Path

import nbformat
import psutil
import pytest
from IPython.core.async_helpers import get_asyncio_loop
from IPython.core.interactiveshell import InteractiveShell
from IPython.utils.capture import capture_output
from made_logs import make_checkout
from traitlets.config import Config

from sfglab.lab.checks import trees
from sfglab.lab.experiments import decode_once, experiment, mocap, visualisation
from sfglab.lab.experiments.latency import results as latency
from sfglab.lab.experiments.latency.experiment import PATHS
from sfglab.lab.experiments.visualisation.results import DELAY
from sfglab.lab.notebooks import REPORTS, experiments_of, find_notebooks
from sfglab.lab.paths import Project
from sfglab.record import LogReader
from sfglab.spatial.frames.buffer import FrameBuffer
from sfglab.spatial.frames.lint import lint_frames
from sfglab.spatial.frames.listener import fill_from_log

ROOT = Path(__file__).parents[2]
# Figures of each notebook in a smoke test, which replaces none of the repository.
FIGURES_ANYWHERE = {
    "21_caches_and_qos": "balancing_caches balancing_qos",
    "22_loss": "phases transmission_latency transmission_live transmission_loss transmission_validation",
    "23_hallway": "cooperation cooperation_tracks",
    "31_mapping_and_gateway": "gateway_core graph_mapping",
    "32_transfer": "transfer transfer_live",
    "33_driving": "driving_chain driving_lap",
    "16_planning": "planning_interpolation planning_scene",
    "18_deployment": "deployment_layers",
}
# The same for those that mean little without hosts of their own.
FIGURES_OF_HOSTS = {
    "11_names_and_border": "naming_schema routing_border",
    "13_decode_once": "decode_once_h264 depth_codecs",
    "12_discovery": "discovery_fleet discovery_states",
    "14_latency": "latency",
    "15_frames": "mocap_error mocap_trees",
    "17_viewer": "visualisation_latency visualisation_points",
    "19_middleware": "middleware_cost middleware_scale",
    "24_wireless": "wireless_age wireless_video",
}
FIGURES = FIGURES_ANYWHERE | FIGURES_OF_HOSTS
NOTEBOOKS = [path.stem for path in find_notebooks(Project(root=ROOT)) if path.stem not in REPORTS]
LIVE = [pytest.mark.live, pytest.mark.netns]
NAMES = [pytest.param(name, marks=LIVE if name in FIGURES_OF_HOSTS else ()) for name in NOTEBOOKS]


@pytest.fixture
def project(tmp_path, monkeypatch):
    """A checkout of its own with the committed logs; what runs for it is gone at the end."""
    make_checkout(tmp_path)
    monkeypatch.setenv("SFGLAB_ROOT", str(tmp_path))
    monkeypatch.chdir(tmp_path / "notebooks")
    before = children()
    yield Project(root=tmp_path)
    # A forked child has the environment of this process.
    started = (children() - before) | processes_of(tmp_path)
    _, alive = psutil.wait_procs(started, timeout=60)
    commands = [process.cmdline() for process in alive]
    assert [command for command in commands if "resource_tracker" not in str(command)] == []


@pytest.fixture
def shell(tmp_path_factory, monkeypatch):
    """A shell that runs cells as a kernel does, and leaves nothing to the next one."""
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path_factory.mktemp("ipython")))
    monkeypatch.setitem(vars(builtins), "display", None)  # the shell sets it
    config = Config(HistoryManager={"enabled": False})
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # as in a kernel, no warning is an error
        shell = InteractiveShell.instance(config=config)
        yield shell
        end_loop()
    shell.restore_sys_module_state()
    InteractiveShell.clear_instance()


def end_loop():
    """Cancel what still runs on the event loop of the shell's cells, and close it; IPython then makes another."""
    loop = get_asyncio_loop()
    tasks = asyncio.all_tasks(loop)
    for task in tasks:
        task.cancel()
    if tasks:
        loop.run_until_complete(asyncio.wait(tasks))
    loop.run_until_complete(loop.shutdown_asyncgens())
    loop.close()


def children():
    """Return the processes that descend from this one."""
    return set(psutil.Process().children(recursive=True))


def processes_of(folder):
    """Return the processes of a checkout, by their environment."""
    found = set()
    for process in psutil.process_iter():
        with contextlib.suppress(psutil.Error):
            if process.pid != os.getpid() and process.environ().get("SFGLAB_ROOT") == str(folder):
                found.add(process)
    return found


def run_through(shell, name):
    """Run the cells of a notebook, which must end well."""
    notebook = nbformat.read(f"{name}.ipynb", as_version=4)
    for cell in notebook.cells:
        if cell.cell_type != "code":
            continue
        with capture_output() as captured:
            done = shell.run_cell(cell.source)
        assert done.success, f"{cell.source}\n{captured.stdout}"
        if "parameters" in cell.metadata.get("tags", ()):
            shell.user_ns["profile"] = "smoke"


WRONG = ["unreadable", "disordered", "broken"]


def frames_are_whole(run):
    """Each mode shows frames, readable and in order."""
    checks = decode_once.frame_checks(run)
    assert {"standard", "dds", "proxy"} <= set(checks.loc[checks["frames"] > 0, "mode"])
    assert (checks[WRONG] == 0).all(axis=None)


def pictures_are_present(run):
    """No picture on any way is a wrong one, and keepers are asked where they should be."""
    table = latency.checks(run).set_index("path")
    assert set(table.index) == set(PATHS)
    assert (table[WRONG] == 0).all(axis=None)
    assert (table["pictures"] > 0).all()
    assert set(table.index[table["replay_packets"] > 0]) == {"decoder", "agent"}, (
        "keepers were asked"
    )
    assert (latency.sights(run)["glass_ms"] > 0).all()


def the_bridge_keeps_the_tree_whole(run):
    """The direct receiver does not, and what is logged is a tree."""
    table = mocap.checks(run)
    broken = table[table["held"] < table["checked"]]["check"]
    # The time of an answer, and the distance of two samples, depend on the machine.
    slow = ("each look-up is answered", "within 20 mm")
    assert [name for name in broken if not any(words in name for words in slow)] == []
    assert run.log.stat().st_size < 100_000
    buffer = FrameBuffer(history_s=None)
    with LogReader(run.log) as reader:
        fill_from_log(reader, buffer)
    assert lint_frames(buffer.edges, agents=[trees.AGENT], root="map") == ()


def everything_is_shown(run):
    """The claim is filled, every fact holds, and both arms are timed."""
    measured, table = visualisation.exp.measure(run)["A-VIZ"], visualisation.facts(run)
    assert measured.how.value == "live"
    # How long a picture takes depends on the machine: what waits for a CPU is late. The claim's log was quiet.
    broken = table[(table["held"] < table["checked"]) & (table["check"] != DELAY)]
    assert broken.empty, measured.reason
    assert set(visualisation.latency_table(run).index) == {"bare", "bridge"}
    assert run.log.stat().st_size < 500_000


def every_way_recovers(run):
    """Without loss samples are young, and after the short outage they and the latched value arrive again."""
    cells = run["samples"]
    assert (cells.loc[cells["channel"] == "no loss", "age_p95_ms"] < 1000).all()
    outages = cells[cells["outage_s"] > 0]
    assert set(outages["way"]) == set(run.config.ways)
    assert outages[["flows_s", "latched_s", "whole_s"]].notna().all(axis=None)
    assert run["video"]["frozen"].between(0, 1).all()


LIVE_RUNS = {
    "decode_once": frames_are_whole,
    "latency": pictures_are_present,
    "mocap": the_bridge_keeps_the_tree_whole,
    "visualisation": everything_is_shown,
    "wireless": every_way_recovers,
}
"""Checks of the logs of live runs, by experiment."""


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_a_notebook_runs_through_and_leaves_a_log_its_figures_and_nothing_else(
    project, shell, name
):
    run_through(shell, name)
    logs = sorted(project.runs.glob("logs/*/*.mcap"))
    experiments = experiments_of(ROOT / "notebooks" / f"{name}.ipynb")
    assert [log.parent.name for log in logs] == sorted(experiments)
    assert not project.figures.exists()
    drawn = sorted(path.stem for path in (project.runs / "figures").rglob("*.svg"))
    assert drawn == FIGURES[name].split()
    for log in logs:
        run = experiment(log.parent.name).load(log)
        assert run.profile == "smoke"
        check = LIVE_RUNS.get(log.parent.name, lambda _: None)
        check(run)


@pytest.mark.slow
@pytest.mark.parametrize("name", REPORTS)
def test_a_report_runs_through_on_the_reference_logs(name, project, shell):
    run_through(shell, name)
    assert not project.runs.joinpath("logs").exists()

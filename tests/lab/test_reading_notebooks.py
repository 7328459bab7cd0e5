"""Who opens notebooks with `sfglab lab`, looks and closes them is asked nothing, and git is clean."""

import os
import shutil
import subprocess
import sys
import tempfile
from contextlib import closing
from pathlib import Path

import pytest
from lab_page import ANSWER_S, OPTIONS, SESSION
from machine import open_browser

pytestmark = [pytest.mark.live, pytest.mark.browser, pytest.mark.slow]

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted(path.name for path in (ROOT / "notebooks").glob("*.ipynb"))
DIALOGS = "[...document.querySelectorAll('.jp-Dialog')].map(dialog => dialog.innerText)"
WIDGET = "window.jupyterapp.shell.currentWidget"
READ = f"{WIDGET}?.title.label == '%s' && {WIDGET}.context?.isReady && {SESSION}?.isReady"
KERNEL = f"{SESSION}.session?.kernel?.connectionStatus == 'connected'"
TOLD = f"{WIDGET}.model.getMetadata('language_info')?.version"
CLOSED = "[...window.jupyterapp.shell.widgets('main')].every(w => w.title.label != '%s')"


def git(folder, *words):
    who = ["-c", "user.name=x", "-c", "user.email=x"]
    done = subprocess.run(["git", *who, *words], cwd=folder, capture_output=True, check=True)
    return done.stdout.decode()


@pytest.fixture
def checkout(tmp_path):
    """A repository with notebooks and data, nothing else."""
    for name in ("notebooks", "data", "figures"):
        shutil.copytree(ROOT / name, tmp_path / name, ignore=shutil.ignore_patterns(".*"))
    shutil.copy(ROOT / ".gitignore", tmp_path)
    git(tmp_path, "init", "-q")
    git(tmp_path, "add", "-A")
    git(tmp_path, "commit", "-qm", "x")
    return tmp_path


@pytest.fixture
def address(checkout):
    """The address of the JupyterLab that `sfglab lab` serves."""
    with tempfile.TemporaryDirectory() as home:
        environment = os.environ | {
            "SFGLAB_ROOT": str(checkout),
            "HOME": home,
            "PYTHONPATH": str(ROOT),
        }
        options = (*OPTIONS, "--ServerApp.port=0", "--ServerApp.ip=127.0.0.1")
        argv = [sys.executable, "-m", "sfglab", "lab", "--", *options]
        pipe = subprocess.PIPE
        lab = subprocess.Popen(argv, env=environment, cwd=checkout, stderr=pipe, text=True)
        lines = iter(lab.stderr.readline, "")
        served = (line.split()[-1] for line in lines if " http://127.0.0.1:" in line)
        yield next(served).partition("/lab")[0]
        lab.terminate()
        lab.communicate(timeout=ANSWER_S)


def test_reading_all_notebooks_asks_nothing_and_leaves_git_clean(checkout, address):
    with closing(open_browser(1280, 900)) as page:
        page.open(f"{address}/lab/tree/notebooks/{NOTEBOOKS[0]}?reset")
        page.wait_for("window.jupyterapp != null", ANSWER_S)
        for name in NOTEBOOKS:
            opened = f"jupyterapp.commands.execute('docmanager:open', {{path: 'notebooks/{name}'}})"
            page.evaluate(f"void {opened}")
            page.wait_for(READ % name, ANSWER_S)
            page.wait_for(KERNEL, ANSWER_S)
            page.wait_for(TOLD, ANSWER_S)
            assert not page.evaluate(f"{WIDGET}.model.dirty"), f"{name}: taken for changed"
            page.evaluate("void jupyterapp.commands.execute('application:close')")
            page.wait_for(CLOSED % name, ANSWER_S)
            assert page.evaluate(DIALOGS) == []
    assert git(checkout, "status", "--porcelain") == ""

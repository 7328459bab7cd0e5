"""Notebooks that are only read in `sfglab lab` ask nothing and stay as they are in git."""

import json
import shutil
import subprocess
from contextlib import closing

import pytest
from lab_page import ANSWER_S, ROOT, SESSION, served_lab
from machine import open_browser

pytestmark = [pytest.mark.live, pytest.mark.browser, pytest.mark.slow]

NOTEBOOKS = sorted(path.name for path in (ROOT / "notebooks").glob("*.ipynb"))
EDITED, OTHER_PYTHON = NOTEBOOKS[:2]
COMMANDS = "window.jupyterapp.commands"
WIDGET = "window.jupyterapp.shell.currentWidget"
KERNEL = f"{SESSION}?.session?.kernel"
CODE = f"{WIDGET}.content.widgets.find(cell => cell.model.type == 'code').model.sharedModel"
DIALOGS = "[...document.querySelectorAll('.jp-Dialog, .Toastify__toast')].map(one => one.innerText)"
READ = f"{WIDGET}?.title.label == '%s' && {SESSION}?.isReady && {KERNEL}?.status == 'idle'"
# When the kernel has described itself, and JupyterLab has written that into the notebook.
TOLD = f"""Promise.all([{WIDGET}.revealed, {KERNEL}.info]).then(
  () => new Promise(written => setTimeout(written)))"""
CLOSED = "[...window.jupyterapp.shell.widgets('main')].every(one => one.title.label != '%s')"


def git(folder, *words):
    who = ["-c", "user.name=x", "-c", "user.email=x"]
    done = subprocess.run(["git", *who, *words], cwd=folder, capture_output=True, check=True)
    return done.stdout.decode()


@pytest.fixture(scope="module")
def checkout(tmp_path_factory):
    """A repository with notebooks and data, nothing else; another Python's kernel described one notebook."""
    folder = tmp_path_factory.mktemp("checkout")
    for name in ("notebooks", "data", "figures"):
        shutil.copytree(ROOT / name, folder / name, ignore=shutil.ignore_patterns(".*"))
    shutil.copy(ROOT / ".gitignore", folder)
    file = folder / "notebooks" / OTHER_PYTHON
    notebook = json.loads(file.read_text())
    notebook["metadata"]["language_info"]["version"] = "3.0.0"
    file.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n")
    git(folder, "init", "-q")
    git(folder, "add", "-A")
    git(folder, "commit", "-qm", "x")
    return folder


@pytest.fixture(scope="module")
def address(checkout, tmp_path_factory):
    """The address of the JupyterLab that `sfglab lab` serves."""
    with served_lab(checkout, tmp_path_factory.mktemp("home")) as address:
        yield address


@pytest.fixture
def page(address):
    with closing(open_browser(1280, 900)) as page:
        page.open(f"{address}/lab/tree/notebooks/{NOTEBOOKS[0]}?reset")
        page.wait_for("window.jupyterapp != null", ANSWER_S)
        yield page


def read(page, name):
    """Open a notebook and wait until it is shown and its kernel idles."""
    page.evaluate(f"void {COMMANDS}.execute('docmanager:open', {{path: 'notebooks/{name}'}})")
    page.wait_for(READ % name, ANSWER_S)
    page.call("Runtime.evaluate", expression=TOLD, awaitPromise=True)


def close(page, name):
    """Close the notebook that is shown; return what JupyterLab asks."""
    page.evaluate(f"void {COMMANDS}.execute('application:close')")
    page.wait_for(f"{DIALOGS}.length || {CLOSED % name}", ANSWER_S)
    return page.evaluate(DIALOGS)


def test_reading_all_notebooks_asks_nothing_and_leaves_git_clean(checkout, page):
    for name in NOTEBOOKS:
        read(page, name)
        assert not page.evaluate(f"{WIDGET}.model.dirty"), f"{name}: taken for changed"
        assert close(page, name) == []
    assert git(checkout, "status", "--porcelain") == ""


def test_own_changes_are_saved_on_request_only_and_without_the_version_of_python(checkout, page):
    read(page, EDITED)
    assert page.evaluate(f"{COMMANDS}.isToggled('docmanager:toggle-autosave')") is False
    page.evaluate(f"{CODE}.setSource('import this\\n' + {CODE}.getSource())")
    (asked,) = close(page, EDITED)
    assert "Save your work" in asked
    page.press("Cancel")
    page.wait_for(f"!{DIALOGS}.length", ANSWER_S)
    assert git(checkout, "status", "--porcelain") == ""
    page.evaluate(f"void {COMMANDS}.execute('docmanager:save')")
    page.wait_for(f"!{WIDGET}.model.dirty", ANSWER_S)
    assert close(page, EDITED) == []
    assert git(checkout, "diff", "--numstat").split() == ["1", "0", f"notebooks/{EDITED}"]
    git(checkout, "commit", "-qam", "x")  # the tests share the checkout, in any order

"""JupyterLab in a browser: it is served; a notebook of one cell is written and run; the handles of sliders."""

import os
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from threading import Thread

import nbformat

ROOT = Path(__file__).parents[2]
ANSWER_S = 300
OPTIONS = ("--no-browser", "--IdentityProvider.token=", "--LabApp.expose_app_in_browser=True")
SESSION = "window.jupyterapp?.shell.currentWidget?.sessionContext"
HANDLE = """(() => { const row = [...document.querySelectorAll('.widget-slider')].find(
  r => r.querySelector('label').innerText.trim() === '%s');
  row.scrollIntoView({block: 'center'});
  const track = row.querySelector('.noUi-base').getBoundingClientRect();
  const handle = row.querySelector('.noUi-handle').getBoundingClientRect();
  return [handle.x + handle.width / 2, handle.y + handle.height / 2, track.x, track.width]; })()"""


@contextmanager
def served_lab(checkout, home, *options, port=0, start=subprocess.Popen):
    """Run `sfglab lab` in a checkout; yield its address."""
    own = {"SFGLAB_ROOT": str(checkout), "HOME": str(home), "PYTHONPATH": str(ROOT)}
    argv = [
        sys.executable,
        "-m",
        "sfglab",
        "lab",
        "--",
        *OPTIONS,
        f"--ServerApp.port={port}",
        *options,
    ]
    run = {"env": os.environ | own, "cwd": checkout, "text": True}
    with start(argv, stderr=subprocess.PIPE, **run) as lab:
        try:
            line = next(line for line in lab.stderr if " http://" in line)
            # A full pipe would stop JupyterLab.
            Thread(target=lab.stderr.read, daemon=True).start()
            yield line.split()[-1].partition("/lab")[0].replace("localhost", "127.0.0.1")
        finally:
            lab.terminate()
            lab.wait(ANSWER_S)


def write_notebook(file, cell):
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell)])
    notebook.metadata.kernelspec = {
        "name": "python3",
        "display_name": "Python 3",
        "language": "python",
    }
    nbformat.write(notebook, file)


def run_all(page):
    """Run the notebook that is open, once its kernel is there."""
    page.wait_for(
        f"{SESSION}?.isReady && {SESSION}.session?.kernel?.connectionStatus == 'connected'",
        ANSWER_S,
    )
    page.evaluate("void jupyterapp.commands.execute('notebook:run-all-cells')")

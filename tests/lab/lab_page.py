"""JupyterLab in a browser: a notebook of one cell is written and run; where its sliders have their handles."""

import nbformat

ANSWER_S = 300
OPTIONS = ("--no-browser", "--IdentityProvider.token=", "--LabApp.expose_app_in_browser=True")
SESSION = "window.jupyterapp?.shell.currentWidget?.sessionContext"
HANDLE = """(() => { const row = [...document.querySelectorAll('.widget-slider')].find(
  r => r.querySelector('label').innerText.trim() === '%s');
  row.scrollIntoView({block: 'center'});
  const track = row.querySelector('.noUi-base').getBoundingClientRect();
  const handle = row.querySelector('.noUi-handle').getBoundingClientRect();
  return [handle.x + handle.width / 2, handle.y + handle.height / 2, track.x, track.width]; })()"""


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

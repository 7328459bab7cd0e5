"""JupyterLab as `sfglab lab` serves it, below a path, seen through a reverse proxy on another host."""

import socket
import subprocess
import sys
from contextlib import ExitStack, closing

import pytest
from lab_page import ANSWER_S, ROOT, run_all, served_lab, write_notebook
from machine import open_browser

from sfglab.lab.hosts import Network

pytestmark = [pytest.mark.live, pytest.mark.browser, pytest.mark.netns]

BASE, PORT = "/user/a/", 8888
# Serves the listening socket that it inherits, and passes on what begins with the path; names all else.
PROXY = """
import asyncio, socket, sys
async def copy(reader, writer, path=b""):
    while data := await reader.read(65536):
        line = data.split(b"\\r\\n", 1)[0].split(b" ")
        if path and line[-1:] == [b"HTTP/1.1"] and not line[1].startswith(path):
            print(line[1].decode(), flush=True)
            break
        writer.write(data)
        await writer.drain()
    writer.close()
async def serve(reader, writer):
    from_server, to_server = await asyncio.open_connection(sys.argv[2], sys.argv[3])
    await asyncio.gather(copy(reader, to_server, sys.argv[4].encode()), copy(from_server, writer))
async def main():
    served = await asyncio.start_server(serve, sock=socket.socket(fileno=int(sys.argv[1])))
    await served.serve_forever()
asyncio.run(main())
"""
CELL = """from IPython.display import display
from sfglab.lab.experiments import naming
from sfglab.lab.explore.viewer import LogViewer
from pathlib import Path
from sfglab.spatial.scene.editor import Editor
from sfglab.view.planner.server import Planner
run = await naming.exp.run("smoke")
planner = Planner(Editor.open(Path("data/scenes/hall.yaml")))
display(planner, LogViewer("data/reference/mocap.mcap"))"""
FOLDERS = "document.querySelector('.jp-DirListing-content').innerText.includes('data')"
SHOWN = "document.querySelector('.jp-OutputArea').innerText.includes('shown: step ')"
CANVAS = "document.querySelector('.jp-OutputArea iframe')?.contentDocument?.querySelector('canvas') != null"


@pytest.fixture
def address(tmp_path):
    """The address, on this host, of a proxy that leads to a JupyterLab on another; it must refuse nothing."""
    project = tmp_path / "checkout"
    (project / "data/reference").mkdir(parents=True)
    for name in ("notebooks", "data/scenes", "data/claims.yaml", "data/reference/mocap.mcap"):
        (project / name).symlink_to(ROOT / name)
    write_notebook(project / "cell.ipynb", CELL)
    with ExitStack() as ending:
        network = ending.enter_context(Network())
        listener = ending.enter_context(socket.create_server(("127.0.0.1", 0)))
        server, proxy = network.add_host("server"), network.add_host("proxy")
        options = f"--ServerApp.ip={server.address}", f"--ServerApp.base_url={BASE}"
        lab = served_lab(project, tmp_path, *options, port=PORT, start=server.popen)
        ending.enter_context(lab)
        number = listener.fileno()
        argv = [sys.executable, "-c", PROXY, str(number), server.address, str(PORT), BASE]
        passing = proxy.popen(argv, pass_fds=[number], stdout=subprocess.PIPE, text=True)
        yield f"http://127.0.0.1:{listener.getsockname()[1]}{BASE}"
        passing.terminate()
        assert passing.communicate(timeout=ANSWER_S)[0] == "", "asked for beside the path"


def test_index_widgets_and_editor_work_below_a_path_on_another_host(address):
    with closing(open_browser(1300, 1000)) as browser:
        browser.open(address)
        browser.wait_for("document.querySelector('#jp-main-dock-panel h1') != null", ANSWER_S)
        assert "00_start" in browser.evaluate("document.title + location.href")
        assert not browser.evaluate("document.body.innerText.includes('Would you like')")
        browser.evaluate("void jupyterapp.commands.execute('filebrowser:go-to-path', {path: '/'})")
        browser.wait_for(FOLDERS, ANSWER_S)
        browser.open(f"{address}lab/tree/cell.ipynb?reset")
        run_all(browser)
        browser.wait_for(CANVAS, ANSWER_S)
        browser.wait_for(
            SHOWN, ANSWER_S
        )  # through the kernel's connection: its loopback is another host's
        said = browser.evaluate("document.querySelector('.jp-OutputArea').innerText")
    assert "naming: " in said

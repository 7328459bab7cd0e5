"""The book's tutorials and how-tos do what they say: each block is run as printed, on a host of its own.

A block ``bash`` is given to a shell, ``python`` to a kernel; a ``text`` block below it is what it says,
line by line, with ``...`` for what differs. A comment before a block says more: ``file: NAME`` is written,
``stays`` is started, watched and ended with the page, ``refused`` must fail, ``not run`` is for readers alone.
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

import nbformat
import pytest
from made_logs import share_findings
from nbclient import NotebookClient
from nbclient.exceptions import CellExecutionError
from waiting import wait_until

from sfglab.lab.hosts import Network

ROOT = Path(__file__).parents[1]
BLOCK = re.compile(
    r"(?:^<!-- ([^\n]*) -->\n)?^```(bash|python|yaml|text|toml)\n(.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
WAIT_S = 180  # a guard, no verdict
WITH_BLOCKS = sorted(
    path.relative_to(ROOT / "book").as_posix()
    for path in [*(ROOT / "book").glob("tutorials/*.md"), *(ROOT / "book").glob("*.md")]
    if path.name != "index.md" and BLOCK.search(path.read_text("utf-8"))
)


class Block(NamedTuple):
    mark: str
    kind: str
    text: str
    says: list[str]


def blocks_of(page: Path) -> list[Block]:
    found: list[Block] = []
    for mark, kind, text in BLOCK.findall(page.read_text("utf-8")):
        if kind == "text":
            found[-1].says.extend(text.splitlines())
        else:
            found.append(Block(mark, kind, text, []))
    return found


def missing(block: Block, output: str) -> list[str]:
    """Return the lines that a block should say and did not."""
    gaps = [re.split(r" *\.\.\. *", line.strip()) for line in block.says]
    patterns = [".*".join(map(re.escape, parts)) for parts in gaps]
    return [pattern for pattern in patterns if not re.search(pattern, output)]


class Terminals:
    """Shells on one host, in one folder; what a shell's set-up does in one, each does."""

    def __init__(self, host, folder: Path) -> None:
        self.host, self.folder, self.set_up, self.kept = host, folder, "", []

    def run(self, block: Block) -> None:
        log = self.folder / f"terminal{len(list(self.folder.glob('terminal*')))}"
        environment = os.environ | {"SFGLAB_ROOT": str(self.folder), "PYTHONPATH": str(ROOT)}
        text = f"exec {block.text}" if block.mark == "stays" else block.text
        argv = ["bash", "-c", f"set -e\n{self.set_up}\n{text}"]
        with log.open("wb") as file:
            # Without a terminal, so that JupyterLab ends at once and does not ask.
            streams = {"stdin": subprocess.DEVNULL, "stdout": file, "stderr": file}
            shell = self.host.popen(argv, cwd=self.folder, env=environment, **streams)
        self.set_up += "".join(re.findall(r"^source .*\n", block.text, re.MULTILINE))
        if block.mark == "stays":
            self.kept.append((shell, block, log))
            wait_until(
                lambda: shell.poll() is not None or not missing(block, log.read_text()), WAIT_S
            )
            assert shell.poll() is None, log.read_text("utf-8")
            return
        status = shell.wait(WAIT_S)
        said = log.read_text("utf-8")
        assert (status != 0) is (block.mark == "refused"), (block, said)
        assert "Traceback" not in said, said
        assert missing(block, said) == [], said

    def end(self) -> None:
        for shell, _, _ in reversed(self.kept):
            shell.send_signal(signal.SIGINT)
        for shell, block, log in self.kept:
            status, said = shell.wait(WAIT_S), log.read_text("utf-8")
            assert status in {0, 130}, (block, said)
            assert "Traceback" not in said, (block, said)


@contextmanager
def terminals(folder: Path):
    share_findings(folder)
    for name in ("data", "notebooks"):
        (folder / name).symlink_to(ROOT / name)
    (folder / ".venv").symlink_to(sys.prefix)
    with Network() as network:
        made = Terminals(network.add_host("here"), folder)
        yield made
        made.end()


@pytest.mark.slow
@pytest.mark.live
@pytest.mark.netns
@pytest.mark.parametrize("page", WITH_BLOCKS)
def test_a_page_does_what_it_says(page, tmp_path):
    cells: list[Block] = []
    with terminals(tmp_path) as shells:
        for block in blocks_of(ROOT / "book" / page):
            if block.mark.startswith("file: "):
                (tmp_path / block.mark.removeprefix("file: ")).write_text(
                    block.text, encoding="utf-8"
                )
            elif block.kind == "bash" and block.mark != "not run":
                shells.run(block)
            elif block.kind == "python" and block.mark != "not run":
                cells.append(block)
        if cells:
            run_cells(cells, tmp_path)


def run_cells(blocks: list[Block], folder: Path) -> None:
    """Run blocks as the cells of one notebook."""
    cells = [nbformat.v4.new_code_cell(b.text.rstrip("\n")) for b in blocks]
    notebook = nbformat.v4.new_notebook(cells=cells)
    environment = os.environ | {"SFGLAB_ROOT": str(folder), "PYTHONPATH": str(ROOT)}
    client = NotebookClient(notebook, timeout=WAIT_S, resources={"metadata": {"path": folder}})
    with client.setup_kernel(env=environment):
        for at, block in enumerate(blocks):
            try:
                client.execute_cell(cells[at], at)
                assert block.mark != "refused"
            except CellExecutionError:
                assert block.mark == "refused", cells[at].outputs
            assert missing(block, str(cells[at].outputs)) == [], cells[at].outputs

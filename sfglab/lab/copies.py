"""Working copies of the notebooks, which `sfglab lab` opens: they begin with the committed logs.

A copy of a notebook shows the reference run at first, so that *Run All* takes seconds. Its parameters
cell says how to read another log or to measure. A copy that was changed is kept.
"""

from __future__ import annotations

import hashlib
import json
import re
from typing import TYPE_CHECKING, Any

from sfglab.lab.notebooks import COPIES, NEWEST, REFERENCE, find_notebooks

if TYPE_CHECKING:
    from pathlib import Path

    from sfglab.lab.paths import Project

_MADE = "sfglab"  #: Key of a copy's metadata with the digests of its cells and of its source's.
_LOG = re.compile(r'^(log\w*: str = )""$', re.MULTILINE)
_CHOICES = f'# A log is "{REFERENCE}", "{NEWEST}" (your newest run), a path, or "" to run now.'


def copy_notebooks(project: Project) -> list[str]:
    """Make or renew the copies; return a sentence for each changed copy whose notebook is newer."""
    folder = project.runs / COPIES
    folder.mkdir(parents=True, exist_ok=True)
    kept = []
    for source in find_notebooks(project):
        notebook = json.loads(source.read_text("utf-8"))
        digest = _digest(notebook)
        path = folder / source.name
        if path.is_file():
            before = json.loads(path.read_text("utf-8"))
            made = before["metadata"].get(_MADE, {})
            if made.get("source") == digest:
                continue
            if made.get("copy") != _digest(before):
                name = project.relative(path)
                kept.append(f"{name} has your changes and is kept; {source.name} is newer")
                continue
        _write(path, notebook, digest)
    return kept


def _digest(notebook: dict[str, Any]) -> str:
    """Return a digest of the cells, outputs included."""
    cells = json.dumps(notebook["cells"], sort_keys=True)
    return hashlib.sha256(cells.encode()).hexdigest()


def _write(path: Path, notebook: dict[str, Any], digest: str) -> None:
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        if "parameters" in cell["metadata"].get("tags", ()) and _LOG.search(source):
            source = _LOG.sub(rf'\1"{REFERENCE}"', f"{source}\n{_CHOICES}")
        if cell["cell_type"] == "markdown":
            source = source.replace("](../", "](../../")
        cell["source"] = source
        for output in cell.get("outputs", ()):
            html = output.get("data", {}).get("text/html")
            if html is not None:
                output["data"]["text/html"] = _linked("".join(html))
    notebook["metadata"][_MADE] = {"source": digest, "copy": _digest(notebook)}
    path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False), encoding="utf-8")


def _linked(html: str) -> str:
    """Return a page whose links to notebooks lead to copies, and others to files of the checkout."""
    return html.replace('href="../notebooks/', 'href="').replace('href="../', 'href="../../')

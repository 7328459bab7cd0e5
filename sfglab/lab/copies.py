"""Working copies of the notebooks, which `sfglab lab` opens: they begin with the committed logs.

A copy of a notebook shows the reference run at first, so that *Run All* takes seconds. A switch below
its parameters cell chooses other logs, or measures. A copy that was changed is kept, and one that
cannot be read gets another name.
"""

from __future__ import annotations

import hashlib
import json
import re
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab.files import write_files
from sfglab.lab.notebooks import (
    COPIES,
    NEWEST,
    REFERENCE,
    NotebookError,
    find_notebooks,
    read_notebook,
)

if TYPE_CHECKING:
    from sfglab.lab.paths import Project

_MADE = "sfglab"  #: Key of a copy's metadata with the digests of its cells and of its source's.
_LOG = re.compile(r'^(log\w*: str = )""$', re.MULTILINE)
_TIME = re.compile(r"\*\*Expected time\.\*\*[^\d\n]*([\d.]+ \w+)")
_CHOICES = f'# A log is "{REFERENCE}", "{NEWEST}" (your newest run), a path, or "" to run now.'


def copy_notebooks(project: Project) -> list[str]:
    """Make or renew the copies; return a sentence for each that is kept or set aside.

    Raises:
        NotebookError: A notebook of the checkout is none.
        OSError, InvalidValueError: The folder of the copies cannot be read or written.
    """
    folder = project.runs / COPIES
    said = []
    files: dict[Path, str | bytes] = {}
    for source in find_notebooks(project):
        notebook = read_notebook(source)
        digest = _digest(notebook)
        path = folder / source.name
        if path.is_file():
            name = project.relative(path)
            try:
                before = read_notebook(path)
            except NotebookError as error:
                aside = _set_aside(path)
                said.append(f"{error}; it is now {aside.name}, and {name} is new")
            else:
                made = before["metadata"].get(_MADE, {})
                if made.get("source") == digest:
                    continue
                if made.get("copy") != _digest(before):
                    said.append(f"{name} has your changes and is kept; {source.name} is newer")
                    continue
        files[Path(source.name)] = _copy_of(notebook, digest)
    write_files(files, folder=folder)
    return said


def _set_aside(path: Path) -> Path:
    """Give a file that is no notebook another name, so that nothing of it is lost."""
    stamp = datetime.now(UTC).strftime("%Y%m%dT%H%M%S-%f")
    return path.rename(path.with_name(f"{path.stem}-damaged-{stamp}.txt"))


def _digest(notebook: dict[str, Any]) -> str:
    """Return a digest of the cells, outputs included."""
    cells = json.dumps(_joined(notebook["cells"]), sort_keys=True)
    return hashlib.sha256(cells.encode()).hexdigest()


def _joined(value: Any) -> Any:
    """Return a value of JSON with texts for lists of lines, which JupyterLab saves."""
    if isinstance(value, dict):
        return {key: _joined(one) for key, one in value.items()}
    if not isinstance(value, list):
        return value
    if all(isinstance(one, str) for one in value):
        return "".join(value)
    return [_joined(one) for one in value]


def _copy_of(notebook: dict[str, Any], digest: str) -> str:
    """Return the text of a notebook's copy."""
    stated = _TIME.search("\n".join(cell["source"] for cell in notebook["cells"]))
    expected_time = stated[1] if stated else "time not stated"
    cells = []
    for cell in notebook["cells"]:
        cells.append(cell)
        source = cell["source"]
        if "parameters" in cell["metadata"].get("tags", ()) and _LOG.search(source):
            source = _LOG.sub(rf'\1"{REFERENCE}"', f"{source}\n{_CHOICES}")
            cells.append(_switch(expected_time))
        if cell["cell_type"] == "markdown":
            source = source.replace("](../", "](../../")
        cell["source"] = source
        for output in cell.get("outputs", ()):
            html = output.get("data", {}).get("text/html")
            if html is not None:
                output["data"]["text/html"] = _linked("".join(html))
    notebook["cells"] = cells
    notebook["metadata"][_MADE] = {"source": digest, "copy": _digest(notebook)}
    return json.dumps(notebook, indent=1, ensure_ascii=False)


def _switch(expected_time: str) -> dict[str, Any]:
    """Return the cell that chooses the logs of a copy."""
    lines = [
        "# Run this cell for a switch: the reference logs, your newest runs, or run now.",
        "from sfglab.lab.log_switch import log_switch",
        "",
        f'log_switch(globals(), "{expected_time}")',
    ]
    return {
        "cell_type": "code",
        "execution_count": None,
        "id": "log-switch",
        "metadata": {},
        "outputs": [],
        "source": "\n".join(lines),
    }


def _linked(html: str) -> str:
    """Return a page whose links to notebooks lead to copies, and others to files of the checkout."""
    return html.replace('href="../notebooks/', 'href="').replace('href="../', 'href="../../')

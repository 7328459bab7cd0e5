"""Outputs of executed notebooks, made fit for version control."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from sfglab.lab.progress import is_line

if TYPE_CHECKING:
    from nbformat import NotebookNode

    from sfglab.lab.paths import Project

KERNEL = {"display_name": "Python 3 (ipykernel)", "language": "python", "name": "python3"}
"""The kernel that notebooks name, so that none asks for one when it is opened."""
#: Start of a link from an executed copy, which may be several folders below the top folder.
_FROM_COPY = re.compile(r'href="(?:\.\./)+')


def normalise(notebook: NotebookNode, project: Project) -> NotebookNode:
    """Return an executed notebook, changed in place, without traces of its run.

    Times, progress, counts of other runs, the cell of injected parameters and the path of the checkout are
    removed. Links are changed so that they start at the folder of notebooks instead of the executed copy.
    """
    notebook.metadata = {"kernelspec": dict(KERNEL), "language_info": {"name": "python"}}
    cells = []
    count = 0
    for cell in notebook.cells:
        if "injected-parameters" in cell.metadata.get("tags", ()):
            continue
        cells.append(cell)
        cell.metadata = {key: kept for key, kept in cell.metadata.items() if key == "tags"}
        if cell.cell_type == "code":
            count += 1
            cell.execution_count = count
            for output in cell.outputs:
                _normalise_output(output, project, count)
            cell.outputs = _joined([output for output in cell.outputs if output.get("text") != ""])
    notebook.cells = cells
    return notebook


def _joined(outputs: list[NotebookNode]) -> list[NotebookNode]:
    """Return outputs with successive texts of a stream as one text, however the kernel divided them."""
    joined: list[NotebookNode] = []
    for output in outputs:
        if joined and output.get("name") and output.get("name") == joined[-1].get("name"):
            joined[-1].text += output.text
        else:
            joined.append(output)
    return joined


def _normalise_output(output: NotebookNode, project: Project, count: int) -> None:
    root = f"{project.root.resolve().as_posix()}/"
    if output.output_type == "execute_result":
        output.execution_count = count
    if output.output_type == "stream":
        lines = output.text.replace(root, "").splitlines(keepends=True)
        output.text = "".join(line for line in lines if not is_line(line))
    for kind, content in output.get("data", {}).items():
        if kind.startswith("text/"):
            output.data[kind] = _FROM_COPY.sub('href="../', content.replace(root, ""))

"""Notebooks are thin, explain themselves, declare their parameters and carry clean outputs."""

import ast
import json
import re
from pathlib import Path

import nbformat
import pytest

from sfglab.lab.notebook_outputs import KERNEL

ROOT = Path(__file__).parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))


@pytest.fixture(params=NOTEBOOKS, ids=lambda path: path.stem)
def notebook(request):
    return nbformat.read(request.param, as_version=4)


@pytest.fixture
def code(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def test_the_notebook_is_valid_and_bears_no_editors_traces(notebook):
    nbformat.validate(notebook)
    assert notebook.metadata == {"kernelspec": KERNEL, "language_info": {"name": "python"}}
    assert all(set(c.metadata) <= {"tags"} for c in notebook.cells)


def test_the_text_before_the_first_section_says_question_method_inputs_outputs_and_time(notebook):
    texts = "\n".join(cell.source for cell in notebook.cells if cell.cell_type == "markdown")
    assert "**Question" in notebook.cells[0].source
    words = ("**Method", "**Input", "**Output", "**Expected time")
    assert [word for word in words if word not in texts.partition("\n## ")[0]] == []


def test_imports_come_first_and_typed_parameters_second(code):
    imports, parameters, *rest = code
    assert all(isinstance(n, ast.Import | ast.ImportFrom) for n in ast.parse(imports.source).body)
    assert parameters.metadata["tags"] == ["parameters"]
    for node in ast.parse(parameters.source).body:
        assert isinstance(node, ast.AnnAssign)
        is_settings = re.fullmatch(r"settings(_\w+)?: dict = \{\}", ast.unparse(node))
        assert isinstance(node.value, ast.Constant) or is_settings
    assert not any("import " in c.source for c in rest)


def test_cells_are_thin_and_something_is_checked(code):
    cells = [c.source for c in code]
    assert sum(len(c.splitlines()) for c in cells) <= 80
    assert max(len(c.splitlines()) for c in cells) <= 10
    sources = "\n".join(cells)
    assert not re.search(r"^\s*(async def|def|class) ", sources, re.MULTILINE)
    assert re.search(r"assert |notebook\.(check|require)\(", sources)


def test_it_is_executed_and_its_outputs_are_clean(code):
    assert [c.execution_count for c in code] == list(range(1, len(code) + 1))
    for output in (output for cell in code for output in cell.outputs):
        assert output.output_type != "error"
        # Neither a path of a machine, nor a time of day, a progress bar, or a line of the kernel's log.
        unclean = r"/(home|root|work|tmp)/|\b\d\d:\d\d:\d\d\b|%\||\[IPKernelApp\]"
        assert not re.search(unclean, json.dumps(output))

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

pytestmark = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda p: p.stem)


def code_cells(path: Path) -> list:
    return [c for c in nbformat.read(path, as_version=4).cells if c.cell_type == "code"]


def test_the_notebook_is_valid_and_bears_no_editors_traces(path):
    notebook = nbformat.read(path, as_version=4)
    nbformat.validate(notebook)
    assert notebook.metadata == {"kernelspec": KERNEL, "language_info": {"name": "python"}}
    assert all(set(c.metadata) <= {"tags"} for c in notebook.cells)


def test_the_text_before_the_first_section_says_question_method_inputs_outputs_and_time(path):
    cells = nbformat.read(path, as_version=4).cells
    assert cells[0].cell_type == "markdown"
    assert "**Question" in cells[0].source
    texts = "\n".join(cell.source for cell in cells if cell.cell_type == "markdown")
    introduction = texts.partition("\n## ")[0]
    for word in ("Question", "Method", "Input", "Output", "Expected time"):
        assert f"**{word}" in introduction, word


def test_imports_come_first_and_typed_parameters_second(path):
    imports, parameters, *rest = code_cells(path)
    assert all(isinstance(n, ast.Import | ast.ImportFrom) for n in ast.parse(imports.source).body)
    assert parameters.metadata["tags"] == ["parameters"]
    for node in ast.parse(parameters.source).body:
        assert isinstance(node, ast.AnnAssign)
        is_settings = re.fullmatch(r"settings(_\w+)?: dict = \{\}", ast.unparse(node))
        assert isinstance(node.value, ast.Constant) or is_settings
    assert not any("import " in c.source for c in rest)


def test_cells_are_thin(path):
    cells = [c.source for c in code_cells(path)]
    assert sum(len(c.splitlines()) for c in cells) <= 80
    assert max(len(c.splitlines()) for c in cells) <= 10
    assert not any(re.search(r"^\s*(async def|def|class) ", c, re.MULTILINE) for c in cells)


def test_something_is_checked(path):
    sources = "\n".join(c.source for c in code_cells(path))
    assert re.search(r"assert |notebook\.(check|require)\(", sources)


def test_it_is_executed_and_its_outputs_are_clean(path):
    cells = code_cells(path)
    assert [c.execution_count for c in cells] == list(range(1, len(cells) + 1))
    for cell in cells:
        for output in cell.outputs:
            assert output.output_type != "error"
            text = json.dumps(output)
            assert not re.search(r"/(home|root|work|tmp)/", text)
            assert not re.search(r"\b\d\d:\d\d:\d\d\b", text)
            assert "%|" not in text, "no progress bars"
    assert path.stat().st_size < 1_500_000

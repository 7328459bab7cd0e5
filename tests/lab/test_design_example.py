"""The experiment that DESIGN.md shows: short, and it runs, logs, draws, claims and is tested."""

import asyncio
import re
import sys
from pathlib import Path
from types import ModuleType

import pytest

DESIGN = Path(__file__).parents[2] / "DESIGN.md"


@pytest.fixture
def example(monkeypatch, tmp_path):
    """Return the page's experiment as a module, with its test."""
    code, test = re.findall(r"```python\n(.*?)```", DESIGN.read_text(encoding="utf-8"), re.DOTALL)[:2]
    module = ModuleType("design_example")
    monkeypatch.setitem(sys.modules, module.__name__, module)
    (tmp_path / "example.py").write_text(code + test)
    module.__file__ = str(tmp_path / "example.py")
    module.asyncio = asyncio
    exec(compile(code + test, module.__file__, "exec"), vars(module))  # noqa: S102  # it is ours
    return module, code


def test_the_example_is_short_and_passes_its_own_test(example, tmp_path):
    module, code = example
    assert len([line for line in code.splitlines() if line.strip()]) <= 60
    module.test_every_size_is_measured(tmp_path)
    run = module.exp.load(tmp_path / "a.mcap")
    assert run.config.repeats == 5
    figure, numbers = module.exp.figures(run)["cdr"]
    assert figure.axes
    assert list(numbers) == [64, 256, 1024]

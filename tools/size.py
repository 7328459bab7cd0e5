"""Print the size of the code in a measure that no layout changes: nodes of the syntax tree.

    make size

A row for each package of sfglab and each other folder with Python: modules, lines, nodes and nodes
per statement; then the lines in sfglab that are not Python, and the totals. Docstrings count
neither as nodes nor as statements, those below a field included.
"""

from __future__ import annotations

import ast
import subprocess
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
DIVIDED = ("sfglab/lab", "sfglab/bus", "sfglab/fleet")
"""Packages whose own packages have rows of their own."""


def main() -> None:
    """Print the table of this checkout."""
    rows: dict[str, Counter[str]] = {}
    other_lines = 0
    for name in tracked_files():
        file = ROOT / name
        if file.suffix == ".py":
            size = size_of(file.read_text("utf-8"))
            for row in rows_of(name):
                rows.setdefault(row, Counter()).update(size)
        elif name.startswith("sfglab/"):
            other_lines += file.read_bytes().count(b"\n")
    print(f"{'package':26}{'modules':>8}{'lines':>9}{'nodes':>10}{'nodes/statement':>17}")
    for row in sorted(rows, key=place_of):
        size = rows[row]
        density = size["nodes"] / max(1, size["statements"])
        print(
            f"{row:26}{size['modules']:8}{size['lines']:9}{size['nodes']:10}{density:17.1f}",
        )
    print(f"{'sfglab, not Python':26}{'':8}{other_lines:9}")


def tracked_files() -> list[str]:
    """Return the files under version control that are there."""
    argv = ["git", "ls-files"]
    done = subprocess.run(argv, cwd=ROOT, capture_output=True, text=True, check=True)
    return [name for name in done.stdout.splitlines() if (ROOT / name).is_file()]


def size_of(source: str) -> Counter[str]:
    """Return modules, lines, nodes and statements of a module's source."""
    size = Counter(modules=1, lines=source.count("\n"))
    waiting: list[ast.AST] = [ast.parse(source)]
    while waiting:
        node = waiting.pop()
        if is_docstring(node):
            continue
        size["nodes"] += 1
        size["statements"] += isinstance(node, ast.stmt)
        waiting.extend(ast.iter_child_nodes(node))
    return size


def is_docstring(node: ast.AST) -> bool:
    """Return whether a node is a statement that is nothing but a string."""
    if not isinstance(node, ast.Expr) or not isinstance(node.value, ast.Constant):
        return False
    return isinstance(node.value.value, str)


def rows_of(name: str) -> list[str]:
    """Return the rows in which a file counts."""
    folder = Path(name).parent.as_posix()
    parts = Path(name).parts
    if parts[0] != "sfglab":
        return [parts[0], "all Python"]
    row = "/".join(parts[:2]) if len(parts) > 2 else "sfglab/*.py"
    if row in DIVIDED and folder != row:
        row = "/".join(parts[:3])
    return [row, "sfglab (all)", "all Python"]


def place_of(row: str) -> tuple[bool, bool, bool, str]:
    """Return the place of a row: packages, other folders, totals."""
    return row == "all Python", row == "sfglab (all)", not row.startswith("sfglab"), row


if __name__ == "__main__":
    main()

"""Change a package in one place at a time, and count how many changes its tests see.

    python tools/mutants.py arp --seed 0
    python tools/mutants.py names --count 10 --tree build/old

Mutants are drawn by a seed, kind by kind: comparisons, integers off by one, dropped calls, swapped
arguments and fields, dropped and exchanged rows of tables, `and` for `or`. Texts, types and `raise`
are not changed. Each is judged in a copy of the tree by the tests of the package that need no live
processes, namespaces, ROS 2 or browser. A mutant is seen if a test fails, or if the tests take three
times as much CPU time as without it, or ten times as long. coverage.py counts the branches that the
tests cover, and names the files of tests that run the changed line. These judge first. The others
judge if the line also runs outside of test functions, or if no test function runs it. A function
whose results are cached runs in one test only, so a mutant of it may be counted as not seen.
"""

from __future__ import annotations

import argparse
import ast
import difflib
import json
import os
import random
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

ROOT = Path(__file__).resolve().parent.parent
MARKS = "not live and not netns and not ros and not browser"
COUNT = 40
CPU_TIMES = 3  #: Times as much CPU time as without a mutant that the tests may take.
TIMES = 10  #: Times as long that they may take; long, so that a busy machine ends none.
_LATE = "exchanged rows"  # drawn where the other kinds are too few: a table has one place per row
#: Folders that tests read; only trees of older versions have `robot`.
_READ = {"data", "notebooks", "figures", "book", "benchmarks", "install", "robot"}
_UNSEEN = (ast.Raise, ast.JoinedStr, ast.arguments)
_UNNAMED = {"__repr__", "_repr_html_"}
_PAIRS = (
    (ast.Lt, ast.LtE),
    (ast.Gt, ast.GtE),
    (ast.Eq, ast.NotEq),
    (ast.In, ast.NotIn),
    (ast.Is, ast.IsNot),
)
_OPPOSITE = {one: other for pair in _PAIRS for one, other in (pair, pair[::-1])}


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """One change of one module."""

    module: Path  #: The module, from the top folder.
    line: int  #: Line of the change in the unchanged module.
    kind: str  #: Kind of the change.
    diff: str  #: The changed lines, before and after.
    source: str  #: The whole module.


@dataclass(frozen=True, slots=True, kw_only=True)
class Limit:
    """How long the tests may take with a mutant."""

    cpu_s: int  #: CPU time of each process, s.
    real_s: float  #: Time, s.


def main(arguments: Sequence[str] | None = None) -> int:
    """Judge the mutants of a package and print the counts as JSON; return the exit status."""
    given = _parser().parse_args(arguments)
    tree = given.tree.resolve()
    tests = given.tests or [f"tests/{given.package}"]
    with tempfile.TemporaryDirectory(prefix="sfglab-mutants-") as folder:
        copies = [copy_of(tree, Path(folder, str(number))) for number in range(given.processes)]
        started, cpu_s = time.monotonic(), _cpu_of_children_s()
        if run_tests(copies[0], tests, None) != 0:
            print("mutants: the tests fail without a mutant", file=sys.stderr)
            return 2
        limit = Limit(
            cpu_s=round(CPU_TIMES * (_cpu_of_children_s() - cpu_s) + 10),
            real_s=TIMES * (time.monotonic() - started) + 60,
        )
        covered, runs = coverage_of(copies[0], tests, given.package)
        mutants = draw(tree, given.package, given.count, given.seed)
        judges = [judges_of(copies[0], tests, runs, mutant) for mutant in mutants]
        with ThreadPoolExecutor(given.processes) as pool:
            seen = list(pool.map(partial(is_seen, copies, limit), judges, mutants))
    survived = [m for m, was_seen in zip(mutants, seen, strict=True) if not was_seen]
    result = {
        "package": given.package,
        "seed": given.seed,
        "mutants": len(mutants),
        "seen": sum(seen),
        "branches covered, %": covered,
        "survived": [{"module": str(m.module), "kind": m.kind, "diff": m.diff} for m in survived],
    }
    print(json.dumps(result, indent=1))
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("package", help="package of sfglab, such as arp or lab/sweep")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--count", type=int, default=COUNT, help=f"mutants [default: {COUNT}]")
    parser.add_argument("--tree", type=Path, default=ROOT, help="tree of another version")
    parser.add_argument("--tests", nargs="+", help="tests that judge [default: tests/PACKAGE]")
    parser.add_argument("--processes", type=int, default=os.cpu_count() or 1)
    return parser


def copy_of(tree: Path, folder: Path) -> Path:
    """Copy what tests need; folders that they only read are linked."""
    folder.mkdir(parents=True)
    hidden = shutil.ignore_patterns("__pycache__")
    for name in ("sfglab", "tests"):
        shutil.copytree(tree / name, folder / name, ignore=hidden)
    for file in tree.iterdir():
        linked = file.is_dir() and file.name in _READ
        if linked or (file.is_file() and not file.name.startswith(".")):
            (folder / file.name).symlink_to(file)
    return folder


def _cpu_of_children_s() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run_tests(copy: Path, tests: Sequence[str], limit: Limit | None) -> int:
    """Run the tests in a copy until one fails; return the exit status, 1 if they take too long."""
    argv = [sys.executable, "-m", "pytest", "-q", "-x", "-p", "no:cacheprovider", "-m", MARKS]
    try:
        done = _run([*argv, *tests], copy, limit)
    except subprocess.TimeoutExpired:
        return 1
    return done.returncode


def _run(
    argv: Sequence[str], copy: Path, limit: Limit | None
) -> subprocess.CompletedProcess[bytes]:
    environment = os.environ | {"PYTHONPATH": str(copy), "PYTHONDONTWRITEBYTECODE": "1"}
    limited: list[str] = []
    if limit is not None:
        limited = ["sh", "-c", f'ulimit -t {limit.cpu_s}; exec "$@"', "sh"]
    return subprocess.run(
        [*limited, *argv],
        cwd=copy,
        env=environment,
        capture_output=True,
        timeout=limit.real_s if limit else None,
        check=False,
    )


def coverage_of(
    copy: Path, tests: Sequence[str], package: str
) -> tuple[float | None, dict[str, dict[str, list[str]]]]:
    """Return the share of branches that the tests cover, %, and the callers of each line of each module.

    A caller is the name of a test function with its module, or empty for code outside of test functions.
    Without coverage.py the share is None and no caller is known.
    """
    if find_spec("coverage") is None:
        return None, {}
    settings = copy / "contexts.ini"
    settings.write_text("[run]\ndynamic_context = test_function\n", "utf-8")
    source = f"--source={copy / 'sfglab' / package}"
    argv = [sys.executable, "-m", "coverage", "run", "--branch", f"--rcfile={settings}", source]
    argv += ["-m", "pytest", "-q", "-p", "no:cacheprovider", "-m", MARKS, *tests]
    _run(argv, copy, None)
    argv = [sys.executable, "-m", "coverage", "json", "--show-contexts", "-o", "coverage.json"]
    _run(argv, copy, None)
    found = json.loads((copy / "coverage.json").read_text("utf-8"))
    totals = found["totals"]
    covered = round(100 * totals["covered_branches"] / max(1, totals["num_branches"]), 1)
    return covered, {name: file["contexts"] for name, file in found["files"].items()}


def judges_of(
    copy: Path, tests: Sequence[str], runs: dict[str, dict[str, list[str]]], mutant: Mutant
) -> list[str]:
    """Return the files of tests that can see a mutant, those that run its line first."""
    files: list[Path] = []
    for name in tests:
        path = copy / name
        files += sorted(path.rglob("test_*.py")) if path.is_dir() else [path]
    contexts = runs.get(str(mutant.module), {}).get(str(mutant.line), [""])
    names = {part for context in contexts for part in context.split(".")}
    near = [str(file.relative_to(copy)) for file in files if file.stem in names]
    if near and "" not in contexts:
        return near
    return [*near, *(str(f.relative_to(copy)) for f in files if f.stem not in names)]


def is_seen(copies: list[Path], limit: Limit, tests: Sequence[str], mutant: Mutant) -> bool:
    """Return whether the tests fail with a mutant in one of the free copies."""
    copy = copies.pop()
    file = copy / mutant.module
    before = file.read_text("utf-8")
    try:
        file.write_text(mutant.source, "utf-8")
        return run_tests(copy, tests, limit) != 0
    finally:
        file.write_text(before, "utf-8")
        copies.append(copy)


def draw(tree: Path, package: str, count: int, seed: int) -> list[Mutant]:
    """Return mutants of a package: kinds take turns, places are drawn; fewer if there are no more."""
    rng = random.Random(f"{seed} {package}")
    places: dict[str, list[tuple[Path, int, int]]] = defaultdict(list)
    for file in sorted((tree / "sfglab" / package).rglob("*.py")):
        for place, node in enumerate(changeable(ast.parse(file.read_text("utf-8")))):
            for number, (kind, _) in enumerate(changes(node)):
                places[kind].append((file.relative_to(tree), place, number))
    late = {_LATE: places.pop(_LATE, [])}
    found: list[Mutant] = []
    for left in (dict(places), late):
        while any(left.values()) and len(found) < count:
            for kind in sorted(kind for kind in left if left[kind]):
                chosen = left[kind].pop(rng.randrange(len(left[kind])))
                mutant = _mutant(tree, *chosen)
                if mutant is not None and len(found) < count:
                    found.append(mutant)
    return found


def changeable(node: ast.AST) -> Iterator[ast.AST]:
    """Yield the nodes that may be changed, in the order of the source."""
    for name, value in ast.iter_fields(node):
        if name in {"annotation", "returns", "decorator_list", "bases"}:
            continue
        for child in value if isinstance(value, list) else [value]:
            if not isinstance(child, ast.AST) or isinstance(child, _UNSEEN):
                continue
            if getattr(child, "name", "") in _UNNAMED or _is_for_types(child):
                continue
            yield child
            yield from changeable(child)


def _is_for_types(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.dump(node.test)


def changes(node: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the kinds of change that a node allows, each with its fields after the change."""
    yield from _changed_rows(node)
    match node:
        case ast.Compare(ops=[op]) if type(op) in _OPPOSITE:
            yield "comparison", {"ops": [_OPPOSITE[type(op)]()]}
        case ast.Constant(value=int()) if not isinstance(node.value, bool):
            yield "off by one", {"value": node.value + 1}
        case ast.Expr(value=ast.Call()):
            yield "dropped call", {"value": ast.Constant(None)}
        case ast.Call(args=[first, second, *others]):
            yield "swapped arguments", {"args": [second, first, *others]}
        case ast.Call(keywords=[first, second, *others]):
            swapped = [ast.keyword(first.arg, second.value), ast.keyword(second.arg, first.value)]
            yield "swapped fields", {"keywords": [*swapped, *others]}
        case ast.BoolOp():
            opposite = ast.Or() if isinstance(node.op, ast.And) else ast.And()
            yield "and for or", {"op": opposite}


def _changed_rows(node: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the changes of a table, list or set."""
    match node:
        case ast.Dict(keys=[_, _, *_]):
            yield "dropped row", {"keys": node.keys[:-1], "values": node.values[:-1]}
            for place in range(len(node.keys) - 1):
                values = list(node.values)
                values[place], values[place + 1] = values[place + 1], values[place]
                yield _LATE, {"values": values}
        case ast.Set(elts=[_, _, *_]) | ast.List(elts=[_, _, *_]):
            yield "dropped row", {"elts": node.elts[:-1]}
        case ast.Tuple(elts=[_, _, _, *_], ctx=ast.Load()):
            yield "dropped row", {"elts": node.elts[:-1]}


def _mutant(tree: Path, module: Path, place: int, number: int) -> Mutant | None:
    parsed = ast.parse((tree / module).read_text("utf-8"))
    before = ast.unparse(parsed)
    node = list(changeable(parsed))[place]
    kind, instead = list(changes(node))[number]
    line = node.lineno
    for field, value in instead.items():
        setattr(node, field, value)
    after = ast.unparse(parsed)
    if after == before:
        return None
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), n=0, lineterm="")
    changed = [line for line in lines if line[:3] not in {"---", "+++", "@@ "}]
    diff = "\n".join(changed)
    return Mutant(module=module, line=line, kind=kind, diff=diff, source=after)


if __name__ == "__main__":
    sys.exit(main())

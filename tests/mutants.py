"""Mutants of the code under the claims' checks: changed in one place by a seeded generator, and who sees it.

A share of checks that hold says nothing of checks that cannot fail. A claim declares which modules it checks
and how (`sfglab.lab.checks.Mutated`); every mutant is judged in a process of its own, forked from one that has
run the checks unchanged, and imports anew what imports the changed module. Caught is what fails a check,
raises, or has no end within `LONGEST_S`; survivors keep their diff. Nothing is chosen by hand: places are
drawn, kind by kind. Changes of texts, types and ``raise`` are no mutants. `python tests/mutants.py [CLAIM...]`
writes ``data/mutants.json``.
"""

from __future__ import annotations

import ast
import difflib
import importlib.util
import json
import multiprocessing
import os
import random
import sys
from collections import Counter, defaultdict
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from importlib.machinery import ModuleSpec, SourceFileLoader
from pathlib import Path
from subprocess import PIPE, Popen
from typing import TYPE_CHECKING, Any, Self

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

COUNT = 20
LONGEST_S = 30.0
STORE = Path(__file__).parents[1] / "data" / "mutants.json"
_DRAWN = {"ax", "axes", "figure"}  # arguments of what only draws
_ROWS = "exchanged rows"  # drawn where the other kinds are too few: a table has one place a row
_UNSEEN = (ast.Raise, ast.JoinedStr, ast.arguments)
_PAIRS = (
    (ast.Lt, ast.LtE),
    (ast.Gt, ast.GtE),
    (ast.Eq, ast.NotEq),
    (ast.In, ast.NotIn),
    (ast.Is, ast.IsNot),
)
_COMPARED = {one: other for pair in _PAIRS for one, other in (pair, pair[::-1])}


@dataclass(frozen=True, slots=True, kw_only=True)
class Mutant:
    """One change."""

    module: str  #: Where.
    kind: str  #: What was done.
    diff: str  #: The changed lines, before and after.
    source: str  #: The whole module.


def source_of(module: str) -> str:
    """Return a module's source, without importing it."""
    base = Path(__file__).parents[1] / module.replace(".", "/")
    return (base / "__init__.py" if base.is_dir() else base.with_suffix(".py")).read_text()


def draw_mutants(modules: Sequence[str], count: int, seed: int) -> list[Mutant]:
    """Return so many mutants, fewer if there are no more; kinds take turns, places are drawn."""
    rng, places = random.Random(f"{seed} {modules}"), defaultdict(list)  # no secret
    for part in modules:
        module, _, names = part.partition(":")
        tree = ast.parse(source_of(module))
        chosen = {
            id(node) for top in tree.body if _name(top) in names.split(",") for node in _nodes(top)
        }
        for place, node in enumerate(_nodes(tree)):
            for number, (kind, _) in enumerate(
                _changes(node) if id(node) in chosen or not names else ()
            ):
                places[kind].append((module, place, number))
    found: list[Mutant] = []
    few = {_ROWS: places.pop(_ROWS, [])}
    for left in (dict(places), few):
        while any(left.values()) and len(found) < count:
            for kind in sorted(kind for kind in left if left[kind]):
                mutant = _mutant(*left[kind].pop(rng.randrange(len(left[kind]))))
                found += [mutant] if mutant and len(found) < count else []
    return found


def _name(statement: ast.stmt) -> str:
    """Return what a module's statement names: a function, a class, or a constant."""
    target = (
        getattr(statement, "target", None) or (getattr(statement, "targets", None) or [None])[0]
    )
    return str(getattr(statement, "name", "") or getattr(target, "id", ""))


def _nodes(node: ast.AST) -> Iterator[ast.AST]:
    """Yield what may be changed, in the order of the source."""
    for name, value in ast.iter_fields(node):
        if name in {"annotation", "returns", "decorator_list", "bases"}:
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, _UNSEEN) or getattr(child, "name", "") in {
                "__repr__",
                "_repr_html_",
            }:
                continue
            if isinstance(child, ast.FunctionDef) and _DRAWN.intersection(
                arg.arg for arg in child.args.args
            ):
                continue
            if isinstance(child, ast.If) and "TYPE_CH" in ast.dump(child.test):
                continue
            if isinstance(child, ast.AST):
                yield child
                yield from _nodes(child)


def _changes(node: Any) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield the kinds of change that a node allows, each with what it would have instead."""
    for n in range(len(node.keys) - 1 if isinstance(node, ast.Dict) else 0):
        yield (
            _ROWS,
            {"values": [*node.values[:n], *node.values[n : n + 2][::-1], *node.values[n + 2 :]]},
        )
    match node:
        case ast.Compare(ops=[op]) if type(op) in _COMPARED:
            yield "comparison", {"ops": [_COMPARED[type(op)]()]}
        case ast.Constant(value=int()) if not isinstance(node.value, bool):
            yield "off by one", {"value": node.value + 1}
        case ast.Expr(value=ast.Call()):
            yield "dropped call", {"value": ast.Constant(None)}
        case ast.Call(args=[first, second, *others]):
            yield "swapped arguments", {"args": [second, first, *others]}
        case ast.Call(keywords=[first, second, *others]):
            swapped = [ast.keyword(first.arg, second.value), ast.keyword(second.arg, first.value)]
            yield "swapped fields", {"keywords": [*swapped, *others]}
        case ast.Dict(keys=[_, _, *_]):
            yield "dropped row", {"keys": node.keys[:-1], "values": node.values[:-1]}
        case (
            ast.Set(elts=[_, _, *_])
            | ast.List(elts=[_, _, *_])
            | ast.Tuple(elts=[_, _, _, *_], ctx=ast.Load())
        ):
            yield "dropped row", {"elts": node.elts[:-1]}
        case ast.BoolOp():
            yield "and for or", {"op": ast.Or() if isinstance(node.op, ast.And) else ast.And()}


def _mutant(module: str, place: int, number: int) -> Mutant | None:
    tree = ast.parse(source_of(module))
    before = ast.unparse(tree)
    node = list(_nodes(tree))[place]
    kind, instead = list(_changes(node))[number]
    for field, value in instead.items():
        setattr(node, field, value)
    after = ast.unparse(tree)
    lines = difflib.unified_diff(before.splitlines(), after.splitlines(), n=0, lineterm="")
    diff = "\n".join(line for line in lines if line[:3] not in {"---", "+++"} and line[0] in "+-")
    return Mutant(module=module, kind=kind, diff=diff, source=after) if after != before else None


class Judge:
    """A process that has imported what claims' checks need, and forks one for each mutant."""

    def __enter__(self) -> Self:
        self._process = Popen(
            [sys.executable, "-P", __file__, "serve"], stdin=PIPE, stdout=PIPE, text=True
        )
        return self

    def __exit__(self, *_: object) -> None:
        self._process.communicate()

    def seen(self, experiment: str, claim: str, mutant: Mutant | None = None) -> str:
        """Return by what the checks see a mutant, or without one what they say; empty: by nothing."""
        assert self._process.stdin
        assert self._process.stdout
        module, source = (mutant.module, mutant.source) if mutant else ("", "")
        order = {"experiment": experiment, "claim": claim, "module": module, "source": source}
        print(json.dumps(order), file=self._process.stdin, flush=True)
        return str(json.loads(self._process.stdout.readline()))


def mutation_score(
    judge: Judge, experiment: str, claim: str, count: int, seed: int = 0
) -> dict[str, Any]:
    """Return how many mutants of a claim its checks catch, as JSON values, with the diffs of survivors.

    Raises:
        RuntimeError: The checks fail without any change.
    """
    from sfglab.lab.experiments import experiment as load

    if seen := judge.seen(experiment, claim):
        raise RuntimeError(f"{claim}: the checks fail without a mutant: {seen}")
    mutants = draw_mutants(load(experiment).mutated[claim].modules, count, seed)
    judged = [(mutant, judge.seen(experiment, claim, mutant)) for mutant in mutants]
    return {
        "seed": seed,
        "tried": len(judged),
        "caught": sum(bool(seen) for _, seen in judged),
        "by": dict(Counter(seen.split(":")[0] for _, seen in judged if seen)),
        "survived": [
            {"module": m.module, "kind": m.kind, "diff": m.diff} for m, seen in judged if not seen
        ],
    }


class _Source(SourceFileLoader):
    """Loads one module from a text, and all others as ever."""

    def __init__(self, name: str, text: str) -> None:
        spec = importlib.util.find_spec(name)
        assert spec
        assert spec.origin
        super().__init__(name, spec.origin)
        self._text = text

    def find_spec(self, name: str, _path: Any = None, _target: Any = None) -> ModuleSpec | None:
        """Return the module's place, if it is this one."""
        if name != self.name:
            return None
        return importlib.util.spec_from_file_location(name, self.path, loader=self)

    def get_code(self, _fullname: str) -> Any:
        """Return the text, compiled."""
        return compile(self._text, self.path, "exec")


def _forget(changed: str) -> None:
    """Forget a module and all that import it, directly or not; the others, and what they compiled, stay."""
    loaded = {name for name in sys.modules if name.startswith("sfglab.")}
    imports = {name: _imported(name) | {name} for name in loaded}
    gone = {changed}
    while more := {name for name in loaded - gone if imports[name] & gone}:
        gone |= more
    for name in gone & loaded:
        parent, _, child = name.rpartition(".")
        if parent in sys.modules:
            vars(sys.modules[parent]).pop(child, None)  # whom `from parent import child` would ask
        del sys.modules[name]


@cache
def _imported(module: str) -> set[str]:
    """Return what a module imports, wherever in it: modules, and names that may be modules."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(source_of(module))):
        if isinstance(node, ast.ImportFrom) and node.module:
            found |= {node.module, *(f"{node.module}.{name.name}" for name in node.names)}
        elif isinstance(node, ast.Import):
            found |= {name.name for name in node.names}
    return found


def _seen(order: dict[str, str]) -> str:
    """Return by what the checks see a mutant, or without one what they say; empty: by nothing."""
    if order["module"]:
        loader = _Source(order["module"], order["source"])
        _forget(order["module"])
        sys.meta_path.insert(0, loader)  # has what is asked of a finder
    try:
        from sfglab.lab.experiments import experiment

        rows = experiment(order["experiment"]).mutated[order["claim"]].rows()
        wrong = next((row for row in rows if row.held < row.checked), None)  # one is enough
    except BaseException as error:  # noqa: BLE001  # whatever it is, it is seen
        return f"raises {type(error).__name__}: {error}"
    return f"{wrong.check}: {wrong.held} of {wrong.checked}" if wrong else ""


def _serve() -> None:
    forks = multiprocessing.get_context("fork")
    answers, quiet = os.fdopen(os.dup(1), "w"), os.open(os.devnull, os.O_WRONLY)
    os.dup2(quiet, 1)
    os.dup2(quiet, 2)
    for order in map(json.loads, sys.stdin):
        if not order[
            "module"
        ]:  # here, so that what is imported late, and what is compiled, is there
            print(json.dumps(_seen(order)), file=answers, flush=True)
            continue
        here, there = forks.Pipe(duplex=False)
        child = forks.Process(target=lambda order, end: end.send(_seen(order)), args=(order, there))
        child.start()
        there.close()
        said = "died: no answer"
        with suppress(EOFError):
            said = here.recv() if here.poll(LONGEST_S) else "no end: killed"
        print(json.dumps(said), file=answers, flush=True)
        child.kill()
        child.join()


def main(claims: Sequence[str]) -> None:
    """Judge mutants of each claim that declares them, or of the named ones; write ``data/mutants.json``."""
    from sfglab.lab.experiments import EXPERIMENTS
    from sfglab.lab.experiments import experiment as load

    scores = json.loads(STORE.read_text()) if STORE.is_file() else {}
    declared = [(name, claim) for name in EXPERIMENTS for claim in load(name).mutated]
    with Judge() as judge:
        for name, claim in declared:
            if not claims or claim in claims:
                why = {
                    one["diff"]: one.get("why", "")
                    for one in scores.get(claim, {}).get("survived", ())
                }
                scores[claim] = mutation_score(judge, name, claim, COUNT)
                for one in scores[claim]["survived"]:
                    one["why"] = why.get(one["diff"], "")  # a new one's is written by hand
                print(claim, scores[claim]["caught"], "of", scores[claim]["tried"], flush=True)  # noqa: T201  # a command
                STORE.write_text(json.dumps(scores, indent=1) + "\n")


if __name__ == "__main__":
    _serve() if sys.argv[1:2] == ["serve"] else main(sys.argv[1:])

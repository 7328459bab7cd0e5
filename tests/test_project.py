"""The repository itself: one set of dependencies, floors without cycles, a cheap import, nothing foreign."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())

FLOORS = (
    ("names", "qos", "errors", "pipes", "component", "fields", "units", "processes", "documents", "tables"),
    ("messages", "rtps", "codecs"),
    ("bus", "record"),
    ("fleet", "arp", "soc", "spatial"),
    ("view", "deploy"),
    ("lab",),
    ("cli", "__main__"),
)
SIBLINGS_APART = ("fleet", "arp", "soc", "spatial")


def normal(requirement: str) -> str:
    return re.sub(r"\s", "", requirement)


def test_environment_yml_and_pyproject_name_the_same_set():
    conda = yaml.safe_load((ROOT / "environment.yml").read_text())["dependencies"]
    pip = next(d for d in conda if isinstance(d, dict))["pip"]
    listed = {normal(d) for d in [*conda, *pip] if isinstance(d, str)} - {"pip", "python>=3.11"}
    project = PYPROJECT["project"]
    wanted = {normal(d) for d in project["dependencies"]}
    for extra in project["optional-dependencies"].values():
        wanted |= {normal(d) for d in extra}
    assert listed == wanted


def test_the_lock_holds_every_dependency_with_hashes_and_no_address():
    lock = (ROOT / "requirements.lock").read_text()
    locked = set(re.findall(r"^([a-z0-9][a-z0-9._-]*)==", lock, re.MULTILINE))
    project = PYPROJECT["project"]
    wanted = [*project["dependencies"], *(d for e in project["optional-dependencies"].values() for d in e)]
    assert {re.split(r"[<>=]", normal(d))[0] for d in wanted} <= locked
    assert "://" not in lock
    blocks = re.split(r"^(?=[a-z0-9])", lock, flags=re.MULTILINE)
    assert all("--hash=sha256:" in block for block in blocks if "==" in block)


def sources() -> list[Path]:
    return sorted((ROOT / "sfglab").rglob("*.py"))


def floor_of(part: str) -> int:
    return next(i for i, floor in enumerate(FLOORS) if part in floor)


def part_of(path: Path) -> str:
    inner = path.relative_to(ROOT / "sfglab").parts
    return inner[0].removesuffix(".py")


def imported_parts(path: Path) -> set[str]:
    """Parts of sfglab that a file imports anywhere, also in functions and for types only."""
    parts = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module:
            names = [node.module] if node.module != "sfglab" else [f"sfglab.{a.name}" for a in node.names]
        elif isinstance(node, ast.Import):
            names = [a.name for a in node.names]
        else:
            continue
        parts |= {n.split(".")[1] for n in names if n.startswith("sfglab.")}
    return parts - {"__version__"}


@pytest.mark.parametrize("path", sources(), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_imports_run_downwards_only(path):
    part = part_of(path)
    if part == "__init__":
        assert not imported_parts(path), "the root imports nothing"
        return
    for other in imported_parts(path) - {part}:
        assert floor_of(other) <= floor_of(part), f"{part} imports {other}, which stands above it"
        assert not (part in SIBLINGS_APART and other in SIBLINGS_APART), f"{part} imports its sibling {other}"


def module_graph() -> dict[str, set[str]]:
    graph = {}
    for path in sources():
        name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        tree = ast.parse(path.read_text())
        found = set()
        for node in tree.body:
            if isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
                found |= {node.module, *(f"{node.module}.{a.name}" for a in node.names)}
            elif isinstance(node, ast.Import):
                found |= {a.name for a in node.names}
        graph[name] = found
    return {m: {d for d in deps if d in graph and d != m} for m, deps in graph.items()}


def test_there_are_no_import_cycles():
    import networkx as nx

    graph = nx.DiGraph([(m, d) for m, deps in module_graph().items() for d in deps])
    assert list(nx.simple_cycles(graph)) == []


def test_importing_the_root_is_cheap_and_loads_nothing_heavy():
    code = (
        "import sys, time; t = time.perf_counter(); import sfglab; dt = time.perf_counter() - t; "
        "heavy = {'numpy', 'av', 'cyclonedds', 'matplotlib', 'pandas', 'mcap', 'cv2', 'asyncio'}; "
        "heavy &= set(sys.modules); "
        "assert not heavy, heavy; assert dt < 0.2, dt"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


@pytest.mark.parametrize("path", sources(), ids=lambda p: p.relative_to(ROOT).as_posix())
def test_all_names_what_a_module_exports(path):
    tree = ast.parse(path.read_text())
    listed = [
        [ast.literal_eval(e) for e in node.value.elts]
        for node in tree.body
        if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "__all__"
    ]
    if not listed:
        return
    defined = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            defined.add(node.name)
        elif isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            defined |= {n.id for t in targets for n in ast.walk(t) if isinstance(n, ast.Name)}
        elif isinstance(node, ast.ImportFrom | ast.Import):
            defined |= {(a.asname or a.name).split(".")[0] for a in node.names}
    assert set(listed[0]) <= defined
    assert len(set(listed[0])) == len(listed[0])


def tracked_files() -> list[Path]:
    done = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.skip("needs a git checkout")
    return [ROOT / line for line in done.stdout.splitlines() if (ROOT / line).is_file()]


def test_no_file_is_big_and_none_holds_a_path_of_a_machine():
    total_logs = 0
    for path in tracked_files():
        size = path.stat().st_size
        if path.suffix == ".mcap":
            total_logs += size
            continue
        assert size < 2_000_000, path
        text = path.read_bytes()
        assert not re.search(rb"/(?:home|root|work)/[a-z]", text), path
    assert total_logs < 6_000_000


def test_classes_of_rows_have_names_of_their_own():
    """A row's class becomes a type in logs, and types of one process must not share a name."""
    places: dict[str, list[str]] = {}
    for path in sorted((ROOT / "sfglab").rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.ClassDef) and node.name.endswith("Row"):
                places.setdefault(node.name, []).append(path.name)
    shared = {name: where for name, where in places.items() if len(where) > 1}
    assert shared == {}

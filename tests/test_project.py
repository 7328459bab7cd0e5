"""The repository itself: one set of dependencies, floors without cycles, a cheap import, nothing foreign."""

import ast
import re
import subprocess
import sys
import tomllib
from collections import Counter
from functools import cache
from importlib import import_module
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).parents[1]
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())

COMMON = """names lazy domains qos errors machine component fields units files
processes documents schema tables compiling validation"""
FLOORS = (
    COMMON.split(),
    ("messages", "rtps", "codecs"),
    ("bus", "record"),
    ("fleet", "arp", "soc", "spatial"),
    ("view", "deploy"),
    ("lab",),
    ("cli", "__main__"),
)
SIBLINGS_APART = {"fleet", "arp", "soc", "spatial"}


def normal(requirement: str) -> str:
    return re.sub(r"\s", "", requirement)


def test_environment_yml_lists_the_dependencies_and_the_extras_of_the_notebooks():
    *conda, pip = yaml.safe_load((ROOT / "environment.yml").read_text())["dependencies"]
    listed = {normal(each) for each in [*conda, *pip["pip"]]} - {"pip", "python>=3.11"}
    project = PYPROJECT["project"]
    wanted = [*project["dependencies"]]
    for extra in ("view", "rtl", "deploy", "zenoh"):
        wanted += project["optional-dependencies"][extra]
    assert listed == {*map(normal, wanted)}


def locked(name: str) -> dict[str, str]:
    """Return the library of each of a lock file's blocks, which have hashes and no address."""
    lock = (ROOT / name).read_text()
    assert "://" not in lock
    blocks = [
        block for block in re.split(r"^(?=[a-z0-9])", lock, flags=re.MULTILINE) if "==" in block
    ]
    assert all("--hash=sha256:" in block for block in blocks)
    return {block: block.split("==")[0] for block in blocks}


def test_the_locks_hold_every_dependency_with_hashes_and_no_address_and_agree():
    project = PYPROJECT["project"]
    extras = {"": project["dependencies"], **project["optional-dependencies"]}
    locks = {name: locked(f"install/{name}.lock") for name in ("requirements", "tests", "book")}
    of_extra = {"dev": "tests", "book": "book"}
    for extra, listed in extras.items():
        names = {re.split(r"[\[<>=]", normal(one))[0] for one in listed}
        assert names <= set(locks[of_extra.get(extra, "requirements")].values()), extra
    assert "pyside6-webengine" not in locks["requirements"].values()
    # Some packages are also needed on other platforms: versions and hashes agree, markers differ.
    pins = [
        {re.sub(" ; .*", " \\\\", block): name for block, name in lock.items()}
        for lock in locks.values()
    ]
    for other in pins[1:]:
        assert {block for block, name in other.items() if name in pins[0].values()} <= set(pins[0])


@cache
def trees() -> dict[Path, ast.Module]:
    """Return the syntax of every file of the package."""
    return {
        path: ast.parse(path.read_text("utf-8")) for path in sorted((ROOT / "sfglab").rglob("*.py"))
    }


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


@cache
def imports() -> dict[str, set[str]]:
    """Return which modules of sfglab each imports anywhere, also in functions and for types only."""
    modules = {name_of(path) for path in trees()}
    found = {}
    for path, tree in trees().items():
        nodes = list(ast.walk(tree))
        froms = [n for n in nodes if isinstance(n, ast.ImportFrom) and n.module and n.level == 0]
        names = {f"{n.module}.{a.name}" for n in froms for a in n.names} & modules
        names |= {n.module for n in froms}  # a submodule's import runs its package's first
        names |= {a.name for n in nodes if isinstance(n, ast.Import) for a in n.names}
        found[name_of(path)] = {n for n in names if n.startswith("sfglab")} - {name_of(path)}
    return found


def part_of(module: str) -> str:
    return module.partition(".")[2].partition(".")[0]


def test_imports_run_downwards_only():
    floor_of = {part: i for i, floor in enumerate(FLOORS) for part in floor}
    for module, found in imports().items():
        part = part_of(module)
        for other in {part_of(name) for name in found} - {"", part}:
            assert floor_of.get(part, -1) >= floor_of[other], f"{module} imports {other}"
            assert not {part, other} <= SIBLINGS_APART, f"{module} imports {other}"


def test_there_are_no_import_circles():
    """Types count too: what knows another's type knows the other."""
    import networkx as nx

    graph = nx.DiGraph([(m, d) for m, found in imports().items() for d in found])
    assert [sorted(c) for c in nx.strongly_connected_components(graph) if len(c) > 1] == []


def test_only_facades_list_what_they_export_and_each_name_exists_once():
    for path, tree in trees().items():
        if "__all__" in {getattr(node, "id", "") for node in ast.walk(tree)}:
            assert path.name == "__init__.py", path
            module = import_module(name_of(path))
            assert len(set(module.__all__)) == len(module.__all__), module
            assert [name for name in module.__all__ if not hasattr(module, name)] == [], module


@pytest.mark.parametrize(
    ("package", "heavy"),
    [
        ("sfglab", "numpy av cyclonedds matplotlib pandas mcap cv2 asyncio"),
        ("sfglab.fleet.policy", "numpy asyncio"),
        ("sfglab.lab.paths", "numpy pandas asyncio"),
        ("sfglab.messages", "cyclonedds rosbags.typesys"),
        ("sfglab.codecs", "numba cv2 cyclonedds"),
    ],
)
def test_an_import_loads_nothing_heavy(package, heavy):
    code = f"import sys, {package}; print(*{{*{heavy.split()}}} & sys.modules.keys())"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "\n"


def test_no_file_is_big_and_none_holds_a_path_of_a_machine():
    done = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    if done.returncode:
        pytest.skip("needs a git checkout")
    of_logs = 0
    for path in filter(Path.is_file, (ROOT / line for line in done.stdout.splitlines())):
        if path.suffix == ".mcap":
            of_logs += path.stat().st_size
            continue
        assert path.stat().st_size < 2_000_000, path
        assert not re.search(rb"/(?:home|root|work)/[a-z]", path.read_bytes()), path
    assert of_logs < 5_000_000


def test_classes_of_rows_have_names_of_their_own():
    """A row's class becomes a type in logs, and types of one process must not share a name."""
    nodes = [node for tree in trees().values() for node in ast.walk(tree)]
    counts = Counter(node.name for node in nodes if isinstance(node, ast.ClassDef))
    rows = {name: count for name, count in counts.items() if name.endswith("Row")}
    assert [name for name, count in rows.items() if count > 1] == []

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

FLOORS = (
    (
        *(
            "names",
            "lazy",
            "domains",
            "qos",
            "errors",
            "machine",
            "component",
            "fields",
            "units",
            "files",
        ),
        *("processes", "documents", "schema", "tables", "compiling", "validation"),
    ),
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
    conda = yaml.safe_load((ROOT / "environment.yml").read_text())["dependencies"]
    pip = next(d for d in conda if isinstance(d, dict))["pip"]
    listed = {normal(d) for d in [*conda, *pip] if isinstance(d, str)} - {"pip", "python>=3.11"}
    project = PYPROJECT["project"]
    wanted = {normal(d) for d in project["dependencies"]}
    for extra in ("view", "rtl", "deploy"):
        wanted |= {normal(d) for d in project["optional-dependencies"][extra]}
    assert listed == wanted


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
    names = {
        e: {re.split(r"[\[<>=]", normal(d))[0] for d in listed} for e, listed in extras.items()
    }
    of_tests, of_book = names.pop("dev"), names.pop("book")
    run, tests, book = (
        locked(f"install/{name}.lock") for name in ("requirements", "tests", "book")
    )
    assert set().union(*names.values()) <= set(run.values())
    assert of_tests <= set(tests.values())
    assert of_book <= set(book.values())
    assert {block for block, name in tests.items() if name in run.values()} <= set(run)
    # The book wants some on other platforms, too: there the versions and hashes agree, and not the markers.
    pins = {re.sub(" ; .*", " \\\\", block) for block in run}
    assert {
        re.sub(" ; .*", " \\\\", block) for block, name in book.items() if name in run.values()
    } <= pins
    assert "pyside6-webengine" not in run.values()


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
    arrows = [(m, d) for m, found in imports().items() for d in found if part_of(m) != part_of(d)]
    wrong = [
        f"{module} imports {other}"
        for module, other in arrows
        if part_of(other)
        and (
            floor_of.get(part_of(module), -1) < floor_of[part_of(other)]
            or {part_of(module), part_of(other)} <= SIBLINGS_APART
        )
    ]
    assert not wrong, "\n".join(wrong)


def test_there_are_no_import_circles():
    """Types count too: what knows another's type knows the other."""
    import networkx as nx

    graph = nx.DiGraph([(m, d) for m, found in imports().items() for d in found])
    assert [sorted(c) for c in nx.strongly_connected_components(graph) if len(c) > 1] == []


def test_only_facades_list_what_they_export_and_each_name_exists_once():
    listing = [
        path
        for path, tree in trees().items()
        if "__all__" in {getattr(n, "id", "") for n in ast.walk(tree)}
    ]
    assert [path for path in listing if path.name != "__init__.py"] == []
    for module in map(import_module, map(name_of, listing)):
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
    tracked = [ROOT / line for line in done.stdout.splitlines() if (ROOT / line).is_file()]
    for path in tracked:
        if path.suffix != ".mcap":
            assert path.stat().st_size < 2_000_000, path
            assert not re.search(rb"/(?:home|root|work)/[a-z]", path.read_bytes()), path
    assert sum(path.stat().st_size for path in tracked if path.suffix == ".mcap") < 6_000_000


def test_classes_of_rows_have_names_of_their_own():
    """A row's class becomes a type in logs, and types of one process must not share a name."""
    classes = [
        node
        for tree in trees().values()
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef)
    ]
    counts = Counter(node.name for node in classes if node.name.endswith("Row"))
    assert [name for name, count in counts.items() if count > 1] == []


def test_the_list_of_figures_has_a_line_for_each():
    folder = ROOT / "figures"
    listed = re.findall(r"^\| `(\w+)` \|", (folder / "README.md").read_text("utf-8"), re.MULTILINE)
    assert sorted(listed) == sorted(
        path.stem for path in folder.iterdir() if path.suffix in {".png", ".gif"}
    )

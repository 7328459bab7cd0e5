"""The book's pages: what stands in this folder, all notebooks, and references made from the code.

``python book/pages.py FOLDER`` puts them together for Sphinx. Nothing generated is committed, and no notebook
is executed: what a page shows is the committed output, the code as it is, or the ledger of the logs at hand.
"""

from __future__ import annotations

import ast
import importlib
import inspect
import json
import pkgutil
import re
import shutil
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pandas as pd
import typer

import sfglab
from sfglab.cli import app
from sfglab.fields import bounds_of, field_docs, to_json
from sfglab.lab.experiment import PROFILES
from sfglab.lab.experiments import EXPERIMENTS, experiment, ros2
from sfglab.lab.formats import FORMATS, Format
from sfglab.lab.ledger import compute_ledger
from sfglab.lab.ledger_page import page_html
from sfglab.lab.paths import find_project

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from sfglab.lab.experiment import Experiment

ROOT = Path(__file__).parents[1]
SURFACE = (
    *("bus", "messages", "record", "fleet", "fleet.lint", "arp", "rtps", "soc", "spatial", "view"),
    *("lab", "lab.experiments", "lab.explore", "lab.notebook"),
)
"""Packages and modules with public names."""
PLAIN_WORDS = {
    "Types as this distribution has them": "Message types of this distribution",
    "best effort loses some with Linux's socket buffer, and a few in a hundred at 30 Hz": (
        "with Linux's default receive buffer, best effort loses some, and a few percent at 30 Hz"
    ),
    "Reliability and durability: who hears whom": "Reliability and durability: which endpoints match",
    "Bytes behind a message, as rclpy sends serialised ones": (
        "Trailing bytes after a message, as rclpy appends them to serialised messages"
    ),
    "On demand, and in the graph before anybody subscribes (what `topic list` reads)": (
        "Topics behind a router: forwarded on demand, and listed before a node subscribes"
    ),
    "agents offer it": "agents advertise them",
    "life asserted without a message does not cross": (
        "liveliness asserted without a message is not forwarded"
    ),
    "who joins later behind a router gets one of a latched past, for Fast DDS does not announce how deep it is": (
        "a late joiner behind a router receives one transient-local sample, because Fast DDS does not announce the depth"
    ),
    "messages a second": "messages per second",
    "of 921 kB a second": "of 921 kB per second",
    "of 640 x 480 a second": "of 640 x 480 per second",
    "as complete as direct": "as completely as without routers",
    "What will never be heard is said, with the node's name: QoS and types": (
        "Warning about incompatible QoS or types, with the node's name"
    ),
    "Publishers and processes that come, go and die": (
        "Publishers and processes that start, end or are killed"
    ),
    "Services where no ROS 2 stands beside a router: not announced, which is said": (
        "Services without ROS 2 on the router's host: not announced, with a warning"
    ),
    "ROS 2 beside each router": "with ROS 2 on the host of each router",
    "ROS 2 beside it": "with ROS 2 on the same host",
    "(what `ros2 param` asks)": "(with `ros2 param`)",
    "TF: /tf and latched /tf_static": "TF: /tf and transient-local /tf_static",
    "received until then (MB)": "bytes received during discovery (MB)",
    "until an agent knows its peers (s)": "discovery time per agent (s)",
    "pictures received (%)": "images received (%)",
    "capture to picture in hand (ms)": "latency from capture to receipt (ms)",
    "first picture (ms)": "time to the first image (ms)",
}
"""Plain words for those of committed logs, which name features and quantities in earlier words."""


def write_pages(folder: Path) -> None:
    """Put all pages into an empty folder."""
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(
        ROOT / "book", folder, ignore=shutil.ignore_patterns("*.pyc", "__pycache__", "pages.py")
    )
    (folder / "notebooks").mkdir()
    (folder / "extra" / "figures").mkdir(parents=True)
    for notebook in sorted((ROOT / "notebooks").glob("*.ipynb")):
        text = _linked_within_the_book(notebook.read_text("utf-8"))
        (folder / "notebooks" / notebook.name).write_text(text, encoding="utf-8")
        _copy_linked_figures(text, folder)
    (folder / "figures").mkdir()
    for page in folder.rglob("*.md"):
        text = page.read_text("utf-8")
        for name in re.findall(r"figures/([\w.]+)", text):
            shutil.copy(ROOT / "figures" / name, folder / "figures")
        # The folders are beside the folder of the book, and within the book's pages.
        text = re.sub(r"\.\./(notebooks|figures)/", r"\1/", text)
        page.write_text(text, encoding="utf-8")
    _replace(folder / "extend.md", {"experiment-of-design": _experiment()})
    _replace(folder / "ros2.md", ros2_tables())
    reference = folder / "reference"
    for sub in ("formats", "api"):
        (reference / sub).mkdir(parents=True)
    for name, form in FORMATS.items():
        (reference / "formats" / f"{name}.md").write_text(format_page(name, form), encoding="utf-8")
    for name in packages():
        (reference / "api" / f"{name}.md").write_text(package_page(name), encoding="utf-8")
    (reference / "commands.md").write_text(commands_page(), encoding="utf-8")
    (reference / "experiments.md").write_text(experiments_page(), encoding="utf-8")
    (reference / "names.md").write_text(names_page(), encoding="utf-8")
    ledger = ledger_page()
    (reference / "ledger.md").write_text(ledger, encoding="utf-8")
    _copy_linked_figures(ledger, folder)


def _copy_linked_figures(text: str, folder: Path) -> None:
    """Copy the figures that HTML links to, which Sphinx does not read."""
    for name in re.findall(r"\.\./figures/([\w.]+)", text):
        shutil.copy(ROOT / "figures" / name, folder / "extra" / "figures")


def _linked_within_the_book(notebook: str) -> str:
    """Return a notebook whose links to pages, and in outputs to other notebooks, are the book's."""
    text = re.sub(r'href=\\"\.\./notebooks/(\w+)\.ipynb', r'href=\\"\1.html', notebook)
    text = re.sub(r'href=\\"\.\./book/(\w+)\.md', r'href=\\"../\1.html', text)
    text = re.sub(r"\]\(\.\./book/(\w+)\.md", r"](../\1.md", text)
    return re.sub(r'(href=\\"\d\d_\w+\.)ipynb', r"\1html", text)


def _replace(page: Path, marks: Mapping[str, str]) -> None:
    text = page.read_text("utf-8")
    for mark, made in marks.items():
        assert f"<!-- {mark} -->" in text, mark
        text = text.replace(f"<!-- {mark} -->", made)
    page.write_text(text, encoding="utf-8")


def _experiment() -> str:
    """Return the complete experiment, with its test, that DESIGN.md holds and a test runs."""
    text = (ROOT / "DESIGN.md").read_text("utf-8")
    return "\n".join(re.findall(r"^```python\n.*?^```\n", text, re.MULTILINE | re.DOTALL)[:2])


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """Return a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join(
        f"| {' | '.join(' '.join(c.split()).replace('|', chr(92) + '|') for c in r)} |"
        for r in lines
    )


def markdown(frame: pd.DataFrame) -> str:
    """Return a table of texts as a Markdown table."""
    return table([*frame.columns], frame.to_numpy().tolist())


def ros2_tables() -> dict[str, str]:
    """Return features, and medians of rclpy and its stand-ins, from the committed logs, by mark."""
    tables = []
    for name in ros2.BASELINES:
        frame = ros2.compared(ros2.baseline(name)).map(ros2_cell)
        frame.insert(0, "experiment", name)
        tables.append(frame)
    features, baselines = ros2.feature_table().map(plain), pd.concat(tables).map(plain)
    return {"ros2-features": markdown(features), "ros2-baselines": markdown(baselines)}


def plain(text: str) -> str:
    """Return a text of a log in plain words."""
    for former, current in PLAIN_WORDS.items():
        text = text.replace(former, current)
    return text


def ros2_cell(value: object) -> str:
    """Return a number with three significant digits, and a text as it is."""
    return f"{value:.3g}" if isinstance(value, float) else str(value)


# Formats


def format_page(name: str, form: Format) -> str:
    """Return the page of a file format, made from its JSON Schema."""
    schema = form.schema()
    defs = schema["$defs"]
    schema = _inlined(schema, defs)
    example = min((ROOT / "data").glob(form.files), key=lambda p: p.stat().st_size)
    lines = example.read_text("utf-8").splitlines()
    shown = "\n".join(lines[:60] + ["# ..."] * (len(lines) > 60))
    top = defs[_target(schema["items"])] if "items" in schema else schema
    about = (
        f"`{form.read_by}` reads files of this format, and other commands may read them as well. "
        f"`sfglab schema {name}` prints the JSON Schema, with which an editor completes keys. Keys "
        "that are not marked as *needed* are optional. *None* means that the key was left out."
    )
    parts = [
        f"# {form.title}\n\n{about}",
        _mapping("Each item" if "items" in schema else "Keys", top),
    ]
    kinds = top["properties"].get("objects", {}).get("items", {}).get("oneOf", ())
    parts += [_mapping(f"Object: {kind['properties']['kind']['const']}", kind) for kind in kinds]
    parts += [
        _mapping(_words(key), part)
        for key, part in schema["$defs"].items()
        if "properties" in part and part != top and part not in kinds
    ]
    parts.append(
        f"## Example\n\n`data/{example.relative_to(ROOT / 'data')}`:\n\n```yaml\n{shown}\n```"
    )
    return "\n\n".join(parts) + "\n"


def _target(part: dict[str, Any]) -> str:
    """Return the name of the definition that a schema refers to."""
    return str(part.get("$ref", "")).rpartition("/")[2]


def _inlined(part: Any, defs: dict[str, Any]) -> Any:
    """Return a schema with its choices, and its objects of several kinds, in their places."""
    if isinstance(part, list):
        return [_inlined(one, defs) for one in part]
    if not isinstance(part, dict):
        return part
    target = defs.get(_target(part), {})
    if "enum" in target or "kind" in target.get("properties", ()):
        part = {**target, **part}
        del part["$ref"]
    return {key: _inlined(one, defs) for key, one in part.items()}


def _words(name: str) -> str:
    """Return a definition's name as words: ``TopicUse`` becomes ``Topic use``."""
    name = name.removeprefix("_").removesuffix("Keys").removesuffix("Spec")
    return name if name == "QoS" else re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).capitalize()


def _mapping(title: str, schema: dict[str, Any]) -> str:
    rows = []
    for key, part in schema["properties"].items():
        given = part.get("default", "**needed**" if key in schema.get("required", ()) else "")
        default = given if given in ("", "**needed**") else f"`{json.dumps(given)}`"
        rows.append([f"`{key}`", kind_of(part), default, part.get("description", "")])
    about = f"{schema['description']}\n\n"
    shown = table(["key", "type", "default", "meaning"], rows)
    return f"## {title}\n\n{about}:::{{container}} keys\n\n{shown}\n\n:::"


def kind_of(part: dict[str, Any]) -> str:
    """Return in words what a schema allows."""
    for word in ("anyOf", "oneOf"):
        if word in part:
            return " or ".join(kind_of(option) for option in part[word])
    if "$ref" in part:
        name = _words(part["$ref"].rpartition("/")[2])
        return f"[{name}](#{name.lower().replace(' ', '-')})"
    if "enum" in part or "const" in part:
        return " or ".join(f"`{value}`" for value in part.get("enum", [part.get("const")]))
    kinds = [part["type"]] if isinstance(part["type"], str) else part["type"]
    return " or ".join(_one_kind(kind, part) for kind in kinds)


def _one_kind(kind: str, part: dict[str, Any]) -> str:
    if kind == "array":
        count = f"{part['minItems']} of " if "minItems" in part else "list of "
        return count + kind_of(part["items"])
    if kind == "object":
        each = part.get("additionalProperties")
        if each:
            return f"mapping by name to {kind_of(each)}"
        if "id" in part["properties"]:
            word = part["properties"]["kind"]["const"]
            return f"[{word}](#object-{word})"
        return "mapping: " + ", ".join(
            f"`{key}` {kind_of(p)}" for key, p in part["properties"].items()
        )
    if part.get("minimum", 0) == part.get("maximum"):
        return f"`{part['minimum']}`"
    ends = [
        f"{sign} {part[word]:g}"
        for word, sign in (
            ("minimum", "≥"),
            ("exclusiveMinimum", ">"),
            ("maximum", "≤"),
            ("exclusiveMaximum", "<"),
        )
        if word in part
    ]
    word = {"string": "text", "integer": "whole number", "boolean": "true or false"}.get(kind, kind)
    return " ".join([word, *(ends if kind in {"integer", "number"} else [])])


# Commands


def commands() -> Iterator[tuple[str, Any]]:
    """Yield every command and group of the program by its words."""

    def walk(words: str, command: Any) -> Iterator[tuple[str, Any]]:
        yield words, command
        for name, inner in getattr(command, "commands", {}).items():
            if not inner.hidden:
                yield from walk(f"{words} {name}", inner)

    yield from walk("sfglab", typer.main.get_command(app))


def commands_page() -> str:
    """Return the page of the command line."""
    about = (
        "An error is one sentence on standard error. The exit status is 0 on success, 2 for arguments that cannot be "
        "parsed, and 1 for other errors."
    )
    parts = [_command(words, command) for words, command in commands()]
    return "\n\n".join(["# Command line", about, *parts]) + "\n"


def _command(words: str, command: Any) -> str:
    about, examples = [], []
    for paragraph in re.split(r"\n\s*\n", inspect.cleandoc(command.help or "")):
        if paragraph.startswith("\b"):  # as it is written: a line "Examples:", and the examples
            examples += inspect.cleandoc(paragraph.partition(":\n")[2]).splitlines()
        else:
            about.append(_safe(" ".join(paragraph.split())))
    context = command.context_class(command)
    usage = " ".join([words, *command.collect_usage_pieces(context)])
    rows = []
    for parameter in command.params:
        if getattr(parameter, "hidden", False):
            continue
        record = parameter.get_help_record(context) or (
            parameter.make_metavar(context),
            getattr(parameter, "help", "") or "",
        )
        rows.append([f"`{record[0]}`", _safe(record[1])])
    shown = "\n".join(examples)
    parts = [
        f"## {words}",
        *about,
        f"```text\n{usage}\n```",
        *([table(["option or argument", "meaning"], rows)] if rows else []),
    ]
    return "\n\n".join(parts + ([f"```bash\n{shown}\n```"] if shown else []))


def _safe(text: str) -> str:
    """Return a plain text so that Markdown shows it as it is."""
    return re.sub(r"([*_<>\[\]`$])", r"\\\1", text)


# Experiments


def experiments_page() -> str:
    """Return the page of what may be set in each experiment."""
    about = (
        "This page lists the fields of each experiment, with their values in each profile (the size of a run). "
        "Three ways change a field: the command `sfglab try depth_codecs frames=10`, the call "
        "`notebook.run(exp, profile, frames=10)`, and the sliders of a notebook. A run with changed fields, "
        "except the seed, counts for no claim."
    )
    return (
        "\n\n".join([f"# Experiments\n\n{about}", *map(_settings, map(experiment, EXPERIMENTS))])
        + "\n"
    )


def _settings(exp: Experiment[Any]) -> str:
    configs = [to_json(exp.config(profile)) for profile in PROFILES]
    bounds, docs = bounds_of(exp.config_class), field_docs(exp.config_class)
    rows = []
    for name, text in ((name, docs.get(name, "")) for name in configs[0]):
        values = [_short(config[name]) for config in configs]
        rows.append([f"`{name}`", *values, str(bounds.get(name, "")), text])
    head = ["field", *PROFILES, "bounds", "meaning"]
    return f"## {exp.name}\n\nPaper {exp.where}.\n\n{table(head, rows)}"


def _short(value: Any) -> str:
    text = json.dumps(value)
    return f"`{text}`" if len(text) < 40 else f"{len(value)} entries"


# Packages


def packages() -> list[str]:
    """Return the packages of the library."""
    found = [m.name for m in pkgutil.iter_modules(sfglab.__path__) if m.ispkg]
    return [name for name in found if name != "cli"]


def package_page(name: str) -> str:
    """Return the page of a package: its facade's public names, and what each of its modules is for."""
    package = importlib.import_module(f"sfglab.{name}")
    parts = [f"# sfglab.{name}\n\n{_prose(inspect.getdoc(package) or '')}"]
    parts += [_entry(package.__name__, key, getattr(package, key)) for key in public(package)]
    rows = list(map(_module, sorted(Path(package.__path__[0]).rglob("*.py"))))
    return (
        "\n\n".join([*parts, "## Modules", table(["module", "purpose", "public names"], rows)])
        + "\n"
    )


def public(package: Any) -> list[str]:
    """Return the names of a facade's classes and functions."""
    names = getattr(package, "__all__", [])
    return [
        n
        for n in names
        if inspect.isclass(getattr(package, n)) or inspect.isroutine(getattr(package, n))
    ]


def _module(path: Path) -> list[str]:
    """Return a module's name, purpose and public names; it is not imported, for some are programs."""
    tree = ast.parse(path.read_text("utf-8"))
    name = ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
    kinds = ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef
    names = [n.name for n in tree.body if isinstance(n, kinds) and not n.name.startswith("_")]
    purpose = _prose((ast.get_docstring(tree) or "").partition("\n\n")[0])
    return [f"`{name}`", purpose, ", ".join(f"`{n}`" for n in names)]


def _entry(holder: str, name: str, value: Any) -> str:
    try:
        signature = re.sub(r"<function .*? at 0x\w+>", "...", str(inspect.signature(value)))
    except (TypeError, ValueError):
        signature = ""
    signature = re.sub(r"(: |-> )'([^']*)'", r"\1\2", signature)  # annotations are strings
    text = f"{'class ' if inspect.isclass(value) else ''}{name}{signature}"
    if len(text) > 80:
        text = re.sub(r"(\(|, )(?=\*, |\w+: )", lambda found: f"{found[1].strip()}\n    ", text)
    head = f"## {name}\n\n```python\nfrom {holder} import {name}\n{text}\n```"
    return f"{head}\n\n{_prose(inspect.getdoc(value) or '')}"


def _prose(doc: str) -> str:
    """Return a docstring's text up to its sections as Markdown; indented lines are code."""
    text = re.split(r"^(?:Args|Returns|Raises|Yields|Attributes):$", doc, flags=re.MULTILINE)[0]
    made = []
    for paragraph in text.strip().split("\n\n"):
        parts = re.split(r"(``[^`]*``|`[^`]*`)", paragraph)
        shown = "".join(f"`{p.strip('`')}`" if p.startswith("`") else _safe(p) for p in parts)
        made.append(paragraph if paragraph.startswith("    ") else shown)
    return "\n\n".join(made)


# Public names


def names_page() -> str:
    """Return the page of the public names of all of `SURFACE`."""
    about = (
        "This page lists the public names of sfglab. Until version 0.1.0 is released, names change "
        "freely. From 0.1.0 on, a changed name still works for one release and warns. Names that "
        "this page does not list may change at any time."
    )
    parts = [f"# Public names\n\n{about}"]
    for part in SURFACE:
        rows = [*public_names(importlib.import_module(f"sfglab.{part}"))]
        parts.append(f"## sfglab.{part}\n\n{table(['name', 'kind', 'meaning'], rows)}")
    return "\n\n".join(parts) + "\n"


def public_names(module: Any) -> Iterator[list[str]]:
    """Yield name, kind and first sentence of each public name; without ``__all__``, of each function."""
    own = [n for n, value in vars(module).items() if inspect.getmodule(value) is module]
    for name in getattr(module, "__all__", [n for n in own if not n.startswith("_")]):
        value = getattr(module, name)
        kind, doc = "constant", constant_doc(Path(module.__file__).parent, name)
        if inspect.isclass(value) or inspect.isroutine(value):
            kind, doc = "class" if inspect.isclass(value) else "function", value.__doc__ or ""
        yield [f"`{name}`", kind, _prose(re.split(r"(?<=\.)\s(?!\d)", doc)[0])]


def constant_doc(folder: Path, name: str) -> str:
    """Return the string below a constant of one of the modules in a folder."""
    sources = [path.read_text("utf-8") for path in sorted(folder.rglob("*.py"))]
    pattern = rf'^{name}\b.*\n(?:[ )}}\]].*\n)*"""([^"]+)"""'
    found = re.search(pattern, "\n".join(sources), re.MULTILINE)
    return found[1] if found else ""


# The ledger


def ledger_page() -> str:
    """Return the page of all claims, with interval plots and citations to copy."""
    project = find_project()
    page = page_html(project, compute_ledger(project, committed=True))
    page = re.sub(r'(href="\.\./notebooks/\w+)\.ipynb', r"\1.html", page)
    about = (
        "This page compares each claim of the papers with the value of sfglab. `sfglab claims --reference` prints "
        "the same values, and `sfglab claims` also uses your own runs. Click a statement to see its acceptance "
        "range, the reason of its verdict and a text to cite."
    )
    return f"# The ledger\n\n{about}\n\n{page}\n"


if __name__ == "__main__":
    write_pages(Path(sys.argv[1]))

"""The book: built without a network, read without one; whole, with no dead link, and no wider than a phone."""

from __future__ import annotations

import dataclasses
import re
import subprocess
import sys
from contextlib import closing
from html.parser import HTMLParser
from importlib import import_module
from pathlib import Path
from urllib.parse import unquote, urlsplit

import nbformat
import pytest
from browser import Browser
from commands import commands

from sfglab.lab.experiments import EXPERIMENTS, experiment
from sfglab.lab.formats import FORMATS

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "book"))

import pages  # noqa: E402

PHONE = 390  # pixels
LOADED = {("script", "src"), ("link", "href"), ("img", "src"), ("iframe", "src"), ("source", "src")}
WIDER = "document.documentElement.scrollWidth > innerWidth || [...document.images].some(i => !i.naturalWidth)"
COMMANDS = [" ".join(("sfglab", *words)) for words, _ in commands()]


class Page(HTMLParser):
    """A page: the files that it loads, its links, and the targets of links in it."""

    def __init__(self, file: Path) -> None:
        super().__init__()
        self.links: list[str] = []
        self.loads: list[str] = []
        self.ids = {""}
        self.text = file.read_text("utf-8")
        self.feed(self.text)

    def handle_starttag(self, tag, attrs):
        for key, value in attrs:
            if key == "id":
                self.ids.add(value)
            elif (tag, key) in LOADED and not (value or "").startswith("data:"):
                self.loads.append(value)
                self.links.append(value)
            elif key == "href":
                self.links.append(value)


def test_the_page_of_names_has_a_sentence_for_each_public_name():
    _, *sections = pages.names_page().split("\n## sfglab.")
    for section in sections:
        rows = dict(re.findall(r"^\| `(\w+)` \| \w+ \| (.*) \|$", section, re.MULTILINE))
        package = import_module(f"sfglab.{section.split()[0]}")
        assert rows.keys() == set(getattr(package, "__all__", rows)), package
        assert [name for name, sentence in rows.items() if not sentence.endswith(".")] == []


def test_a_constant_without_a_docstring_has_no_sentence(tmp_path):
    (tmp_path / "a.py").write_text('A = 1\nB = (\n    2,\n)\n"""Two."""\n')
    assert [pages.constant_doc(tmp_path, name) for name in "AB"] == ["", "Two."]


@pytest.fixture(scope="module")
def book(tmp_path_factory):
    """Build it as `make book` does, in a network namespace of its own, where nothing can be reached."""
    folder = tmp_path_factory.mktemp("book")
    makefile = (ROOT / "Makefile").read_text()
    [commands] = re.findall(r"^book:.*\n((?:\t.*\n)+)", makefile, re.MULTILINE)
    for line in commands.strip().splitlines():
        told = line.strip().replace("$(BIN)/python", sys.executable).replace("build/", f"{folder}/")
        alone = ["unshare", "--map-root-user", "--net", *told.split()]
        done = subprocess.run(alone, cwd=ROOT, capture_output=True, text=True, check=False)
        assert (done.returncode, done.stderr) == (0, "")
    return folder / "book"


@pytest.mark.slow
@pytest.mark.netns
@pytest.mark.browser
def test_the_book_is_whole_and_needs_no_network_and_no_wide_screen(book):
    """One test, because building takes half a minute."""
    pages = {
        file: Page(file) for file in sorted(book.rglob("*.html")) if "_static" not in file.parts
    }
    assert {at for page in pages.values() for at in page.loads if urlsplit(at).netloc} == set()
    for file in book.rglob("*.[cj]s*"):
        away = r"(?:url\(|@import|src\s*=|import\()\s*[\"'](?:https?:)?//"
        assert not re.search(away, file.read_text("utf-8", "replace")), file
    assert {(file.name, link) for file in pages for link in dead_links(pages, file)} == set()
    shown = {file.relative_to(book).as_posix(): page.text for file, page in pages.items()}
    assert [*missing(shown)] == []
    with closing(Browser(PHONE, 800)) as browser:
        wide = []
        for file in pages:
            browser.open(file.as_uri())
            browser.wait_for("document.readyState === 'complete'")
            if browser.evaluate(WIDER):
                wide.append(file.name)
    assert wide == []


def dead_links(pages, file):
    for link in pages[file].links:
        parts = urlsplit(link)
        target = (file.parent / unquote(parts.path)).resolve() if parts.path else file
        ids = pages[target].ids if target in pages else {""}
        if not parts.scheme and not (target.is_file() and unquote(parts.fragment) in ids):
            yield link


def missing(shown):
    """Yield what the book lacks: notebooks' pictures, keys of files, fields of experiments, commands."""
    for path in (ROOT / "notebooks").glob("*.ipynb"):
        cells = nbformat.read(path, as_version=4).cells
        kinds = [
            kind for cell in cells for o in cell.get("outputs", ()) for kind in o.get("data", ())
        ]
        pictures = kinds.count("image/png") + kinds.count("image/jpeg")
        if shown[f"notebooks/{path.stem}.html"].count("../_images/") < pictures:
            yield path.stem
    for name, form in FORMATS.items():
        written = set(re.findall(r"class=\"pre\">(\w+)<", shown[f"reference/formats/{name}.html"]))
        yield from set(keys(form.schema())) - written
    configs = [experiment(name).config_class for name in EXPERIMENTS]
    fields = {field.name for config in configs for field in dataclasses.fields(config)}
    yield from (name for name in fields if f">{name}<" not in shown["reference/experiments.html"])
    commands_page = shown["reference/commands.html"]
    yield from (word for word in COMMANDS if f">{word}<" not in commands_page)
    if commands_page.count("highlight-bash") < len(COMMANDS) / 2:
        yield "examples"


def keys(part):
    """Yield the keys of every mapping of a schema."""
    if isinstance(part, dict):
        yield from part.get("properties", {})
        for inner in part.values():
            yield from keys(inner)
    elif isinstance(part, list):
        for inner in part:
            yield from keys(inner)

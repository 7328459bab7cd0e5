"""Index, book, summary, `sfglab claims` and runs print the values of one program."""

import json
import re
from html import unescape
from importlib import import_module
from pathlib import Path

import nbformat
import pytest
from commands import called
from test_readme import DEVIATING

from sfglab.lab.claims import Ledger, render
from sfglab.lab.index import make_index
from sfglab.lab.ledger import compute_ledger
from sfglab.lab.ledger_page import page_html
from sfglab.lab.paths import Project

ROOT = Path(__file__).parents[2]
PROJECT = Project(root=ROOT)


@pytest.fixture(scope="module")
def ledger():
    """The ledger of the committed logs, by claim."""
    return {entry.claim.id: entry for entry in compute_ledger(PROJECT, committed=True)}


def outputs_of(name: str) -> str:
    """Return the HTML that a committed notebook shows."""
    notebook = nbformat.read(ROOT / "notebooks" / f"{name}.ipynb", as_version=4)
    shown = [o for c in notebook.cells if c.cell_type == "code" for o in c.outputs]
    return "\n".join(o.get("data", {}).get("text/html", "") for o in shown)


def without_images(html: str) -> str:
    """Return a page without the bytes of its images."""
    return re.sub(r'src="data:[^"]*"', "", html)


def test_the_committed_reports_and_the_book_show_todays_pages(ledger, monkeypatch):
    whole = Ledger(ledger.values())
    page = page_html(PROJECT, whole)
    assert page in outputs_of("01_ledger")
    monkeypatch.syspath_prepend(ROOT / "book")
    assert page.replace(".ipynb", ".html") in import_module("pages").ledger_page()
    shown = without_images(outputs_of("00_start"))
    assert without_images(make_index(PROJECT, whole)._repr_html_()) in shown
    cited = re.findall(r"claim ([\w-]+): .*?; verdict: ([\w ]+)\.", unescape(shown))
    assert len(cited) >= 5, "one for each result"
    assert [name for name, said in cited if ledger[name].verdict.value != said] == []
    assert all(ledger[name].value in shown for name, _ in cited)


def test_the_command_prints_the_ledgers_values(ledger):
    said = called("claims", "--reference")
    assert said.rstrip("\n") == render([*ledger.values()])
    assert "ledger from the committed logs: " in said
    found = json.loads(called("claims", "--reference", "--json"))
    assert {entry["id"]: entry["value"] for entry in found} == {
        name: entry.measured.estimate.value for name, entry in ledger.items()
    }
    assert {entry["source"] for entry in found} == {"the committed logs"}
    in_full = called("claims", "--reference", "--verbose")
    for name, entry in ledger.items():
        assert f"{name}: {entry.verdict.value}" in in_full
        assert f"log: {entry.log}" in in_full


def test_the_summary_figure_prints_the_ledgers_values_of_claims_in_the_readme(ledger):
    shown = json.loads((ROOT / "figures" / "summary.json").read_text("utf-8"))["shown"]
    results = (ROOT / "README.md").read_text("utf-8").partition(DEVIATING)[0]
    for name, said in shown.items():
        entry = ledger[name]
        assert said == f"{entry.value} {entry.unit}: {entry.verdict.value}"
        assert f"({name})" in results

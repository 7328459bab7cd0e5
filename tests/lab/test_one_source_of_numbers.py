"""Index, book, summary, `sfglab claims` and runs print the values of one program."""

import importlib.util
import json
import re
import subprocess
import sys
from html import escape, unescape
from pathlib import Path

import nbformat
import pytest
from made_logs import DATA, reference
from test_readme import DEVIATING

from sfglab.lab.claims import Ledger, render
from sfglab.lab.experiments import EXPERIMENTS, experiment
from sfglab.lab.index import make_index
from sfglab.lab.ledger import compute_ledger, own_ledger
from sfglab.lab.ledger_page import page_html
from sfglab.lab.paths import Project

ROOT = Path(__file__).parents[2]
PROJECT = Project(root=ROOT)


@pytest.fixture(scope="module")
def ledger():
    """The ledger of the committed logs, by claim."""
    return {entry.claim.id: entry for entry in compute_ledger(PROJECT, committed=True)}


def html_rows(html: str) -> list[list[str]]:
    """Return the rows of all tables, cell by cell, as text."""
    rows = re.findall(r"<tr[^>]*>(.*?)</tr>", html, re.DOTALL)
    cells = [re.findall(r"<td[^>]*>(.*?)</td>", row, re.DOTALL) for row in rows]
    return [[unescape(re.sub(r"<[^>]+>", " ", cell)).strip() for cell in row] for row in cells]


def outputs_of(name: str) -> str:
    """Return the HTML that a committed notebook shows."""
    notebook = nbformat.read(ROOT / "notebooks" / f"{name}.ipynb", as_version=4)
    shown = [o for c in notebook.cells if c.cell_type == "code" for o in c.outputs]
    return "\n".join(o.get("data", {}).get("text/html", "") for o in shown)


def without_images(html: str) -> str:
    """Return a page without the bytes of its images."""
    return re.sub(r'src="data:[^"]*"', "", html)


def test_the_committed_reports_show_todays_pages(ledger):
    whole = Ledger(ledger.values())
    assert page_html(PROJECT, whole) in outputs_of("01_ledger")
    shown = without_images(outputs_of("00_start"))
    assert without_images(make_index(PROJECT, whole)._repr_html_()) in shown
    cited = re.findall(r"claim ([\w-]+) \(.*?; verdict: ([\w ]+);", unescape(shown))
    assert [name for name, said in cited if ledger[name].verdict.value != said] == []
    assert all(ledger[name].value in shown for name, _ in cited)


def test_the_book_shows_the_page_of_the_committed_logs(ledger, monkeypatch):
    monkeypatch.setenv("SFGLAB_ROOT", str(ROOT))
    spec = importlib.util.spec_from_file_location("pages", ROOT / "book" / "pages.py")
    pages = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(pages)
    assert page_html(PROJECT, Ledger(ledger.values())) in pages.ledger_page()


def test_the_command_prints_the_ledgers_values(ledger):
    argv = [sys.executable, "-P", "-m", "sfglab", "claims", "--reference"]
    done = subprocess.run(argv, cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.rstrip("\n") == render([*ledger.values()])
    assert "ledger from the committed logs: " in done.stdout
    argv.append("--json")
    done = subprocess.run(argv, cwd=ROOT, capture_output=True, text=True, check=True)
    found = {entry["id"]: entry for entry in json.loads(done.stdout)}
    assert {name: found[name]["value"] for name in found} == {
        name: entry.measured.estimate.value for name, entry in ledger.items()
    }
    assert {entry["source"] for entry in found.values()} == {"the committed logs"}


def test_the_summary_figure_prints_the_ledgers_values_of_claims_in_the_readme(ledger):
    shown = json.loads((ROOT / "figures" / "summary.json").read_text("utf-8"))["shown"]
    results = (ROOT / "README.md").read_text("utf-8").partition(DEVIATING)[0]
    for name, said in shown.items():
        entry = ledger[name]
        assert said == f"{entry.value} {entry.unit}: {entry.verdict.value}"
        assert f"({name})" in results


def test_the_kind_of_each_interval_is_named(ledger):
    for entry in ledger.values():
        estimate = entry.measured.estimate
        if estimate.low == estimate.high:
            assert (entry.interval, "[" in entry.value) == ("", False)
        elif entry.runs:
            assert entry.interval == f"range over {len(entry.runs)} runs"
        else:
            assert entry.interval == "95 % interval"


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_a_runs_own_verdict_stands_below_the_ledgers_with_the_reason(name, ledger):
    claims = own_ledger(PROJECT, reference(experiment(name)))
    html = claims._repr_html_()
    rows = [row for row in html_rows(html) if row]
    heads = [row[0] for row in rows]
    for each in claims:
        entry = ledger[each.claim.id]
        assert (each.value, each.verdict) == (entry.value, entry.verdict)
        if (each.own.value, each.own.verdict) != (entry.value, entry.verdict):
            assert each.own_reason
            assert rows[heads.index(entry.claim.id) + 1][1] == "in this run alone"
            said = rf"In this run alone \([^)]*{entry.claim.id}\b[^)]*\): "
            assert re.search(said + re.escape(escape(each.own_reason)), html)


def test_b_loss_is_judged_by_its_criterion(ledger):
    claims = own_ledger(PROJECT, reference(experiment("transmission")))
    [loss] = [each for each in claims if each.claim.id == "B-LOSS"]
    assert loss.verdict.value == ledger["B-LOSS"].verdict.value == "reproduced"
    assert loss.own.verdict.value == "deviates"
    assert "22_loss" in loss.own_reason
    lines = [line for line in render(claims).splitlines() if "deviates" in line]
    assert any(line.startswith("  this run ") for line in lines)


def test_a_users_run_is_named_with_its_time(tmp_path):
    project = Project(root=tmp_path)
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "claims.yaml").write_text((DATA / "claims.yaml").read_text("utf-8"))
    log = project.runs / "logs" / "naming" / "20260102T030405-quick.mcap"
    log.parent.mkdir(parents=True)
    log.write_bytes((DATA / "reference" / "naming.mcap").read_bytes())
    [entry] = compute_ledger(project, only=["A-FQN"])
    assert entry.source == "your run of 2026-01-02 03:04 UTC"
    assert "from your run of 2026-01-02 03:04 UTC" in render([entry])

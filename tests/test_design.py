"""The tables of DESIGN.md agree with the code, the claims and the dependencies."""

import re
from pathlib import Path

from test_project import FLOORS, PYPROJECT, normal

from sfglab.lab.claims import load_claims
from sfglab.lab.experiments import EXPERIMENTS

ROOT = Path(__file__).parents[1]


def rows(heading: str) -> list[list[str]]:
    """Return the cells of the tables in a section, without their heads."""
    text = (ROOT / "DESIGN.md").read_text("utf-8")
    section = text.partition(f"# {heading}\n")[2].partition("\n#")[0]
    tables = re.findall(r"^\|(?:---\|)+\n((?:\|.*\|\n)+)", section, re.MULTILINE)
    return [line.strip("|").split("|") for table in tables for line in table.splitlines()]


def code(cell: str) -> list[str]:
    return re.findall(r"`([^`]+)`", cell)


def test_the_layers_are_those_of_the_imports():
    assert [set(code(cells[1])) for cells in rows("Layers")] == [
        set(floor) for floor in reversed(FLOORS)
    ]


def test_modules_experiments_and_claims_of_the_papers_are_there():
    named, experiments = set(), []
    for _, _, modules, experiment, claims in rows("From the papers to the code"):
        assert [name for name in code(modules) if not (ROOT / name).exists()] == []
        experiments += code(experiment)
        named |= {(claim, *code(experiment)) for claim in re.findall(r"[A-Z][A-Z0-9-]+", claims)}
    assert sorted(experiments) == sorted(EXPERIMENTS)
    ledger = load_claims(ROOT / "data" / "claims.yaml")
    judged = {(claim.id, claim.experiment) for claim in ledger}
    judged |= {(claim.id, claim.criterion.experiment) for claim in ledger if claim.criterion}
    assert named == judged


def test_every_dependency_has_a_reason():
    listed = [
        *PYPROJECT["project"]["dependencies"],
        *(d for extra in PYPROJECT["project"]["optional-dependencies"].values() for d in extra),
    ]
    declared = {re.split(r"[\[<>=]", normal(one))[0] for one in listed}
    assert {name for cells in rows("Dependencies") for name in code(cells[-2])} == declared

"""The criteria of claims do not drift: they are compared with those of an earlier version.

``tests/claims_frozen.json`` was made once. A difference needs a line ``- CLAIM, FIELD: reason`` in
``data/claims-changes.md``, written before the run that it judges.
"""

import json
import re
from pathlib import Path

from sfglab.fields import to_json
from sfglab.lab.ledger import compute_ledger
from sfglab.lab.paths import Project

ROOT = Path(__file__).parents[2]
FROZEN = json.loads((ROOT / "tests" / "claims_frozen.json").read_text("utf-8"))
CHANGES = re.findall(
    r"^- ([A-Z0-9-]+), (\w+): \S.*$",
    (ROOT / "data" / "claims-changes.md").read_text("utf-8"),
    re.MULTILINE,
)


def judged_by(entry) -> dict:
    """Return what a claim is judged by, and how many runs judge it."""
    claim = entry.claim
    return {
        "paper": claim.paper,
        "band": list(claim.band),
        "ends": to_json(claim.ends),
        "better": claim.better,
        "unit": claim.unit,
        "criterion": to_json(claim.criterion),
        "under": sorted(entry.measured.under),
        "runs": max(1, len(entry.runs)),
    }


def test_what_claims_are_judged_by_is_as_it_was_but_for_changes_with_a_reason():
    now = {
        entry.claim.id: judged_by(entry)
        for entry in compute_ledger(Project(root=ROOT), committed=True)
    }
    assert now.keys() == FROZEN.keys()
    changed = {
        (name, field)
        for name, fields in FROZEN.items()
        for field, value in fields.items()
        if now[name][field] != value
    }
    assert changed == set(CHANGES)

"""Texts follow ``book/style.md``: the number of sentences that break its rules does not grow."""

import json
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
sys.path.append(str(ROOT / "tools"))

import prose  # noqa: E402


def test_no_file_has_more_hits_than_it_had():
    """`python tools/prose.py FILE` lists them; `--update` lowers the numbers after a cleaning."""
    allowed = json.loads(prose.PENDING.read_text(encoding="utf-8"))
    grown = {}
    for name in prose.names_of():
        hits = [
            f"{text.line}: {rule}: {text.words[:80]}" for text, rule in prose.hits_of(ROOT / name)
        ]
        if len(hits) > allowed.get(name, 0):
            grown[name] = (allowed.get(name, 0), hits)
    assert grown == {}


def test_numbers_are_of_files_that_are_there():
    allowed = json.loads(prose.PENDING.read_text(encoding="utf-8"))
    assert allowed.keys() <= set(prose.names_of())


BAD = {
    "a.md": ("Who joins late gets the last one.", ["1 subject", "5 verbs"]),
    "b.md": (31 * "word " + "end.", ["13 length"]),
    "c.py": ('x = 1  #: Of the writer.\n"""Whoever\n"""', ["2 field"]),
    "d.py": ("class A:\n    x: int\n    'How deep it is.'\n", ["2 field"]),
    "e.py": ("# It is sent again, for the reader lost it, too.\n", ["9 connectives"]),
    "f.py": ("def f():\n    '''Return one line a fault.'''\n", ["3 per"]),
    "g.py": ("Option(help='Wait for ever.')\n", ["5 verbs"]),
    "h.ipynb": (
        json.dumps({"cells": [{"cell_type": "markdown", "source": ["Nobody subscribes."]}]}),
        ["5 verbs"],
    ),
    "i.ipynb": (
        json.dumps(
            {"cells": [{"cell_type": "markdown", "source": ["# It\n", "\n", "Who asks.\n"]}]}
        ),
        ["1 subject"],
    ),
}
GOOD = {
    "a.md": "A late joiner receives the last sample.\n\n```\nWho joins late\n```\n",
    "c.py": "x = 1  #: QoS of the writer; None for the default.\n",
    "e.py": "# The sample is sent again because the reader lost it.\nprint('whoever')\n",
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_sentence_is_found(name):
    source, rules = BAD[name]
    found = {rule for text in prose.texts_of(name, source) for rule in prose.broken_rules(text)}
    assert found == set(rules)


@pytest.mark.parametrize("name", GOOD)
def test_a_good_sentence_is_not(name):
    found = [rule for text in prose.texts_of(name, GOOD[name]) for rule in prose.broken_rules(text)]
    assert found == []

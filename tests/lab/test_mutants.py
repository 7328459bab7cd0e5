"""Shares of checks can fail: changes of the code under them are drawn by a seed, and seen."""

import json
from pathlib import Path

import pytest
from mutants import STORE, Judge, draw_mutants, mutation_score

from sfglab.lab.experiments import EXPERIMENTS, experiment

ROOT = Path(__file__).parents[2]
DECLARED = [(name, claim) for name in EXPERIMENTS for claim in experiment(name).mutated]


def test_mutants_are_drawn_by_the_seed_and_differ_from_the_source():
    first, again, other = (draw_mutants(["sfglab.fleet.policy"], 12, seed) for seed in (1, 1, 2))
    assert [m.diff for m in first] == [m.diff for m in again] != [m.diff for m in other]
    assert len({m.kind for m in first}) >= 4
    assert all(m.diff for m in first)
    part = draw_mutants(["sfglab.fleet.policy:TABLE_1"], 20, 0)
    assert part
    assert all(m.diff.startswith("-TABLE_1 = ") for m in part)


@pytest.fixture(scope="module")
def judge():
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("SFGLAB_ROOT", str(ROOT))
        with Judge() as judge:
            yield judge


@pytest.mark.parametrize(("name", "claim"), DECLARED)
def test_of_three_mutants_of_each_claim_as_many_are_seen_as_are_stored(name, claim, judge):
    score = mutation_score(judge, name, claim, 3)
    assert score["tried"] == 3
    stored = json.loads(STORE.read_text())[claim]  # `make mutants` has judged twenty: these are the first
    assert {one["diff"] for one in score["survived"]} <= {one["diff"] for one in stored["survived"]}
    assert all(one["why"] for one in stored["survived"])

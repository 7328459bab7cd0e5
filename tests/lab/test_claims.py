"""The ledger is complete, its file is checked, and verdicts follow from figures alone."""

import json
from dataclasses import replace

import pytest

from sfglab.documents import DocumentError
from sfglab.lab.claims import (
    Claim,
    Finding,
    How,
    Verdict,
    entry_for,
    joined,
    judge,
    load_claims,
    render,
)
from sfglab.lab.stats import Estimate


def claim(**changes) -> Claim:
    values = {"id": "X", "where": "A 1", "says": "s", "paper": 5.0, "unit": "u", "band": (4.0, 6.0)}
    return Claim(**values | {"experiment": None} | changes)


UNDECIDED = Verdict.UNDECIDED
EXACT_7 = Estimate(value=7, low=7, high=7, unit="u")


def measured(value, low=None, high=None) -> Finding:
    low, high = (value if low is None else low), (value if high is None else high)
    return Finding(estimate=Estimate(value=value, low=low, high=high, unit="u"), how=How.LIVE)


@pytest.mark.parametrize(
    ("name", "better", "figure", "verdict"),
    [
        ("X", None, (5,), Verdict.REPRODUCED),
        ("X", None, (7,), Verdict.DEVIATES),
        ("X", "above", (7, 6.5, 8), Verdict.BETTER),
        ("X", "above", (7, 5.5, 8), Verdict.REPRODUCED),  # the interval reaches into the band
        ("X", "below", (3, 2, 3.5), Verdict.BETTER),
        ("X", "below", (3, 2, 4.5), Verdict.REPRODUCED),
        ("X", "below", (7,), Verdict.DEVIATES),
        ("X-OURS", "below", (3, 2, 3.5), Verdict.BETTER),  # our way reproduces nothing
        ("X-OURS", "below", (3, 2, 4.5), Verdict.AS_GOOD),
        ("X-OURS", "below", (7,), Verdict.DEVIATES),
    ],
)
def test_verdicts_follow_from_figure_interval_band_and_whose_way_it_is(
    name, better, figure, verdict
):
    assert judge(claim(id=name, better=better), measured(*figure)) is verdict


@pytest.mark.parametrize(
    ("more", "verdict", "reason"),
    [
        ({"ends": {"e": 0.5}}, Verdict.REPRODUCED, ""),
        ({"ends": {"e": 2}}, Verdict.DEVIATES, "e: 2 (accepted: 0 to 1)"),
        ({"ends": {}}, UNDECIDED, "e: not measured"),
        ({"ends": {"e": 0.5}, "under": {"f": EXACT_7}}, UNDECIDED, "f: 7 u [7, 7], deviates"),
        ({"ends": {"e": 0.5}, "fitted": "six to seven"}, Verdict.FITTED, "six to seven"),
        ({"ends": {"e": 2}, "fitted": "six to seven"}, Verdict.DEVIATES, "e: 2 (accepted: 0 to 1)"),
    ],
)
def test_verdicts_follow_from_ends_conditions_and_fits(more, verdict, reason):
    entry = entry_for(claim(ends={"e": (0.0, 1.0)}), replace(measured(5), **more))
    assert entry.verdict is verdict
    assert entry.reason == reason


@pytest.mark.parametrize(
    ("figure", "ends", "better", "direction"),
    [
        (7, {}, "above", "favourable"),
        (7, {}, "below", "unfavourable"),
        (7, {}, None, "unfavourable"),
        (5, {"e": 2}, "above", "favourable"),
        (7, {"e": -1}, "above", "mixed"),
        (5, {"e": 0.5}, "above", ""),
    ],
)
def test_a_deviation_has_a_direction_which_the_claim_on_the_variant_tells(
    figure, ends, better, direction
):
    bounds = dict.fromkeys(ends, (0.0, 1.0))
    entry = entry_for(claim(ends=bounds), replace(measured(figure), ends=ends))
    assert replace(entry, variant_better=better).direction == direction


@pytest.mark.parametrize(
    ("values", "verdict", "figure", "reason"),
    [
        ([5, 4.5, 6], Verdict.REPRODUCED, (5, 4.5, 6), ""),
        ([5, 7], UNDECIDED, (6, 5, 7), "5.mcap: 5, reproduced; 7.mcap: 7, deviates"),
        ([7, 8, 9], Verdict.DEVIATES, (8, 7, 9), ""),
    ],
)
def test_what_runs_at_different_times_do_not_agree_on_is_undecided_and_the_interval_covers_all(
    values, verdict, figure, reason
):
    entry = joined([entry_for(claim(), measured(value), log=f"{value}.mcap") for value in values])
    ours = entry.measured.estimate
    assert (entry.verdict, (ours.value, ours.low, ours.high)) == (verdict, figure)
    assert entry.reason == reason


def test_without_a_figure_the_verdict_is_not_yet_and_the_table_counts_verdicts():
    entry = entry_for(claim(), None, log="ignored.mcap")
    assert entry.verdict is Verdict.NOT_YET
    assert (entry.as_json()["value"], entry.as_json()["log"]) == (None, None)
    found = json.loads(json.dumps(entry_for(claim(), measured(5, 4.5, 6)).as_json()))
    values = {"value": 5, "low": 4.5, "high": 6, "unit": "u", "how": "live"}
    assert found | values == found
    text = render([entry_for(claim(), measured(5)), entry_for(claim(id="Y"), None)])
    assert text.splitlines()[-1] == "ledger: 1 reproduced, 1 not yet"
    of_run = replace(entry_for(claim(), measured(5)), own=entry_for(claim(), measured(7)))
    assert "  this run" in render([of_run])


GOOD = "id: A, where: A 1, says: s, paper: 1, unit: u, band: [1, 2], experiment: null"


BAD = {
    GOOD.replace("[1, 2]", "[2, 1]"): r"band: given \[2.0, 1.0\], allowed: \[low, high\]",
    f"{GOOD}, better: up": "better: given 'up', allowed: above or below",
    f"{GOOD}, value: 1": "value: given 'value', allowed: ",  # no value of ours, and no verdict
    GOOD.replace("where: A 1", "where: own"): "where: given 'own', allowed: paper A, B or C",
    f"{GOOD}}}\n- {{{GOOD}": r"claims.yaml:2: \[1\].id: given 'A', allowed: each claim once",
}


@pytest.mark.parametrize(("entry", "message"), BAD.items())
def test_a_broken_ledger_is_refused_with_the_place(tmp_path, entry, message):
    file = tmp_path / "claims.yaml"
    file.write_text(f"- {{{entry}}}")
    with pytest.raises(DocumentError, match=message):
        load_claims(file)

"""Objects as notebooks show them: one table each, texts escaped, and a line for a terminal."""

import pytest
from made_logs import CLAIMS, reference

from sfglab.lab.claims import Ledger, entry_for
from sfglab.lab.experiments import experiment
from sfglab.qos import QoSProfile
from sfglab.tables import html_table


def shown():
    claim = CLAIMS["A-NET-RULES"]
    return [
        (
            QoSProfile(deadline_ns=10**7),
            "<QoS reliable, volatile, keep_last 10, deadline 10 ms>",
            "Samples",
        ),
        (experiment("naming").config(), "Config(samples=2000", "Random names"),
        (reference(experiment("naming")), "<run of naming: naming.mcap>", "check"),
        (Ledger([entry_for(claim, None)]), "<ledger: 1 not yet>", "share of checks"),
        (entry_for(claim, None), f"<{claim.id}, not yet: ", "share of checks"),
        (claim, claim.id, claim.unit),
    ]


@pytest.mark.parametrize(("value", "line", "inside"), shown(), ids=lambda v: type(v).__name__)
def test_it_shows_itself_as_a_line_and_as_a_table(value, line, inside):
    assert line in repr(value)
    assert inside in value._repr_html_()
    assert value._repr_html_().count("<table>") == value._repr_html_().count("</table>") > 0


def test_texts_are_escaped():
    assert "<b>" not in html_table([("a",), ("<b>",)], "<b>")

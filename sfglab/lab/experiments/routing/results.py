"""Checks of what crosses the border, the claim A-NET-RULES, and the figure."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.fleet.policy import TABLE_1
from sfglab.lab.checks import CheckRow, check_row, lowest_share, shown_checks
from sfglab.lab.checks.routing import in_table_1
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.routing.experiment import (
    GLOBAL_DOMAIN,
    Config,
    exp,
    on_the_wire,
)
from sfglab.lab.figures import COLORS, note
from sfglab.lab.runs import Run, derived
from sfglab.names import dds_topic

if TYPE_CHECKING:
    from collections.abc import Iterator

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

AGENT = "agent_1"  #: The agent whose messages the figure follows.
GROUND = "ground_1"  #: The party in the global domain whose messages the figure follows.
HEARD = "received, as Eq. 1 says"
SILENT = "not received, as Eq. 1 says"
FORBIDDEN = "received, against Eq. 1"
MISSING = "not received, against Eq. 1"
OUTCOMES = {
    HEARD: COLORS["proxy"],
    SILENT: "#ececec",
    FORBIDDEN: COLORS["standard"],
    MISSING: COLORS["fourth"],
}


STATEMENTS = {
    "an endpoint seen in the global domain is of Table 1": (
        "Each endpoint that a party in the global domain discovers there, other than those of "
        "the parties themselves, is on a topic of Table 1."
    ),
    "an endpoint seen in the global domain is a router's": (
        "Each of these endpoints belongs to a router."
    ),
    "a topic of Table 1 is heard in every other domain": (
        "A topic of Table 1 is received by each party in another domain."
    ),
    "any other topic is not heard in another domain": (
        "Any other topic is not received by a party in another domain."
    ),
    "every topic is heard in its own domain": (
        "Every topic is received by each party in the domain in which it is published."
    ),
    "every rule is seen open at every agent, both ways": (
        "Each row of Table 1 was seen to be forwarded at each agent, outward and inward."
    ),
    "a service of Table 1 answers calls from other domains": (
        "A service of Table 1 answers a call from another domain."
    ),
    "any other service does not": "Any other service does not answer such a call.",
    "a name crosses exactly if Table 1 names it, both ways": (
        "The policy forwards a name in both directions if Table 1 contains it, and in none "
        "otherwise."
    ),
    "a message is heard in the domains that Eq. 1 says": (
        "By the policy, a name of Table 1 can be received in every domain, and any other name only in "
        "the domain in which it is published (Eq. 1)."
    ),
    "a standard name crosses whole if it is global, else not at all": (
        "The policy forwards a standard name of the global scope in both directions, with all "
        "its DDS topics. It does not forward one of the local scope."
    ),
}
"""Sentence that each check states, by its name in the log."""


@derived
def passages(run: Run[Config]) -> pd.DataFrame:
    """Return one row per DDS topic, source and hearer.

    A call is a request from the caller to the server, and a reply back. The column ``call`` tells whether the row
    belongs to a call. The column ``owner`` has the party in the name of a service, otherwise the source. The column
    ``allowed`` tells whether Table 1 names the DDS topic, and ``across`` whether the domains of both parties differ.
    """
    heard = run["heard"]
    heard = heard.assign(dds_topic=heard["name"].map(dds_topic), owner=heard["source"], call="")
    tables = [heard]
    calls = run["call"]
    for place, call in enumerate(("request", "reply")):
        source, hearer = ("caller", "server") if call == "request" else ("server", "caller")
        table = calls.assign(
            dds_topic=[on_the_wire(name)[place] for name in calls["name"]],
            source=calls[source],
            hearer=calls[hearer],
            owner=calls["server"],
            received=calls["answered"].astype(int),
            call=call,
        )
        tables.append(table)
    every = pd.concat(tables, join="inner", ignore_index=True)
    domains = run["party"].set_index("party")["domain"]
    every["domain"] = every["hearer"].map(domains)
    label = every["dds_topic"].where(every["call"] == "", every["name"])
    return every.assign(
        across=every["source"].map(domains) != every["domain"],
        allowed=every["dds_topic"].map(in_table_1),
        case=label + ": " + every["source"] + ", " + every["hearer"],
    )


@derived
def checks(run: Run[Config]) -> pd.DataFrame:
    """Return all checks: ``how``, exact or live, and the fields of `CheckRow`."""
    live = pd.DataFrame([{"how": How.LIVE.value, **asdict(row)} for row in _live(run)])
    exact = run["policy"].assign(how=How.EXACT.value)
    columns = ["check", "how", "checked", "held", "example"]
    return pd.concat([live, exact], ignore_index=True)[columns]


def check_table(run: Run[Config]) -> pd.DataFrame:
    """Return `checks` with the sentence that each states."""
    return shown_checks(checks(run), STATEMENTS)


def _live(run: Run[Config]) -> Iterator[CheckRow]:
    seen = run["endpoint"]
    seen = seen.assign(case=seen["dds_topic"] + ": " + seen["seen_by"] + ", " + seen["kind"])
    is_named = seen["dds_topic"].map(in_table_1)
    yield _check("an endpoint seen in the global domain is of Table 1", seen, is_named)
    yield _check("an endpoint seen in the global domain is a router's", seen, seen["router"] != "")
    every = passages(run)
    topics = every[every["call"] == ""]
    # An answer shows that request and reply arrived.
    calls = every[(every["call"] == "request") & every["across"]]
    inside = topics[~topics["across"]]
    named = topics[topics["across"] & topics["allowed"]]
    others = topics[topics["across"] & ~topics["allowed"]]
    yield _check("a topic of Table 1 is heard in every other domain", named, named["received"] > 0)
    yield _check("any other topic is not heard in another domain", others, others["received"] == 0)
    yield _check("every topic is heard in its own domain", inside, inside["received"] > 0)
    yield _rules_check(run)
    named = calls[calls["allowed"]]
    others = calls[~calls["allowed"]]
    yield _check(
        "a service of Table 1 answers calls from other domains", named, named["received"] > 0
    )
    yield _check("any other service does not", others, others["received"] == 0)


def _check(name: str, rows: pd.DataFrame, holds: pd.Series[bool]) -> CheckRow:
    return check_row(name, zip(rows["case"], holds.astype(bool), strict=True))


def _rules_check(run: Run[Config]) -> CheckRow:
    """Check that at every agent messages of every row of Table 1 passed in both directions."""
    crossed = passages(run)
    crossed = crossed[crossed["across"] & (crossed["received"] > 0)]
    parties = run["party"]
    agents = parties.loc[parties["domain"] != GLOBAL_DOMAIN, "party"]
    cases = []
    for rule in TABLE_1:
        matched = crossed[crossed["dds_topic"].map(rule.matches)]
        for agent in agents:
            cases.append((f"{rule.pattern}, {agent}, out", agent in set(matched["source"])))
            cases.append((f"{rule.pattern}, {agent}, in", agent in set(matched["hearer"])))
    return check_row("every rule is seen open at every agent, both ways", cases)


@exp.claim("A-NET-RULES", how=How.LIVE, also=How.EXACT)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of checks that hold, of live and exact ones whichever is lower."""
    share = lowest_share(checks(run), "how")
    details = {f"{group} checks": held for group, held in share.groups.items()}
    return Finding(estimate=share.estimate, details=details, reason=share.reason)


@derived
def reached(run: Run[Config], source: str) -> pd.DataFrame:
    """Return the domains that the messages, requests and replies of one party reached.

    Returns:
        One row per DDS topic and domain: ``name`` with ``<agent>`` for the party, ``domain``, and
        ``outcome``, by whether at least one message arrived or call was answered.
    """
    table = passages(run)
    own = table[table["source"] == source]
    pairs = zip(own["dds_topic"], own["owner"], strict=True)
    names = [topic.replace(owner, "<agent>") for topic, owner in pairs]
    by_place = own.assign(name=names).groupby(["name", "domain", "across"], sort=False)
    found = by_place["received"].sum().reset_index()
    allowed = found["name"].map(in_table_1) | ~found["across"]
    arrived = found["received"] > 0
    outcome = np.select([arrived & allowed, arrived, allowed], [HEARD, FORBIDDEN, MISSING], SILENT)
    return found.assign(outcome=outcome)


@exp.figure("routing_border", size=(10, 8))
def draw_border(figure: Figure, run: Run[Config]) -> None:
    """Draw the domains that receive each DDS topic: those of an agent (left) and of the global domain (right)."""
    panels = {source: reached(run, source) for source in (AGENT, GROUND)}
    names = sorted(set().union(*(panel["name"] for panel in panels.values())), key=_order)
    domains = sorted(run["party"]["domain"].unique())
    others = [domain for domain in domains if domain > 1]
    left, right = figure.subplots(1, 2, sharey=True)
    _draw_matrix(left, panels[AGENT], names, [1, GLOBAL_DOMAIN, *others])
    _draw_matrix(right, panels[GROUND], names, domains)
    left.set_title("Published in an agent's domain, $D_1$", fontsize=10)
    right.set_title("Published in the global domain, $D_0$", fontsize=10)
    of_table = sum(map(in_table_1, names))
    side: dict[str, Any] = {"rotation": 270, "va": "center", "fontsize": 9}
    right.text(len(domains) - 0.45, of_table / 2 - 0.5, "names of Table 1", **side)
    right.text(len(domains) - 0.45, (of_table + len(names)) / 2, "other names", **side)
    shown = {*panels[AGENT]["outcome"], *panels[GROUND]["outcome"]}
    for outcome, color in OUTCOMES.items():
        if outcome in shown:
            left.bar(0, 0, color=color, label=outcome)
    figure.legend(loc="outside lower right", ncols=len(shown), fontsize=9)
    live = checks(run).query("how == @How.LIVE.value")
    figure.suptitle(
        f"Names of Table 1 cross the domain boundary, no others: {live['held'].sum():,} of "
        f"{live['checked'].sum():,} live cases hold"
    )
    note(figure, "live; white: not tested")


def _order(name: str) -> tuple[bool, int, str]:
    """Return a key that sorts names by their row of Table 1; names without a row come last."""
    rows = [i for i, rule in enumerate(TABLE_1) if rule.matches(name)]
    return not rows, rows[0] if rows else 0, name


def _draw_matrix(axes: Axes, cells: pd.DataFrame, names: list[str], domains: list[int]) -> None:
    """Draw where each name was heard; the first column is the publisher's own domain."""
    x, y = cells["domain"].map(domains.index), cells["name"].map(names.index)
    axes.barh(y, 0.88, 0.84, left=x - 0.44, color=cells["outcome"].map(OUTCOMES))
    axes.axhline(sum(map(in_table_1, names)) - 0.5, color="black", linewidth=1)
    axes.axvline(0.5, color="black", linewidth=1, linestyle=":")
    axes.set_xticks(range(len(domains)), [f"$D_{domain}$" for domain in domains])
    axes.set_xlabel("domain of the subscriber or server")
    axes.set_yticks(range(len(names)), names, fontsize=8, family="monospace")
    axes.set(xlim=(-0.5, len(domains) - 0.5), ylim=(len(names) - 0.5, -0.5))
    axes.tick_params(length=0)
    axes.grid(visible=False)

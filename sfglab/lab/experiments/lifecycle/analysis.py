"""From the log to the claims: what heartbeats were like, and which transitions were taken.

Everything here is computed from the log alone, and from the table that the discoverer follows.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.fleet.discovery.lifecycle import ANNOUNCEMENTS, TRANSITIONS, Action, Input, State
from sfglab.lab.claims import How, Measured
from sfglab.lab.experiments.lifecycle.beats import heartbeat_checks, intervals
from sfglab.lab.experiments.lifecycle.results import load_results
from sfglab.lab.stats import Estimate, median_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import pandas as pd

    from sfglab.lab.experiments.lifecycle.results import Results


WALKER = "walker"
"""The agent whose status process is a real one; all others are false agents."""

_ENDS = {Input.ANSWERED.name, Input.ANSWERED_ANEW.name, Input.FAILED.name}
# A request may arrive after its query was given up: Cyclone repeats it for one more second.
_ON_ITS_WAY_NS = 1_250_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Transitions:
    """The table's transitions and how often each was taken."""

    #: How often, by (state, input); every transition of the table is there.
    taken: dict[tuple[State, Input], int]
    strange: int  #: Transitions of the log that the table does not have, or has otherwise.
    queries: int  #: How many queries arrived at false agents.
    doubled: int  #: How many of them arrived while an earlier one to the same agent was outstanding.
    announced: dict[str, int]  #: Discovery events that the transitions say were published, by name.

    @property
    def reached(self) -> float:
        """Share of the table's transitions that were taken."""
        return sum(count > 0 for count in self.taken.values()) / len(self.taken)


def transitions(results: Results) -> Transitions:
    """Count the transitions that the discoverers took and compare each with the table."""
    taken: Counter[tuple[State, Input]] = Counter()
    announced: Counter[str] = Counter()
    strange = 0
    for before, given, after, actions in results.moves[["before", "given", "after", "actions"]].to_numpy():
        key = (State[before], Input[given])
        done = tuple(Action[name] for name in actions.split(";") if name)
        announced.update(action.name for action in done if action in ANNOUNCEMENTS)
        if TRANSITIONS.get(key) == (State[after], done):
            taken[key] += 1
        else:
            strange += 1
    return Transitions(
        taken={key: taken[key] for key in TRANSITIONS},
        strange=strange,
        queries=len(results.queries),
        doubled=_doubled(results),
        announced=dict(sorted(announced.items())),
    )


def _taken_by(results: Results, agent: str) -> int:
    moves = results.moves[results.moves["agent"] == agent]
    return len(moves[["before", "given"]].drop_duplicates())


def _doubled(results: Results) -> int:
    """Count queries that arrived at an agent beyond the one that its discoverer had outstanding."""
    doubled = 0
    for agent, arrived in results.queries.groupby("agent")["t_ns"]:
        moves = results.moves[results.moves["agent"] == agent].sort_values("t_ns")
        doubled += _homeless(sorted(arrived), _outstanding(moves))
    return doubled


def _outstanding(moves: pd.DataFrame) -> list[tuple[int, int]]:
    """Return when each query to one agent was asked and when it ended, which may be never."""
    spans: list[tuple[int, int]] = []
    asked_ns: int | None = None
    for given, actions, t_ns in moves[["given", "actions", "t_ns"]].to_numpy():
        done = actions.split(";")
        if asked_ns is not None and (given in _ENDS or Action.ABANDON.name in done):
            spans.append((asked_ns, t_ns))
            asked_ns = None
        if Action.QUERY.name in done:
            asked_ns = t_ns
    return spans if asked_ns is None else [*spans, (asked_ns, 2**62)]


def _homeless(arrivals: Sequence[int], spans: list[tuple[int, int]]) -> int:
    """Count the arrivals that no span is left for; each takes one, at its end one that is on its way."""
    left = sorted(spans, key=lambda span: span[1])
    homeless = 0
    for t_ns in arrivals:
        home = next((span for span in left if span[0] <= t_ns <= span[1] + _ON_ITS_WAY_NS), None)
        if home is None:
            homeless += 1
        else:
            left.remove(home)
    return homeless


def measure_claims(log: Path) -> dict[str, Measured]:
    """Return our figures for the claims that this experiment answers, by claim id.

    Heartbeats at other periods than the paper's, as the shortest profile has them, say nothing about its claim.
    """
    results = load_results(log)
    claims = {"A-DFA": _dfa_claim(results)}
    if results.at_paper_periods:
        claims["A-HEARTBEAT"] = _heartbeat_claim(results)
    return claims


def _heartbeat_claim(results: Results) -> Measured:
    checks, table = heartbeat_checks(results), intervals(results)
    share = float(np.mean([check.held for check in checks]))
    details = {
        "hosts": str(results.hosts["description"]),
        "checks": f"{sum(check.held for check in checks)} of {len(checks)}",
        "tolerance of periods": f"{100 * results.config['tolerance']:g} % (medians per agent)",
        "start-up period": str(median_of(table.loc[table["phase"] == 0, "gap_s"].to_numpy(), unit="s")),
        "steady period": str(median_of(table.loc[table["phase"] == 1, "gap_s"].to_numpy(), unit="s")),
        "start-up phase": f"{results.config['schedule']['startup_s']:g} s; the paper states no length",
        "heartbeats": str(len(results.beats)),
        "path": "through each agent's router" if results.config["routed"] else "without routers",
    }
    failed = "; ".join(f"{c.agent}: {c.what}: {c.seen}" for c in checks if not c.held)
    estimate = Estimate(value=share, low=share, high=share, unit="share of checks that hold")
    return Measured(estimate=estimate, how=How.LIVE, details=details, reason=failed)


def _dfa_claim(results: Results) -> Measured:
    """Return the share of transitions reached; none counts when a second query was ever outstanding."""
    found = transitions(results)
    share = 0.0 if found.doubled or found.strange else found.reached
    missing = [f"{s.name} on {i.name}" for (s, i), count in found.taken.items() if not count]
    details = {
        "hosts": str(results.hosts["description"]),
        "transitions": f"{sum(c > 0 for c in found.taken.values())} of {len(found.taken)}, taken "
        f"{sum(found.taken.values())} times",
        "by a real process, stopped, killed and started": f"{_taken_by(results, WALKER)} of them",
        "queries at false agents": f"{found.queries}, of these second ones at a time: {found.doubled}",
        "discovery events on the wire": str(results.events),
        "not as in the table": str(found.strange),
        "waits": "shortened: a second and less where the default is up to ten minutes",
    }
    reasons = [f"not reached: {', '.join(missing)}"] if missing else []
    reasons += [f"{found.doubled} queries while one was outstanding"] if found.doubled else []
    estimate = Estimate(value=share, low=share, high=share, unit="share of transitions reached live")
    return Measured(estimate=estimate, how=How.LIVE, details=details, reason="; ".join(reasons))

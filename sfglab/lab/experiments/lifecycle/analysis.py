"""From the log to the claims: what heartbeats were like, and which transitions were taken.

Everything is computed from the log alone, and from rules that are written apart from the discoverer's table.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from sfglab.fleet.discovery.lifecycle import (
    ANNOUNCEMENTS,
    STATED,
    TRANSITIONS,
    Action,
    Input,
    State,
)
from sfglab.fleet.discovery.listener import DISCOVERY_EVENT
from sfglab.lab.checks import lifecycle
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.lifecycle.experiment import Config, exp
from sfglab.lab.experiments.lifecycle.stage import WALKER
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import exactly, median_of
from sfglab.messages import message_type
from sfglab.record import LogReader
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import pandas as pd

PAPER_TOPIC = "/global/agent_heartbeat"
PAPER_SERVICE = "/global/{agent}/get_metadata"  #: As paper A, section 4.2 prints them.

HEARTBEAT_TYPE = "sfglab_interfaces/msg/AgentHeartbeat"
#: A late listener that hears within this time has not waited for the next heartbeat.
AT_ONCE_S = 1.0


@derived
def heard(run: Run[Config], listener: str = "") -> pd.DataFrame:
    """Return the heartbeats of the first part's agents as one listener, or each, received them, in order."""
    beats = run["beat"]
    known = beats["agent"].isin(run["answer"]["agent"])
    return beats[known & (beats["listener"] == listener) if listener else known].sort_values(
        "received_ns"
    )


def joined_ns(run: Run[Config]) -> int:
    """Return when the late listener joined, nanoseconds since the epoch."""
    joins = run["join"]
    return int(joins.loc[joins["listener"] == "late", "t_ns"].iloc[0])


@derived
def intervals(run: Run[Config]) -> pd.DataFrame:
    """Return the time from each heartbeat to the next, as the listener on another host received them.

    Returns:
        One line a heartbeat but each agent's last: ``agent``, ``phase``, ``period_s`` as announced,
        ``since_s`` from that agent's first heartbeat, and ``gap_s`` to its next one.
    """
    beats = heard(run, "first")
    by_agent = beats.groupby("agent", sort=True)["received_ns"]
    table = beats.assign(
        gap_s=(by_agent.shift(-1) - beats["received_ns"]) / NS_PER_S,
        since_s=(beats["received_ns"] - by_agent.transform("first")) / NS_PER_S,
    )
    columns = ["agent", "phase", "period_s", "since_s", "gap_s"]
    return (
        table.dropna(subset=["gap_s"])[columns]
        .sort_values(["agent", "since_s"])
        .reset_index(drop=True)
    )


@dataclass(frozen=True, slots=True)
class Check:
    """Something that the paper states of heartbeats, and whether it was so."""

    what: str  #: The statement.
    agent: str  #: Of which agent; empty: of all.
    held: bool  #: Whether it was so.
    seen: str  #: What was seen.


@derived
def heartbeat_checks(run: Run[Config]) -> list[Check]:
    """Check what section 4.2 states, agent by agent."""
    found = [_topic_check(run)]
    table = intervals(run)
    for agent in sorted(run["answer"]["agent"]):
        found += _period_checks(run, table[table["agent"] == agent], agent)
        found += [_phase_check(run, agent), _late_check(run, agent), _service_check(run, agent)]
    return found


def _topic_check(run: Run[Config]) -> Check:
    ends = run["endpoint"]
    kinds = set(
        map(tuple, ends[["topic", "type", "reliability", "durability"]].to_numpy().tolist())
    )
    agents = len(run["answer"])
    held = (
        kinds == {(PAPER_TOPIC, HEARTBEAT_TYPE, "reliable", "transient_local")}
        and len(ends) == agents
    )
    seen = f"{len(ends)} publishers of {agents} agents: {sorted(kinds)}"
    return Check("one publisher per agent on the paper's topic, latched", "", held, seen)


def _period_checks(run: Run[Config], table: pd.DataFrame, agent: str) -> Iterator[Check]:
    schedule, tolerance = run.config.schedule, run.config.tolerance
    within = f"within {100 * tolerance:g} %"
    periods = (("startup", schedule.startup_period_s), ("steady", schedule.steady_period_s))
    for phase, (name, stated) in enumerate(periods):
        median = float(table.loc[table["phase"] == phase, "gap_s"].median())
        held = abs(median - stated) <= tolerance * stated
        yield Check(
            f"median {name} period {within} of {stated:g} s", agent, held, f"{median:.4f} s"
        )
    error = float(((table["gap_s"] - table["period_s"]).abs() / table["gap_s"]).median())
    seen = f"median error {100 * error:.2f} %"
    yield Check(
        f"announced time until the next heartbeat {within}", agent, error <= tolerance, seen
    )


def _phase_check(run: Run[Config], agent: str) -> Check:
    """Check that there are as many start-up heartbeats as periods fit, and none after the first steady one."""
    beats, schedule = heard(run, "first").sort_values("sent_ns"), run.config.schedule
    phases = beats.loc[beats["agent"] == agent, "phase"].to_numpy()
    expected = int(np.ceil(schedule.startup_s / schedule.startup_period_s))
    held = int((phases == 0).sum()) == expected and bool((np.diff(phases) >= 0).all())
    seen = "".join(str(int(phase)) for phase in phases)
    return Check(
        f"{expected} heartbeats of the start-up phase, then the steady state", agent, held, seen
    )


def _late_check(run: Run[Config], agent: str) -> Check:
    """Check that a listener that joins between two heartbeats hears the last one without waiting."""
    what = "heard at once by who joins late"
    late = heard(run, "late")
    late = late[late["agent"] == agent]
    if late.empty:
        return Check(what, agent, held=False, seen="never heard")
    first, late_ns = late.iloc[0], joined_ns(run)
    after_s = (first["received_ns"] - late_ns) / NS_PER_S
    age_s = (late_ns - first["sent_ns"]) / NS_PER_S
    held = bool(after_s <= min(AT_ONCE_S, 0.5 * run.config.schedule.steady_period_s) and age_s > 0)
    return Check(what, agent, held, f"after {after_s:.3f} s, sent {age_s:.2f} s before it joined")


def _service_check(run: Run[Config], agent: str) -> Check:
    answer, beats = run["answer"].set_index("agent").loc[agent], heard(run)
    incarnations = set(beats.loc[beats["agent"] == agent, "incarnation"])
    named = answer["service"] == PAPER_SERVICE.format(agent=agent)
    held = bool(answer["answered"] and named and incarnations == {answer["incarnation"]})
    seen = f"{answer['service']} after {answer['took_s']:.3f} s"
    return Check("the paper's service answers with the same start of the agent", agent, held, seen)


# --- Transitions ----------------------------------------------------------------------------------------------

_ENDS = {Input.ANSWERED.name, Input.ANSWERED_ANEW.name, Input.FAILED.name}
# A request may arrive after its query was given up: Cyclone repeats it for one more second.
_ON_ITS_WAY_NS = 1_250_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class Transitions:
    """The table's transitions and how often each was taken."""

    #: How often each transition of the table, by (state, input).
    taken: dict[tuple[State, Input], int]
    #: Moves that the rules have otherwise, or that begin where the agent did not stand.
    strange: int
    queries: int  #: How many queries arrived at false agents.
    #: How many of them arrived while an earlier one to the same agent was outstanding.
    doubled: int
    announced: dict[str, int]  #: Discovery events that the transitions say were published, by name.

    @property
    def reached(self) -> float:
        """Share of the table's transitions that were taken."""
        return float(np.mean([count > 0 for count in self.taken.values()]))


@derived
def events(run: Run[Config]) -> dict[str, int]:
    """Return how many discovery events of each name a listener heard on the wire."""
    with LogReader(run.log) as reader:
        topics = [topic for topic in reader.topics if topic.endswith("/agent_discovery_event")]
        kinds = Counter(entry.message.event for topic in topics for entry in reader.decoded(topic))
    names = {
        getattr(message_type(DISCOVERY_EVENT), action.name): action.name for action in ANNOUNCEMENTS
    }
    return {names[kind]: count for kind, count in sorted(kinds.items())}


@derived
def transitions(run: Run[Config]) -> Transitions:
    """Count the transitions that the discoverers took and compare each with the rules, not with their table."""
    taken: Counter[tuple[State, Input]] = Counter()
    announced: Counter[str] = Counter()
    strange = 0
    stands: dict[tuple[str, str], str] = {}
    columns = ["discoverer", "agent", "before", "given", "after", "actions"]
    for by, agent, before, given, after, actions in run["move"][columns].to_numpy():
        key, stood = (State[before], Input[given]), stands.get((by, agent), State.UNKNOWN.name)
        stands[by, agent] = after
        done = tuple(Action[name] for name in actions.split(";") if name)
        announced.update(action.name for action in done if action in ANNOUNCEMENTS)
        if stood == before and lifecycle.ruled(*key) == (State[after], done):
            taken[key] += 1
        else:
            strange += 1
    return Transitions(
        taken={key: taken[key] for key in TRANSITIONS},
        strange=strange,
        queries=len(run["query"]),
        doubled=_doubled(run),
        announced=dict(sorted(announced.items())),
    )


def _doubled(run: Run[Config]) -> int:
    """Count queries that arrived at an agent beyond the one that its discoverer had outstanding."""
    moves, queries = run["move"].sort_values("t_ns"), run["query"].groupby("agent")["t_ns"]
    return sum(
        _homeless(sorted(t), _outstanding(moves[moves["agent"] == agent])) for agent, t in queries
    )


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
    for t_ns in arrivals:
        home = next((span for span in left if span[0] <= t_ns <= span[1] + _ON_ITS_WAY_NS), None)
        if home:
            left.remove(home)
    return len(arrivals) - len(spans) + len(left)


@exp.claim("A-HEARTBEAT", how=How.LIVE)
def claim_heartbeats(run: Run[Config]) -> Finding | None:
    """Return the share of checks that hold; periods other than the paper's, as `smoke` has, answer nothing."""
    if not run.config.at_paper_periods:
        return None
    checks, table = heartbeat_checks(run), intervals(run)
    share = float(np.mean([check.held for check in checks]))
    details = {
        "hosts": str(run.metadata("hosts")["description"]),
        "checks": f"{sum(check.held for check in checks)} of {len(checks)}",
        "tolerance of periods": f"{100 * run.config.tolerance:g} % (medians per agent)",
        "start-up period": str(
            median_of(table.loc[table["phase"] == 0, "gap_s"].to_numpy(), unit="s")
        ),
        "steady period": str(
            median_of(table.loc[table["phase"] == 1, "gap_s"].to_numpy(), unit="s")
        ),
        "start-up phase": f"{run.config.schedule.startup_s:g} s; the paper states no length",
        "heartbeats": str(len(heard(run))),
        "path": "through each agent's router" if run.config.routed else "without routers",
    }
    failed = "; ".join(f"{c.agent}: {c.what}: {c.seen}" for c in checks if not c.held)
    return Finding(
        estimate=exactly(share, "share of checks that hold"), details=details, reason=failed
    )


@exp.claim("A-DFA", how=How.LIVE)
def claim_transitions(run: Run[Config]) -> Finding:
    """Return the share of the paper's transitions that were reached.

    None counts when a move broke the rules, a second query was outstanding, or an event was not on the wire.
    """
    found, heard_events = transitions(run), events(run)
    silent = sum(heard_events.get(name) != count for name, count in found.announced.items())
    wrong = {
        "moves against the rules": found.strange,
        "queries while one was outstanding": found.doubled,
        "kinds of events that were not on the wire as often as announced": silent,
    }
    moves = run["move"]
    walked = moves.loc[moves["agent"] == WALKER, ["before", "given"]].drop_duplicates()
    missing = [f"{s.name} on {i.name}" for s, i in STATED if not found.taken[s, i]]
    ours = [count for key, count in found.taken.items() if key not in STATED]
    stated = [
        f"{s.name} on {i.name} x {found.taken[s, i]} ({why!r})" for (s, i), why in STATED.items()
    ]
    details = {
        "hosts": str(run.metadata("hosts")["description"]),
        "stated by the paper's words": ", ".join(stated),
        "ours beside them": f"{sum(count > 0 for count in ours)} of {len(ours)} transitions",
        "by a real process, stopped, killed and started": f"{len(walked)} transitions",
        "queries at false agents": f"{found.queries}, of these second ones at a time: {found.doubled}",
        "discovery events on the wire": str(heard_events),
        "not as the rules have it": str(found.strange),
        "waits": "shortened: a second and less where the default is up to ten minutes",
    }
    reasons = [f"not reached: {', '.join(missing)}"] if missing else []
    reasons += [f"{count} {what}" for what, count in wrong.items() if count]
    share = 0.0 if any(wrong.values()) else 1 - len(missing) / len(STATED)
    estimate = exactly(share, "share of stated transitions reached live")
    return Finding(estimate=estimate, details=details, reason="; ".join(reasons))

"""Checks of heartbeats, transitions that were taken, the claims A-HEARTBEAT and A-DFA, and figures.

Everything is computed from the log, and from rules that are written apart from the discoverer's table.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from itertools import groupby
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

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
from sfglab.lab.experiments.lifecycle.states import draw_run, draw_to_press
from sfglab.lab.explore import Automaton
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import exactly, median_of
from sfglab.messages import message_type
from sfglab.record import LogReader
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from matplotlib.figure import Figure

TOPIC = "/global/agent_heartbeat"
SERVICE = "/global/{agent}/get_metadata"
"""Names as paper A, section 4.2 prints them."""
HEARTBEAT_TYPE = "sfglab_interfaces/msg/AgentHeartbeat"
OFFERED = (TOPIC, HEARTBEAT_TYPE, "reliable", "transient_local")
#: A late joiner that receives within this time has not waited for the next heartbeat.
AT_ONCE_S = 1.0
PHASES = ("start-up", "steady state")


# --- Heartbeats -------------------------------------------------------------------------------


@derived
def beats_of(run: Run[Config], listener: str) -> pd.DataFrame:
    """Return the heartbeats of the agents that were timed, as a listener received them, in order."""
    table = run["beat"]
    is_timed = table["agent"].isin(run["answer"]["agent"])
    return table[is_timed & (table["listener"] == listener)].sort_values("received_ns")


@derived
def intervals(run: Run[Config]) -> pd.DataFrame:
    """Return the time from each heartbeat to the next, as the listener on another host received them.

    Returns:
        One row per heartbeat except each agent's last: ``agent``, ``phase``, the announced
        ``period_s``, the time ``since_s`` since the agent's first heartbeat, and ``gap_s``, the
        time until its next one.
    """
    beats = beats_of(run, "first")
    received = beats.groupby("agent")["received_ns"]
    table = beats.assign(
        gap_s=(received.shift(-1) - beats["received_ns"]) / NS_PER_S,
        since_s=(beats["received_ns"] - received.transform("first")) / NS_PER_S,
    )
    table = table.dropna(subset=["gap_s"]).sort_values(["agent", "since_s"], ignore_index=True)
    return table[["agent", "phase", "period_s", "since_s", "gap_s"]]


def joined_ns(run: Run[Config]) -> int:
    """Return the time at which the late listener joined, ns since the epoch."""
    joins = run["join"]
    return int(joins.loc[joins["listener"] == "late", "t_ns"].iloc[0])


@dataclass(frozen=True, slots=True)
class Check:
    """A statement of the paper about heartbeats, and whether it held."""

    what: str  #: The statement.
    agent: str  #: Agent that was checked; empty: all of them.
    held: bool  #: Whether the statement held.
    seen: str  #: Observed values, as text.


@derived
def heartbeat_checks(run: Run[Config]) -> list[Check]:
    """Check the statements of section 4.2, agent by agent."""
    checks = [check_topic(run)]
    for agent in sorted(run["answer"]["agent"]):
        checks += check_periods(run, agent)
        checks += [check_phases(run, agent), check_late(run, agent), check_service(run, agent)]
    return checks


def heartbeat_table(run: Run[Config]) -> pd.DataFrame:
    """Return the checks as a table for readers."""
    rows = [
        (each.agent or "all", each.what, "yes" if each.held else "no", each.seen)
        for each in heartbeat_checks(run)
    ]
    return pd.DataFrame(rows, columns=["agent", "check", "holds", "observed"])


def check_topic(run: Run[Config]) -> Check:
    """Check that each agent has one latched publisher on the paper's topic."""
    agents = len(run["answer"])
    table = run["endpoint"][["topic", "type", "reliability", "durability"]]
    offered = [tuple(row) for row in table.to_numpy().tolist()]
    kinds = "; ".join(", ".join(each) for each in sorted(set(offered)))
    seen = f"{len(offered)} publishers of {agents} agents: {kinds}"
    held = offered == [OFFERED] * agents
    return Check("one publisher per agent on the paper's topic, transient local", "", held, seen)


def check_periods(run: Run[Config], agent: str) -> Iterator[Check]:
    """Check the median intervals of both phases, and the announced times."""
    schedule, tolerance = run.config.schedule, run.config.tolerance
    table = intervals(run)
    table = table[table["agent"] == agent]
    within = f"within {100 * tolerance:g} %"
    periods = (("startup", schedule.startup_period_s), ("steady", schedule.steady_period_s))
    for phase, (name, stated) in enumerate(periods):
        median = float(table.loc[table["phase"] == phase, "gap_s"].median())
        what = f"median {name} period {within} of {stated:g} s"
        held = abs(median - stated) <= tolerance * stated
        yield Check(what, agent, held, f"{median:.4f} s")
    error = float(((table["gap_s"] - table["period_s"]).abs() / table["gap_s"]).median())
    what = f"announced time until the next heartbeat {within}"
    yield Check(what, agent, error <= tolerance, f"median error {100 * error:.2f} %")


def check_phases(run: Run[Config], agent: str) -> Check:
    """Check the number of start-up heartbeats, and that none comes after the first steady one."""
    schedule = run.config.schedule
    beats = beats_of(run, "first").sort_values("sent_ns")
    phases = beats.loc[beats["agent"] == agent, "phase"].tolist()
    expected = int(np.ceil(schedule.startup_s / schedule.startup_period_s))
    held = phases == sorted(phases) and phases.count(0) == expected
    what = f"{expected} heartbeats of the start-up phase, then the steady state"
    counts = [f"{len([*same])} in the {PHASES[phase]}" for phase, same in groupby(phases)]
    return Check(what, agent, held, ", then ".join(counts))


def check_late(run: Run[Config], agent: str) -> Check:
    """Check that a listener that joins between two heartbeats receives the last one without waiting."""
    limit_s = min(AT_ONCE_S, 0.5 * run.config.schedule.steady_period_s)
    what = f"a late joiner receives the last heartbeat within {limit_s:g} s of joining"
    beats = beats_of(run, "late")
    beats = beats[beats["agent"] == agent]
    if beats.empty:
        return Check(what, agent, held=False, seen="none was received")
    first = beats.iloc[0]
    after_s = (first["received_ns"] - joined_ns(run)) / NS_PER_S
    age_s = (joined_ns(run) - first["sent_ns"]) / NS_PER_S
    held = bool(after_s <= limit_s and age_s > 0)
    return Check(what, agent, held, f"after {after_s:.3f} s, sent {age_s:.2f} s before it joined")


def check_service(run: Run[Config], agent: str) -> Check:
    """Check that the paper's service answers, and describes the start that sends the heartbeats."""
    answer = run["answer"].set_index("agent").loc[agent]
    beats = pd.concat([beats_of(run, "first"), beats_of(run, "late")])
    incarnations = set(beats.loc[beats["agent"] == agent, "incarnation"])
    is_named = answer["service"] == SERVICE.format(agent=agent)
    held = bool(answer["answered"] and is_named and incarnations == {answer["incarnation"]})
    what = "the paper's service answers, for the process that sends the heartbeats"
    return Check(what, agent, held, f"{answer['service']} after {answer['took_s']:.3f} s")


@exp.claim("A-HEARTBEAT", how=How.LIVE)
def paper_heartbeats(run: Run[Config]) -> Finding | None:
    """Return the share of checks that hold; None at other periods than the paper's."""
    if not run.config.at_paper_periods:
        return None
    checks = heartbeat_checks(run)
    gaps = intervals(run).groupby("phase")["gap_s"]
    medians = {phase: str(median_of(values.to_numpy(), unit="s")) for phase, values in gaps}
    details = {
        "hosts": str(run.metadata("hosts")["description"]),
        "start-up period": medians[0],
        "steady period": medians[1],
    }
    failed = [f"{each.agent}: {each.what}: {each.seen}" for each in checks if not each.held]
    share = 1 - len(failed) / len(checks)
    estimate = exactly(share, "share of checks that hold")
    return Finding(estimate=estimate, details=details, reason="; ".join(failed))


# --- Transitions ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Transitions:
    """The transitions of the table, and how often each was taken."""

    taken: dict[tuple[State, Input], int]  #: Number by state and input.
    #: Moves that break a rule, or do not begin in the state in which the agent was.
    strange: int
    sent: int  #: Queries that discoverers sent.
    queries: int  #: Queries that arrived at made-up agents.
    #: Those that arrived beyond the queries that had been sent to their agent by then.
    doubled: int
    announced: dict[str, int]  #: Number of discovery events by the moves' actions, by name.

    @property
    def reached(self) -> float:
        """Share of the table's transitions that were taken."""
        return float(np.mean([count > 0 for count in self.taken.values()]))


@derived
def transitions(run: Run[Config]) -> Transitions:
    """Count the transitions that were taken; each is compared with the rules, not with the table."""
    taken: Counter[tuple[State, Input]] = Counter()
    announced: Counter[str] = Counter()
    states: dict[tuple[str, str], str] = {}
    strange = sent = 0
    for move in lines_of(run["move"]):
        key = (State[move.before], Input[move.given])
        actions = tuple(Action[name] for name in move.actions.split(";") if name)
        announced.update(action.name for action in actions if action in ANNOUNCEMENTS)
        sent += Action.QUERY in actions
        known = states.get((move.discoverer, move.agent), State.UNKNOWN.name)
        states[move.discoverer, move.agent] = move.after
        if known == move.before and lifecycle.ruled(*key) == (State[move.after], actions):
            taken[key] += 1
        else:
            strange += 1
    return Transitions(
        taken={key: taken[key] for key in TRANSITIONS},
        strange=strange,
        sent=sent,
        queries=len(run["query"]),
        doubled=doubled_queries(run),
        announced=dict(sorted(announced.items())),
    )


def doubled_queries(run: Run[Config]) -> int:
    """Return the number of queries that arrived beyond those that had been sent to their agent by then.

    By the rules a discoverer sends no query while one is outstanding.
    """
    moves = run["move"].sort_values("t_ns")
    sending = moves["actions"].str.split(";").map(lambda actions: Action.QUERY.name in actions)
    doubled = 0
    for agent, arrivals in run["query"].groupby("agent")["t_ns"]:
        sent_ns = moves.loc[sending & (moves["agent"] == agent), "t_ns"]
        sent = np.searchsorted(sent_ns, np.sort(arrivals), side="right")
        doubled += max(0, int(np.max(np.arange(1, len(arrivals) + 1) - sent)))
    return doubled


@derived
def events(run: Run[Config]) -> dict[str, int]:
    """Return the number of discovery events that a listener received, by name."""
    constants = message_type(DISCOVERY_EVENT)
    names = {getattr(constants, action.name): action.name for action in ANNOUNCEMENTS}
    counts: Counter[str] = Counter()
    with LogReader(run.log) as reader:
        for topic in reader.topics:
            if topic.endswith("/agent_discovery_event"):
                counts.update(names[each.message.event] for each in reader.decoded(topic))
    return dict(sorted(counts.items()))


@exp.claim("A-DFA", how=How.LIVE)
def paper_transitions(run: Run[Config]) -> Finding:
    """Return the share of the paper's transitions that were taken.

    It is 0 if a move broke the rules, more queries arrived than were sent, or an event was not received.
    """
    found, received = transitions(run), events(run)
    silent = [name for name, count in found.announced.items() if received.get(name) != count]
    wrong = {
        "moves against the rules": found.strange,
        "queries beyond those sent": found.doubled,
        "kinds of events that were not received as often as announced": len(silent),
    }
    reasons = [f"{count} {what}" for what, count in wrong.items() if count]
    missing = [
        f"{state.name} on {given.name}" for state, given in STATED if not found.taken[state, given]
    ]
    share = 0.0 if reasons else 1 - len(missing) / len(STATED)
    if missing:
        reasons.insert(0, f"not reached: {', '.join(missing)}")
    details = {
        "hosts": str(run.metadata("hosts")["description"]),
        "transitions reached": f"{found.reached:.0%} of {len(found.taken)}",
        "queries at made-up agents": f"{found.queries}, beyond those sent: {found.doubled}",
        "discovery events received": str(received),
        "waits": "shortened: a second or less where the default is up to ten minutes",
    }
    estimate = exactly(share, "share of stated transitions reached live")
    return Finding(estimate=estimate, details=details, reason="; ".join(reasons))


@exp.figure("discovery_states", size=(10, 9.2))
def draw_states(figure: Figure, run: Run[Config]) -> None:
    """Draw the life cycle of a remote agent, and how often the run took each transition."""
    found = transitions(run)
    is_taken = {key: count > 0 for key, count in found.taken.items()}
    stated = sum(is_taken[key] for key in STATED)
    ours = sum(is_taken.values()) - stated
    draw_run(figure.subplots(), found.taken)
    figure.suptitle(
        f"Life cycle of a remote agent (after paper A, Fig. 3): the run took {stated} of "
        f"{len(STATED)} transitions of the paper\nand {ours} of {len(TRANSITIONS) - len(STATED)} that sfglab "
        f"adds, {found.strange} against the rules; {found.doubled} queries beyond those sent",
        fontsize="medium",
    )


def press_states(run: Run[Config]) -> Automaton:
    """Return the clickable life cycle, with the inputs of each agent of the run to replay."""
    moves = run["move"].sort_values("t_ns", kind="stable")
    groups = moves.groupby(["discoverer", "agent"], sort=False)
    by_kinds = sorted(groups, key=lambda each: -len(each[1][["before", "given"]].drop_duplicates()))
    runs = {}
    for (discoverer, agent), rows in by_kinds:
        runs[f"{agent}, seen by {discoverer}"] = [Input[name] for name in rows["given"]]
    return press_lifecycle(runs)


def press_lifecycle(runs: Mapping[str, Sequence[Input]] | None = None) -> Automaton:
    """Return the clickable life cycle; `runs` are inputs to replay, by name."""
    return Automaton("agent", TRANSITIONS, State.UNKNOWN, draw_to_press, size=(10, 8.8), runs=runs)

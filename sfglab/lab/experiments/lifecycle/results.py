"""Checks of heartbeats, transitions that were taken, the claims A-HEARTBEAT and A-DFA, and the figure.

All values are computed from the log, and from rules that are written independently of the discoverer's table.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from math import ceil
from typing import TYPE_CHECKING

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
from sfglab.fleet.status.heartbeat import Phase, Schedule
from sfglab.lab.checks import lifecycle
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.lifecycle.experiment import Config, exp
from sfglab.lab.experiments.lifecycle.states import draw_run, draw_to_press
from sfglab.lab.explore import Automaton
from sfglab.lab.figures import note
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import exactly
from sfglab.messages import message_type
from sfglab.record import LogReader
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.figure import Figure

    Check = tuple[str, str, bool, str]  # agent, statement, whether it holds, observed values

TOPIC = "/global/agent_heartbeat"
SERVICE = "/global/{agent}/get_metadata"
"""Names as paper A, section 4.2 prints them."""
HEARTBEAT_TYPE = "sfglab_interfaces/msg/AgentHeartbeat"
OFFERED = [TOPIC, HEARTBEAT_TYPE, "reliable", "transient_local"]
"""Topic, type, reliability and durability of the heartbeats' publishers."""
#: A late joiner that receives within this time has not waited for the next heartbeat.
AT_ONCE_S = 1.0


# --- Heartbeats -------------------------------------------------------------------------------


@derived
def intervals(run: Run[Config]) -> pd.DataFrame:
    """Return the time from each heartbeat to the next one, as a subscriber on another host received them.

    Returns:
        One row per heartbeat except each agent's last: ``agent``, ``phase``, the announced
        ``period_s``, and ``gap_s``, the time until its next one.
    """
    table = run["beat"].sort_values("received_ns")
    beats = table[(table["listener"] == "first") & table["agent"].isin(run["answer"]["agent"])]
    next_ns = beats.groupby("agent")["received_ns"].shift(-1)
    gaps = beats.assign(gap_s=(next_ns - beats["received_ns"]) / NS_PER_S)
    return gaps[["agent", "phase", "period_s", "gap_s"]].dropna()


@derived
def heartbeat_checks(run: Run[Config]) -> pd.DataFrame:
    """Check the statements of section 4.2, agent by agent."""
    agents = sorted(run["answer"]["agent"])
    offered = run["endpoint"][["topic", "type", "reliability", "durability"]].to_numpy().tolist()
    kinds = sorted({", ".join(each) for each in offered})
    checks: list[Check] = [
        (
            "all",
            "one publisher per agent on the paper's topic, transient local",
            offered == [OFFERED] * len(agents),
            f"{len(offered)} publishers of {len(agents)} agents: {'; '.join(kinds)}",
        )
    ]
    for agent in agents:
        checks += [*check_periods(run, agent), *check_receipt(run, agent)]
    return pd.DataFrame(checks, columns=["agent", "check", "holds", "observed"])


def check_periods(run: Run[Config], agent: str) -> list[Check]:
    """Check the median intervals of both phases, and the announced times."""
    schedule, tolerance = run.config.schedule, run.config.tolerance
    table = intervals(run)
    table = table[table["agent"] == agent]
    within = f"within {100 * tolerance:g} %"
    medians_s = table.groupby("phase")["gap_s"].median()
    checks: list[Check] = []
    periods_s = {"startup": schedule.startup_period_s, "steady": schedule.steady_period_s}
    for phase, (name, stated_s) in enumerate(periods_s.items()):
        held = bool(abs(medians_s[phase] - stated_s) <= tolerance * stated_s)
        what = f"median {name} period {within} of {stated_s:g} s"
        checks.append((agent, what, held, f"{medians_s[phase]:.4f} s"))
    error = float(((table["gap_s"] - table["period_s"]).abs() / table["gap_s"]).median())
    what = f"announced time until the next heartbeat {within}"
    checks.append((agent, what, error <= tolerance, f"median error {100 * error:.2f} %"))
    return checks


def check_receipt(run: Run[Config], agent: str) -> list[Check]:
    """Check the order of the phases, the heartbeats that a late joiner receives, and the answer of the service."""
    schedule = run.config.schedule
    beats = run["beat"].sort_values("sent_ns")
    beats = beats[beats["agent"] == agent]
    phases = beats.loc[beats["listener"] == "first", "phase"].tolist()
    startup = phases.count(0)
    expected = ceil(schedule.startup_s / schedule.startup_period_s)
    limit_s = min(AT_ONCE_S, 0.5 * schedule.steady_period_s)
    late = beats[beats["listener"] == "late"]
    joined_ns = run["join"].set_index("listener").loc["late", "t_ns"]
    after_s = (late["received_ns"].min() - joined_ns) / NS_PER_S
    age_s = (joined_ns - late["sent_ns"].min()) / NS_PER_S
    answer = run["answer"].set_index("agent").loc[agent]
    is_named = answer["service"] == SERVICE.format(agent=agent)
    is_same = set(beats["incarnation"]) == {answer["incarnation"]}
    return [
        (
            agent,
            f"{expected} heartbeats of the start-up phase, then the steady state",
            phases == sorted(phases) and startup == expected,
            f"{startup} in the start-up, {len(phases) - startup} in the steady state",
        ),
        (
            agent,
            f"a late joiner receives the last heartbeat within {limit_s:g} s of joining",
            bool(after_s <= limit_s and age_s > 0),
            f"after {after_s:.3f} s, sent {age_s:.2f} s before it joined",
        ),
        (
            agent,
            "the paper's service answers, for the process that sends the heartbeats",
            bool(answer["answered"] and is_named and is_same),
            f"{answer['service']} after {answer['took_s']:.3f} s",
        ),
    ]


@exp.claim("A-HEARTBEAT", how=How.LIVE)
def paper_heartbeats(run: Run[Config]) -> Finding | None:
    """Return the share of checks that hold; None at other periods than the paper's, or without an interval."""
    own = run.config.schedule
    papers = Schedule()
    if (own.startup_period_s, own.steady_period_s) != (
        papers.startup_period_s,
        papers.steady_period_s,
    ):
        return None
    measured = intervals(run)[["agent", "phase"]].drop_duplicates()
    if len(measured) < len(Phase) * len(run["answer"]):
        return None
    checks = heartbeat_checks(run)
    failed = checks[~checks["holds"]]
    reasons = [f"{row.agent}: {row.check}: {row.observed}" for row in lines_of(failed)]
    estimate = exactly(float(checks["holds"].mean()), "share of checks that hold")
    return Finding(estimate=estimate, reason="; ".join(reasons))


# --- Transitions ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Transitions:
    """The transitions of the table, and the number of times that each was taken."""

    taken: dict[tuple[State, Input], int]  #: Number by state and input.
    #: Moves that break a rule, or do not begin in the state in which the agent was.
    strange: int
    #: Queries that arrived beyond those that had been sent to their agent by then.
    doubled: int
    announced: dict[str, int]  #: Number of discovery events by the moves' actions, by name.


@derived
def transitions(run: Run[Config]) -> Transitions:
    """Count the transitions that were taken; each is compared with the rules, not with the table."""
    taken = dict.fromkeys(TRANSITIONS, 0)
    announced: Counter[str] = Counter()
    states: dict[str, str] = {}
    strange = 0
    for move in lines_of(run["move"]):
        key = (State[move.before], Input[move.given])
        actions = tuple(Action[name] for name in move.actions.split(";") if name)
        announced.update(action.name for action in actions if action in ANNOUNCEMENTS)
        known = states.get(move.agent, State.UNKNOWN.name)
        states[move.agent] = move.after
        if known == move.before and lifecycle.ruled(*key) == (State[move.after], actions):
            taken[key] += 1
        else:
            strange += 1
    return Transitions(
        taken=taken,
        strange=strange,
        doubled=doubled_queries(run),
        announced=dict(sorted(announced.items())),
    )


def doubled_queries(run: Run[Config]) -> int:
    """Return the number of queries that arrived beyond those that had been sent to their agent by then.

    By the rules a discoverer sends no query while one is outstanding.
    """
    moves = run["move"]
    sent = moves[moves["actions"].str.contains(rf"\b{Action.QUERY.name}\b")].assign(step=-1)
    arrived = run["query"].assign(step=1)
    both = pd.concat([sent, arrived], join="inner").sort_values("t_ns", kind="stable")
    beyond = both.groupby("agent")["step"].cumsum().clip(lower=0)
    return int(beyond.groupby(both["agent"]).max().sum())


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
    found = transitions(run)
    missing = [
        f"{state.name} on {given.name}" for state, given in STATED if not found.taken[state, given]
    ]
    faults = []
    if found.strange:
        faults.append(f"{found.strange} moves against the rules")
    if found.doubled:
        faults.append(f"{found.doubled} queries beyond those sent")
    if events(run) != found.announced:
        faults.append("events were not received as often as announced")
    share = 0.0 if faults else 1 - len(missing) / len(STATED)
    if missing:
        faults.insert(0, f"not reached: {', '.join(missing)}")
    details = {
        "discovery events received": str(events(run)),
        "waits": "shortened: a second or less where the default is up to ten minutes",
    }
    estimate = exactly(share, "share of stated transitions reached live")
    return Finding(estimate=estimate, details=details, reason="; ".join(faults))


@exp.figure("discovery_states", size=(10, 9.2))
def draw_states(figure: Figure, run: Run[Config]) -> None:
    """Draw the life cycle of a remote agent, and how often the run took each transition."""
    taken = transitions(run).taken
    draw_run(figure.subplots(), taken)
    stated = sum(taken[key] > 0 for key in STATED)
    reached = sum(count > 0 for count in taken.values())
    figure.suptitle(
        "Life cycle of a remote agent (after paper A, Fig. 3): the run took\n"
        f"{stated} of {len(STATED)} transitions of the paper and {reached - stated} of "
        f"{len(taken) - len(STATED)} that sfglab adds",
        fontsize="medium",
    )
    note(figure, "real and made-up agents", run)


def press_states(run: Run[Config]) -> Automaton:
    """Return the clickable life cycle, with the inputs of each agent of the run to replay."""
    moves = run["move"].sort_values("t_ns", kind="stable")
    runs = {}
    for agent, given in moves.groupby("agent", sort=False)["given"]:
        runs[str(agent)] = [Input[name] for name in given]
    return press_lifecycle(runs)


def press_lifecycle(runs: Mapping[str, Sequence[Input]] | None = None) -> Automaton:
    """Return the clickable life cycle; `runs` are inputs to replay, by name."""
    return Automaton("agent", TRANSITIONS, State.UNKNOWN, draw_to_press, size=(10, 8.8), runs=runs)

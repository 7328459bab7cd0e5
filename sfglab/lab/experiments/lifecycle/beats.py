"""From the log to what the paper states of heartbeats: periods, phases, names, and who comes late."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

    import pandas as pd

    from sfglab.lab.experiments.lifecycle.results import Results


PAPER_TOPIC = "/global/agent_heartbeat"
PAPER_SERVICE = "/global/{agent}/get_metadata"
"""As paper A, section 4.2 prints them."""

HEARTBEAT_TYPE = "sfglab_interfaces/msg/AgentHeartbeat"
AT_ONCE_S = 1.0
"""A late listener that hears within this time has not waited for the next heartbeat."""


def intervals(results: Results, listener: str = "first") -> pd.DataFrame:
    """Return the time from each heartbeat to the next, as a listener on another host received them.

    Args:
        results: The run.
        listener: Which listener.

    Returns:
        One line a heartbeat but each agent's last: ``agent``, ``phase``, ``period_s`` as announced,
        ``since_s`` from that agent's first heartbeat, and ``gap_s`` to its next one.
    """
    heard = results.beats[results.beats["listener"] == listener].sort_values("received_ns")
    by_agent = heard.groupby("agent", sort=True)["received_ns"]
    table = heard.assign(
        gap_s=(by_agent.shift(-1) - heard["received_ns"]) / 1e9,
        since_s=(heard["received_ns"] - by_agent.transform("first")) / 1e9,
    )
    columns = ["agent", "phase", "period_s", "since_s", "gap_s"]
    return table.dropna(subset=["gap_s"])[columns].sort_values(["agent", "since_s"]).reset_index(drop=True)


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """Something that the paper states of heartbeats, and whether it was so."""

    what: str  #: The statement.
    agent: str  #: Of which agent; empty: of all.
    held: bool  #: Whether it was so.
    seen: str  #: What was seen.


def heartbeat_checks(results: Results) -> list[Check]:
    """Check what section 4.2 states, agent by agent."""
    found = [_topic_check(results)]
    table = intervals(results)
    for agent in sorted(results.answers["agent"]):
        found += _period_checks(results, table[table["agent"] == agent], agent)
        found += [_phase_check(results, agent), _late_check(results, agent), _service_check(results, agent)]
    return found


def _topic_check(results: Results) -> Check:
    ends = results.endpoints
    kinds = set(map(tuple, ends[["topic", "type", "reliability", "durability"]].to_numpy().tolist()))
    agents = len(results.answers)
    return Check(
        what="one publisher per agent on the paper's topic, latched",
        agent="",
        held=kinds == {(PAPER_TOPIC, HEARTBEAT_TYPE, "reliable", "transient_local")} and len(ends) == agents,
        seen=f"{len(ends)} publishers of {agents} agents: {sorted(kinds)}",
    )


def _period_checks(results: Results, table: pd.DataFrame, agent: str) -> Iterator[Check]:
    schedule, tolerance = results.config["schedule"], results.config["tolerance"]
    for phase, name in ((0, "startup"), (1, "steady")):
        stated = schedule[f"{name}_period_s"]
        median = float(table.loc[table["phase"] == phase, "gap_s"].median())
        yield Check(
            what=f"median {name} period within {100 * tolerance:g} % of {stated:g} s",
            agent=agent,
            held=abs(median - stated) <= tolerance * stated,
            seen=f"{median:.4f} s",
        )
    error = float(((table["gap_s"] - table["period_s"]).abs() / table["gap_s"]).median())
    yield Check(
        what=f"announced time until the next heartbeat within {100 * tolerance:g} %",
        agent=agent,
        held=error <= tolerance,
        seen=f"median error {100 * error:.2f} %",
    )


def _phase_check(results: Results, agent: str) -> Check:
    """Check that there are as many start-up heartbeats as periods fit, and none after the first steady one."""
    beats = results.beats
    heard = beats[(beats["agent"] == agent) & (beats["listener"] == "first")].sort_values("sent_ns")
    phases = heard["phase"].to_numpy()
    schedule = results.config["schedule"]
    expected = int(np.ceil(schedule["startup_s"] / schedule["startup_period_s"]))
    return Check(
        what=f"{expected} heartbeats of the start-up phase, then the steady state",
        agent=agent,
        held=int((phases == 0).sum()) == expected and bool((np.diff(phases) >= 0).all()),
        seen="".join(str(int(phase)) for phase in phases),
    )


def _late_check(results: Results, agent: str) -> Check:
    """Check that a listener that joins between two heartbeats hears the last one without waiting."""
    beats, joins = results.beats, results.joins.set_index("listener")["t_ns"]
    late = beats[(beats["agent"] == agent) & (beats["listener"] == "late")].sort_values("received_ns")
    if late.empty:
        return Check(what="heard at once by who joins late", agent=agent, held=False, seen="never heard")
    first = late.iloc[0]
    after_s = (first["received_ns"] - joins["late"]) / 1e9
    age_s = (joins["late"] - first["sent_ns"]) / 1e9
    limit_s = min(AT_ONCE_S, 0.5 * results.config["schedule"]["steady_period_s"])
    return Check(
        what="heard at once by who joins late",
        agent=agent,
        held=bool(after_s <= limit_s and age_s > 0),
        seen=f"after {after_s:.3f} s, sent {age_s:.2f} s before it joined",
    )


def _service_check(results: Results, agent: str) -> Check:
    answer = results.answers.set_index("agent").loc[agent]
    incarnations = set(results.beats.loc[results.beats["agent"] == agent, "incarnation"])
    named = answer["service"] == PAPER_SERVICE.format(agent=agent)
    return Check(
        what="the paper's service answers with the same start of the agent",
        agent=agent,
        held=bool(answer["answered"] and named and incarnations == {answer["incarnation"]}),
        seen=f"{answer['service']} after {answer['took_s']:.3f} s",
    )

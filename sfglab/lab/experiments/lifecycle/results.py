"""The log of a run as tables."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.fleet.discovery.lifecycle import ANNOUNCEMENTS
from sfglab.record import LogReader

if TYPE_CHECKING:
    from pathlib import Path

    import pandas as pd


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """The tables of one run; see `rows`."""

    beats: pd.DataFrame  #: Heartbeats of the first part, as both listeners heard them.
    joins: pd.DataFrame  #: When the listeners of the first part joined.
    endpoints: pd.DataFrame  #: Publishers of heartbeats in the graph.
    answers: pd.DataFrame  #: Calls of the metadata services.
    moves: pd.DataFrame  #: Transitions.
    queries: pd.DataFrame  #: Queries that arrived at false agents.
    faults: pd.DataFrame  #: What was done to provoke transitions.
    counts: pd.DataFrame  #: The discoverers' counters at the end.
    events: dict[str, int]  #: Raw discovery events that a listener heard, by name of the event.
    config: dict[str, Any]  #: The run's configuration.
    hosts: dict[str, Any]  #: What the hosts were.

    @property
    def at_paper_periods(self) -> bool:
        """Whether heartbeats came at the paper's periods, so that they say something about its claim."""
        schedule = self.config["schedule"]
        return (schedule["startup_period_s"], schedule["steady_period_s"]) == (1.0, 5.0)


def load_results(log: Path) -> Results:
    """Read a run's tables.

    Args:
        log: The log.
    """
    with LogReader(log) as reader:
        answers = reader.table("answer")
        beats = reader.table("beat")
        joins = reader.table("join")
        return Results(
            beats=beats[beats["agent"].isin(answers["agent"])].reset_index(drop=True),
            joins=joins.drop_duplicates("listener"),
            endpoints=reader.table("endpoint"),
            answers=answers,
            moves=reader.table("move"),
            queries=reader.table("query"),
            faults=reader.table("fault"),
            counts=reader.table("count"),
            events=_events(reader),
            config=reader.metadata("config"),
            hosts=reader.metadata("hosts"),
        )


def _events(reader: LogReader) -> dict[str, int]:
    topics = [topic for topic in reader.topics if topic.endswith("/agent_discovery_event")]
    kinds = Counter(entry.message.event for topic in topics for entry in reader.decoded(topic))
    names = {getattr(_event_type(), action.name): action.name for action in ANNOUNCEMENTS}
    return {names[kind]: count for kind, count in sorted(kinds.items())}


def _event_type() -> type[Any]:
    from sfglab.fleet.discovery.listener import DISCOVERY_EVENT
    from sfglab.messages import message_type

    return message_type(DISCOVERY_EVENT)

"""What happens in an agent, as values and as JSON reports.

Knows what a supervisor can hear and decide; refuses to know what the components' reports mean (`narrator`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sfglab.fleet.agent.supervision import State
    from sfglab.fleet.component import Report


@dataclass(frozen=True, slots=True, kw_only=True)
class Changed:
    """A component's life went on."""

    component: str  #: Its name.
    state: State  #: Where it stands now.
    pid: int | None = None  #: Its process; None while there is none.
    crashes: int = 0  #: How often it has ended although it was wanted.
    why: str = ""  #: How its process ended or what is waited for; empty when there is nothing to say.
    retry_s: float | None = None  #: Wait before it is started again, seconds; None when no start is waited for.


@dataclass(frozen=True, slots=True, kw_only=True)
class Said:
    """A component reported something that is its own business."""

    component: str  #: Its name.
    report: Report  #: The report.


@dataclass(frozen=True, slots=True, kw_only=True)
class Wrote:
    """A component wrote a line on standard error."""

    component: str  #: Its name.
    line: str  #: The line.


@dataclass(frozen=True, slots=True, kw_only=True)
class Complete:
    """All components serve for the first time."""


AgentEvent = Changed | Said | Wrote | Complete


def report_from_event(event: AgentEvent) -> Report:
    """Return an event as a JSON object: ``is`` is ``component``, ``report``, ``line`` or ``ready``."""
    if isinstance(event, Complete):
        return {"is": "ready"}
    if isinstance(event, Said):
        return {"is": "report", "component": event.component, "report": event.report}
    if isinstance(event, Wrote):
        return {"is": "line", "component": event.component, "line": event.line}
    values: dict[str, Any] = {"state": event.state.name.lower(), "pid": event.pid}
    values |= {"crashes": event.crashes, "why": event.why, "retry_s": event.retry_s}
    return {"is": "component", "component": event.component, **values}

"""What happens in an agent, as values and as JSON reports.

Knows what a supervisor can hear and decide; refuses to know what the components' reports mean (`narrator`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sfglab.fleet.agent.supervision import State
    from sfglab.fleet.component import Report

__all__ = ["AgentEvent", "Changed", "Complete", "Said", "Wrote", "report_from_event"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Changed:
    """A component's life went on.

    Attributes:
        component: Its name.
        state: Where it stands now.
        pid: Its process; None while there is none.
        crashes: How often it has ended although it was wanted.
        why: How its process ended or what is waited for; empty when there is nothing to say.
        retry_s: Wait before it is started again, seconds; None when no start is waited for.
    """

    component: str
    state: State
    pid: int | None = None
    crashes: int = 0
    why: str = ""
    retry_s: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Said:
    """A component reported something that is its own business.

    Attributes:
        component: Its name.
        report: The report.
    """

    component: str
    report: Report


@dataclass(frozen=True, slots=True, kw_only=True)
class Wrote:
    """A component wrote a line on standard error.

    Attributes:
        component: Its name.
        line: The line.
    """

    component: str
    line: str


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

"""What would change, and what was done, as tables for a terminal."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.deploy.rollout.plan import Change
from sfglab.tables import text_table

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from sfglab.deploy.rollout.apply import Step
    from sfglab.deploy.rollout.plan import Plan


@dataclass(frozen=True, slots=True, kw_only=True)
class Prospect:
    """What is to happen to one agent."""

    agent: str  #: The agent.
    machine: str  #: Where.
    plan: Plan | None  #: What would change; None where the machine could not be looked at.
    steps: tuple[Step, ...] = ()  #: Commands that follow.
    problem: str = ""  #: Why it could not be looked at; empty when it was.


def render_prospects(prospects: Sequence[Prospect], *, diff: bool = False) -> str:
    """Return what would change on each machine as text.

    Args:
        prospects: One an agent.
        diff: Show the changes of texts line by line as well.
    """
    blocks = [text_table(_summary(prospects))]
    blocks += [block for prospect in prospects for block in _details(prospect, diff=diff)]
    return "\n\n".join(blocks) + "\n"


def _summary(prospects: Sequence[Prospect]) -> Iterator[tuple[str, ...]]:
    yield "agent", "machine", "release there", "release new", *(change.value for change in Change), "then"
    for prospect in prospects:
        plan = prospect.plan
        if plan is None:
            yield prospect.agent, prospect.machine, "?", "", "", "", "", "", prospect.problem
            continue
        counts = (str(sum(file.change is change for file in plan.files)) for change in Change)
        then = f"{len(prospect.steps)} commands" if prospect.steps else "nothing to do"
        yield plan.agent, prospect.machine, plan.before or "none", plan.after, *counts, then


def _details(prospect: Prospect, *, diff: bool) -> Iterator[str]:
    if prospect.plan is None or prospect.plan.nothing:
        return
    lines = [f"{prospect.agent} on {prospect.machine}"]
    changed = [file for file in prospect.plan.files if file.change is not Change.SAME]
    if all(file.change is Change.NEW for file in changed) and not prospect.plan.before:
        lines.append(f"  new     all {len(changed)} files (`sfglab deploy render` writes them to be read)")
        changed = []
    for file in changed:
        lines.append(f"  {file.change.value:8}{file.path}{f'  ({file.remark})' if file.remark else ''}")
        lines += [f"      {line}" for line in file.diff.splitlines()] if diff else []
    lines += [f"  then    {step.what}" for step in prospect.steps]
    yield "\n".join(lines)

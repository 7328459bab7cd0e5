"""Changes on a machine, files and the commands that follow, and how they are told. Pure; nothing is touched."""

from __future__ import annotations

import difflib
import hashlib
import json
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from sfglab.deploy.bundle import ENVIRONMENT, MANIFEST, Bundle, Member
from sfglab.tables import text_table

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence


_RESTARTING = ("compose.yaml", ENVIRONMENT, "router/")
"""What containers take in only when they are started anew."""


class Change(Enum):
    """What happens to a file."""

    NEW = "new"
    CHANGED = "changed"
    GONE = "gone"
    SAME = "same"


@dataclass(frozen=True, slots=True, kw_only=True)
class FileChange:
    """One file."""

    path: str  #: Within the agent's folder.
    change: Change  #: What happens to it.
    remark: str = ""  #: What else is worth knowing, as that somebody changed it on the machine.
    diff: str = ""  #: Unified diff of its text; empty where there is none to show.


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """What applying a bundle would do."""

    agent: str  #: The agent.
    before: str  #: The release on the machine; empty: none.
    after: str  #: The release of the bundle.
    files: tuple[FileChange, ...]  #: Every file that is or will be there.
    restart: bool  #: Whether the containers start anew.

    @property
    def nothing(self) -> bool:
        """Whether nothing would change."""
        return all(file.change is Change.SAME for file in self.files)


def plan_changes(bundle: Bundle, present: Mapping[str, Member]) -> Plan:
    """Return what applying a bundle would change.

    Files on the machine that no bundle has written (a user's own hooks) are not looked at.

    Args:
        bundle: The bundle.
        present: What the machine has in the agent's folder, by path.
    """
    before, written = _read_manifest(present.get(MANIFEST))
    paths = sorted({*bundle.members, *(path for path in written if path in present)})
    files = tuple(_change(path, bundle.members.get(path), present.get(path), written) for path in paths)
    changed = [file.path for file in files if file.change is not Change.SAME]
    return Plan(
        agent=bundle.agent,
        before=before,
        after=bundle.tag,
        files=files,
        restart=before != bundle.tag or any(path.startswith(_RESTARTING) for path in changed),
    )


def _read_manifest(manifest: Member | None) -> tuple[str, dict[str, dict[str, str]]]:
    """Return the release on a machine and the files that it wrote; nothing where there is no whole manifest."""
    if manifest is None:
        return "", {}
    try:
        values = json.loads(manifest.data)
        return str(values["tag"]), dict(values["files"])
    except (ValueError, KeyError, TypeError):
        return "", {}


def _change(
    path: str, new: Member | None, old: Member | None, written: Mapping[str, Mapping[str, str]]
) -> FileChange:
    remark = "changed on the machine by somebody else" if old and _is_touched(path, old, written) else ""
    if new is None:
        return FileChange(path=path, change=Change.GONE, remark=remark)
    if old is None:
        return FileChange(path=path, change=Change.NEW)
    if new == old:
        return FileChange(path=path, change=Change.SAME)
    return FileChange(path=path, change=Change.CHANGED, remark=remark, diff=_diff(path, old, new))


def _is_touched(path: str, old: Member, written: Mapping[str, Mapping[str, str]]) -> bool:
    entry = written.get(path)
    return entry is not None and entry.get("sha256") != hashlib.sha256(old.data).hexdigest()


def _diff(path: str, old: Member, new: Member) -> str:
    try:
        before, after = old.data.decode(), new.data.decode()
    except UnicodeDecodeError:
        return ""
    return "".join(_lines(path, before, after))


def _lines(path: str, before: str, after: str) -> Iterator[str]:
    for line in difflib.unified_diff(
        before.splitlines(keepends=True), after.splitlines(keepends=True), f"{path} (there)", f"{path} (new)"
    ):
        yield line if line.endswith("\n") else f"{line}\n"


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """A command that follows when the files are there."""

    what: str  #: What it does, for people.
    script: str  #: For a shell on the machine.
    #: It talks to the running system, so that a folder in place of a machine goes without.
    on_system: bool = True


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

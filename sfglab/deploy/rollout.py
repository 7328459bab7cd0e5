"""Rollout of a bundle to a machine: what would change, bringing it there, and going back by a release's name.

A machine keeps the archives of its releases, so that going back needs nothing else. The manifest is an
archive's last file: a machine that was cut off shows what is missing, and applying again goes on. What talks to
a machine raises a `DeployError` where it cannot be reached, or a command fails there.
"""

from __future__ import annotations

import difflib
import hashlib
import json
import shlex
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from sfglab.deploy.bundle import ENVIRONMENT, MANIFEST, Bundle, Member, pack, unpack
from sfglab.deploy.errors import DeployError
from sfglab.tables import text_table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from sfglab.deploy.deployment import Deployment
    from sfglab.deploy.transport import Transport


#: What containers take in when they start anew.
_RESTARTING = ("compose.yaml", ENVIRONMENT, "router/")


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
    """Return what applying a bundle changes where a machine has `present`; others' files are not looked at."""
    before, written = _read_manifest(present.get(MANIFEST))
    paths = sorted({*bundle.members, *(path for path in written if path in present)})
    files = tuple(
        _change(path, bundle.members.get(path), present.get(path), written) for path in paths
    )
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
        return str(values["tag"]), {path: dict(about) for path, about in values["files"].items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return "", {}


def _change(
    path: str, new: Member | None, old: Member | None, written: Mapping[str, Mapping[str, str]]
) -> FileChange:
    touched = (
        old
        and path in written
        and written[path].get("sha256") != hashlib.sha256(old.data).hexdigest()
    )
    remark = "changed on the machine by somebody else" if touched else ""
    if new is None:
        return FileChange(path=path, change=Change.GONE, remark=remark)
    if old is None:
        return FileChange(path=path, change=Change.NEW)
    if new == old:
        return FileChange(path=path, change=Change.SAME)
    return FileChange(path=path, change=Change.CHANGED, remark=remark, diff=_diff(path, old, new))


def _diff(path: str, old: Member, new: Member) -> str:
    try:
        before, after = (member.data.decode().splitlines(keepends=True) for member in (old, new))
    except UnicodeDecodeError:
        return ""
    lines = difflib.unified_diff(before, after, f"{path} (there)", f"{path} (new)")
    return "".join(line if line.endswith("\n") else f"{line}\n" for line in lines)


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """A command that follows when the files are there."""

    what: str  #: What it does, for people.
    script: str  #: For a shell on the machine.
    #: Of the running system, so that a folder in place of a machine goes without.
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
    """Return what would change on each machine as text, with `diff` also the changes of texts line by line."""
    blocks = [text_table(_summary(prospects))]
    blocks += [block for prospect in prospects for block in _details(prospect, diff=diff)]
    return "\n\n".join(blocks) + "\n"


def _summary(prospects: Sequence[Prospect]) -> Iterator[tuple[str, ...]]:
    yield (
        "agent",
        "machine",
        "release there",
        "release new",
        *(change.value for change in Change),
        "then",
    )
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
        lines.append(
            f"  new     all {len(changed)} files (`sfglab deploy render` writes them to be read)"
        )
        changed = []
    for file in changed:
        lines.append(
            f"  {file.change.value:8}{file.path}{f'  ({file.remark})' if file.remark else ''}"
        )
        lines += [f"      {line}" for line in file.diff.splitlines()] if diff else []
    lines += [f"  then    {step.what}" for step in prospect.steps]
    yield "\n".join(lines)


KEPT = 5  #: Releases whose files a machine keeps.

_RELEASES = ".releases"
_BUILT = " ".join(f"--exclude=./workspace/{name}" for name in ("build", "install", "log"))


def look(transport: Transport, folder: str) -> dict[str, Member]:
    """Return what a machine has in an agent's folder, by path; nothing where there is no folder."""
    place = _quoted(transport, folder)
    script = f"cd {place} 2>/dev/null || exit 0; tar -cf - --exclude=./{_RELEASES} {_BUILT} ."
    archive = transport.run(script)
    return unpack(archive) if archive else {}


def look_and_plan(transport: Transport, folder: str, bundle: Bundle) -> Plan:
    """Return what applying a bundle to a machine would change."""
    return plan_changes(bundle, look(transport, folder))


def steps(deployment: Deployment, bundle: Bundle, plan: Plan) -> tuple[Step, ...]:
    """Return the commands that follow the files; none where nothing changes."""
    if plan.nothing:
        return ()
    folder, service = shlex.quote(deployment.folder), shlex.quote(deployment.service)
    there = f"docker image inspect {shlex.quote(bundle.image)} >/dev/null 2>&1"
    return (
        Step(
            what="prepare the host: time, firewall, service",
            script=f"{folder}/hooks/initialize.sh",
            on_system=False,
        ),
        Step(
            what=f"build {bundle.image} unless it is there",
            script=f"{there} || (cd {folder} && docker compose build agent)",
        ),
        Step(
            what=f"{'restart' if plan.restart else 'start'} {deployment.service}",
            script=f"systemctl {'restart' if plan.restart else 'start'} {service}",
        ),
    )


def apply_plan(
    plan: Plan,
    bundle: Bundle,
    deployment: Deployment,
    transport: Transport,
    say: Callable[[str], None],
) -> None:
    """Bring a bundle to its machine and start it, as `look_and_plan` found; `say` hears each step."""
    if plan.nothing:
        return
    _install(plan, bundle, deployment.folder, transport)
    say(f"{plan.agent}: files written to {transport.name}")
    for step in steps(deployment, bundle, plan):
        if transport.root and step.on_system:
            say(f"{plan.agent}: skipped on a folder in place of a machine: {step.what}")
            continue
        say(f"{plan.agent}: {step.what}")
        root = shlex.quote(transport.root)
        prefix = f"export SFGLAB_ROOT={root}\n{root}" if transport.root else ""
        transport.stream(prefix + step.script, lambda line: say(f"    {line}"))


def releases(transport: Transport, folder: str) -> tuple[str, ...]:
    """Return the releases whose files a machine keeps, the newest first."""
    place = _quoted(transport, f"{folder}/{_RELEASES}")
    names = (
        transport.run(f"ls -1t {place} 2>/dev/null || true").decode(errors="replace").splitlines()
    )
    return tuple(name.removesuffix(".tar") for name in names if name.endswith(".tar"))


def released(transport: Transport, deployment: Deployment, tag: str) -> Bundle:
    """Return an earlier release as the machine kept it; `DeployError` if it is not there, or not whole."""
    folder = deployment.folder
    known = releases(transport, folder)
    if tag not in known:
        allowed = ", ".join(known) or "none, nothing has been applied there"
        raise DeployError(
            f"{transport.name}: release of {deployment.agent.name}: given {tag!r}, allowed: {allowed}"
        )
    members = unpack(transport.run(f"cat {_quoted(transport, _archive(folder, tag))}"))
    if MANIFEST not in members:
        raise DeployError(f"{transport.name}: {_archive(folder, tag)}: not a whole release")
    return Bundle(
        agent=deployment.agent.name,
        tag=tag,
        image=f"{deployment.repository}:{tag}",
        members=members,
    )


def _install(plan: Plan, bundle: Bundle, folder: str, transport: Transport) -> None:
    place = _quoted(transport, folder)
    archive = _quoted(transport, _archive(folder, bundle.tag))
    gone = [file.path for file in plan.files if file.change is Change.GONE]
    lines = [
        f"mkdir -p {place}/{_RELEASES}",
        f"cat > {archive}.part",
        f"mv {archive}.part {archive}",
        # Not over the old files: what runs keeps the one it has opened.
        f"tar -x --unlink-first --no-same-owner -f {archive} -C {place}",
        *(f"rm -f {place}/{shlex.quote(path)}" for path in gone),
        f"cd {place}/{_RELEASES}",
        f'ls -1t | tail -n +{KEPT + 1} | while read -r old; do rm -f "$old"; done',
    ]
    transport.run("\n".join(lines), data=pack(bundle))


def _archive(folder: str, tag: str) -> str:
    return f"{folder}/{_RELEASES}/{tag}.tar"


def _quoted(transport: Transport, path: str) -> str:
    return shlex.quote(f"{transport.root}{path}")

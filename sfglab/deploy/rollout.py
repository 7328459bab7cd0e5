"""Rollout of a bundle to a machine: planned changes, installation, and rollback by a release's name.

A machine keeps its latest releases, each in a folder of its own, and a symbolic link names the one that runs.
Functions that talk to a machine raise a `DeployError` if it cannot be reached or a command fails there.
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
from sfglab.deploy.deployment import CURRENT
from sfglab.deploy.errors import DeployError
from sfglab.tables import text_table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from sfglab.deploy.deployment import Deployment
    from sfglab.deploy.transport import Transport


#: Files that containers read when they start.
_RESTARTING = ("compose.yaml", ENVIRONMENT, "router/")


class Change(Enum):
    """Change of a file."""

    NEW = "new"
    CHANGED = "changed"
    GONE = "gone"
    SAME = "same"


@dataclass(frozen=True, slots=True, kw_only=True)
class FileChange:
    """One file."""

    path: str  #: Within the agent's folder.
    change: Change  #: Its change.
    remark: str = ""  #: Remark, as that the file was changed on the machine.
    diff: str = ""  #: Unified diff of its text; empty where there is none to show.


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Changes that applying a bundle would make."""

    agent: str  #: The agent.
    before: str  #: The release on the machine; empty: none.
    after: str  #: The release of the bundle.
    files: tuple[FileChange, ...]  #: Every file that is or will be there.
    restart: bool  #: Whether the containers restart.

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
    touched = old is not None and path in written and _is_changed(old, written[path])
    remark = "changed on the machine since" if touched else ""
    if new is None:
        return FileChange(path=path, change=Change.GONE, remark=remark)
    if old is None:
        return FileChange(path=path, change=Change.NEW)
    if new == old:
        return FileChange(path=path, change=Change.SAME)
    return FileChange(path=path, change=Change.CHANGED, remark=remark, diff=_diff(path, old, new))


def _is_changed(member: Member, entry: Mapping[str, str]) -> bool:
    """Tell whether a file is another one than its entry in a manifest says."""
    return entry.get("sha256") != hashlib.sha256(member.data).hexdigest()


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

    what: str  #: Description for people.
    script: str  #: For a shell on the machine.
    #: Whether it needs the running system; it is skipped on a folder in place of a machine.
    on_system: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Prospect:
    """Planned changes of one agent."""

    agent: str  #: The agent.
    machine: str  #: Name of its machine.
    plan: Plan | None  #: The changes; None if the machine could not be reached.
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


KEPT = 5  #: Number of releases that a machine keeps.

_RELEASES = ".releases"
_CUSTOM = "hooks/custom.d"  # all releases share it, and it has the user's own hooks
_BUILT = " ".join(f"--exclude=./workspace/{name}" for name in ("build", "install", "log"))


def look(transport: Transport, folder: str) -> dict[str, Member]:
    """Return the files of the release that a machine runs, by path; nothing if there is none."""
    return _files(transport, f"{folder}/{CURRENT}")


def _files(transport: Transport, folder: str) -> dict[str, Member]:
    """Return the files of a release's folder, and the README in the folder of the user's hooks."""
    script = (
        f"cd {_quoted(transport, folder)} 2>/dev/null || exit 0\n"
        f"readme=$(ls {_CUSTOM}/README 2>/dev/null || true)\n"
        f"tar -cf - --exclude=./.env --exclude=./{_CUSTOM} {_BUILT} . $readme"
    )
    archive = transport.run(script)
    return unpack(archive) if archive else {}


def look_and_plan(transport: Transport, folder: str, bundle: Bundle) -> Plan:
    """Return what applying a bundle to a machine would change."""
    return plan_changes(bundle, look(transport, folder))


def steps(deployment: Deployment, bundle: Bundle, plan: Plan) -> tuple[Step, ...]:
    """Return the commands that follow the files; none if nothing changes."""
    if plan.nothing:
        return ()
    release, service = shlex.quote(deployment.release_folder), shlex.quote(deployment.service)
    is_there = f"docker image inspect {shlex.quote(bundle.image)} >/dev/null 2>&1"
    verb = "restart" if plan.restart else "start"
    return (
        Step(
            what="prepare the host: time, firewall, service",
            script=f"{release}/hooks/initialize.sh",
            on_system=False,
        ),
        Step(
            what=f"build {bundle.image} unless it is there",
            script=f"{is_there} || (cd {release} && docker compose build agent)",
        ),
        Step(what=f"{verb} {deployment.service}", script=f"systemctl {verb} {service}"),
    )


def apply_plan(
    plan: Plan,
    bundle: Bundle,
    deployment: Deployment,
    transport: Transport,
    say: Callable[[str], None],
) -> None:
    """Copy a bundle to its machine and start it, as `look_and_plan` found; `say` gets each step as text."""
    if plan.nothing:
        return
    install(bundle, deployment.folder, transport)
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
    """Return the releases that a machine keeps, the newest first."""
    place = _quoted(transport, f"{folder}/{_RELEASES}")
    script = f"cd {place} 2>/dev/null || exit 0; ls -1dt */ 2>/dev/null || true"
    names = transport.run(script).decode(errors="replace").splitlines()
    return tuple(name.rstrip("/") for name in names if not name.endswith((_NEW, _OLD)))


def released(transport: Transport, deployment: Deployment, tag: str) -> Bundle:
    """Return an earlier release from a machine; `DeployError` if it is not there or was changed."""
    known = releases(transport, deployment.folder)
    if tag not in known:
        allowed = ", ".join(known) or "none, nothing has been applied there"
        raise DeployError(
            f"{transport.name}: release of {deployment.agent.name}: given {tag!r}, allowed: {allowed}"
        )
    found = _files(transport, f"{deployment.folder}/{_RELEASES}/{tag}")
    _, written = _read_manifest(found.get(MANIFEST))
    members = {}
    for path, entry in written.items():
        member = found.get(path)
        is_shared = path.startswith(f"{_CUSTOM}/")
        if member is None or (_is_changed(member, entry) and not is_shared):
            raise DeployError(
                f"{transport.name}: release {tag} of {deployment.agent.name}: {path} is missing or was "
                "changed there; apply the fleet file instead"
            )
        members[path] = member
    if not members:
        raise DeployError(
            f"{transport.name}: release {tag}: it has no manifest; apply the fleet file"
        )
    members[MANIFEST] = found[MANIFEST]
    image = f"{deployment.repository}:{tag}"
    return Bundle(agent=deployment.agent.name, tag=tag, image=image, members=members)


_NEW, _OLD = ".new/", ".old/"


def install(bundle: Bundle, folder: str, transport: Transport) -> None:
    """Unpack a bundle beside the other releases of an agent, and let the link name it.

    The link changes once all files are there. Files that the user keeps stay outside of it in the agent's
    folder: a release has links to the folder of the user's hooks and to ``.env``.
    """
    release = shlex.quote(f"{_RELEASES}/{bundle.tag}")
    lines = [
        f"mkdir -p {_quoted(transport, folder)}",
        f"cd {_quoted(transport, folder)}",
        f"rm -rf {release}.new {release}.old",
        f"mkdir -p {release}.new/hooks {_CUSTOM}",
        f"ln -s ../../../{_CUSTOM} {release}.new/{_CUSTOM}",
        f"ln -s ../../.env {release}.new/.env",
        f"tar -x --no-same-owner -f - -C {release}.new",
        f"if [ -e {release} ]; then mv {release} {release}.old; fi",
        f"mv {release}.new {release}",
        f"ln -sfn {release} {CURRENT}.new",
        f"mv -fT {CURRENT}.new {CURRENT}",
        f"rm -rf {release}.old",
        f"cd {_RELEASES}",
        f"touch {shlex.quote(bundle.tag)}",
        f'ls -1t | tail -n +{KEPT + 1} | while read -r old; do rm -rf "$old"; done',
    ]
    transport.run("\n".join(lines), data=pack(bundle))


def _quoted(transport: Transport, path: str) -> str:
    return shlex.quote(f"{transport.root}{path}")

"""Rollout of a bundle to a target host: planned changes, installation, and rollback to a named release.

A host keeps its latest releases, each in its own folder, and a symbolic link points to the running release.
Functions that run commands on a host raise a `DeployError` if the host cannot be reached or a command fails.
"""

from __future__ import annotations

import hashlib
import json
import shlex
from collections import Counter
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from sfglab.deploy.bundle import MANIFEST, Bundle, pack, unpack
from sfglab.deploy.deployment import CURRENT
from sfglab.deploy.errors import DeployError
from sfglab.tables import text_table

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

    from sfglab.deploy.deployment import Deployment
    from sfglab.deploy.files import BundleFile
    from sfglab.deploy.transport import Transport


class Change(Enum):
    """Kind of a change of a file."""

    NEW = "new"
    CHANGED = "changed"
    GONE = "gone"
    SAME = "same"


@dataclass(frozen=True, slots=True, kw_only=True)
class FileChange:
    """Change of one file."""

    path: str  #: Path within the agent's folder.
    change: Change  #: Kind of the change.
    touched: bool  #: Whether the file was changed on the host since its installation.


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """Changes that the application of a bundle would make."""

    agent: str  #: Name of the agent.
    before: str  #: Name of the release on the host; empty: none.
    after: str  #: Name of the bundle's release.
    files: tuple[FileChange, ...]  #: All present and future files.

    @property
    def changed(self) -> list[FileChange]:
        """Files that would change."""
        return [file for file in self.files if file.change is not Change.SAME]


def plan_changes(bundle: Bundle, present: Mapping[str, BundleFile]) -> Plan:
    """Return the changes that a bundle makes on a host with the files `present`, by path in the agent's folder."""
    before, written = _read_manifest(present.get(MANIFEST))
    files = []
    # Files that no release has written are the user's own.
    for path in sorted({*bundle.members, *(written.keys() & present.keys())}):
        new, old = bundle.members.get(path), present.get(path)
        touched = old is not None and path in written and not _is_entry(old, written[path])
        files.append(FileChange(path=path, change=_change(old, new), touched=touched))
    return Plan(agent=bundle.agent, before=before, after=bundle.tag, files=tuple(files))


def _change(old: BundleFile | None, new: BundleFile | None) -> Change:
    if old == new:
        return Change.SAME
    if old is None:
        return Change.NEW
    return Change.GONE if new is None else Change.CHANGED


def _read_manifest(manifest: BundleFile | None) -> tuple[str, dict[str, dict[str, str]]]:
    """Return the release on a machine and the files that it wrote; nothing if there is no valid manifest."""
    if manifest is None:
        return "", {}
    try:
        values = json.loads(manifest.data)
        return str(values["tag"]), {path: dict(about) for path, about in values["files"].items()}
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return "", {}


def _is_entry(file: BundleFile, entry: Mapping[str, str]) -> bool:
    """Return whether a file has the content that its entry in a manifest names."""
    return entry.get("sha256") == hashlib.sha256(file.data).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class Step:
    """A command that follows the installation of the files."""

    what: str  #: Description for people.
    script: str  #: Script for a shell on the host.
    #: Whether the step needs the running system; it is skipped for a folder in place of a host.
    on_system: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Prospect:
    """Planned changes of one agent."""

    agent: str  #: Name of the agent.
    machine: str  #: Name of the agent's host.
    plan: Plan | None  #: Planned changes; None if the host could not be reached.
    steps: tuple[Step, ...] = ()  #: Commands that follow.
    problem: str = ""  #: Reason why there is no plan; empty if there is one.


def render_prospects(prospects: Sequence[Prospect]) -> str:
    """Return the planned changes of each host as text."""
    changes = [change.value for change in Change]
    rows = [("agent", "machine", "release there", "release new", *changes, "then")]
    unknown = [""] * (1 + len(changes))
    blocks = []
    for prospect in prospects:
        plan = prospect.plan
        if plan is None:
            rows.append((prospect.agent, prospect.machine, "?", *unknown, prospect.problem))
            continue
        counts = Counter(file.change for file in plan.files)
        numbers = [str(counts[change]) for change in Change]
        then = f"{len(prospect.steps)} commands" if prospect.steps else "nothing to do"
        before = plan.before or "none"
        rows.append((plan.agent, prospect.machine, before, plan.after, *numbers, then))
        if plan.changed:
            blocks.append("\n".join(_details(prospect, plan)))
    return "\n\n".join([text_table(rows), *blocks]) + "\n"


def _details(prospect: Prospect, plan: Plan) -> Iterator[str]:
    yield f"{prospect.agent} on {prospect.machine}"
    if all(file.change is Change.NEW for file in plan.files):
        count = len(plan.files)
        yield f"  new     all {count} files (`sfglab deploy render` writes them to be read)"
    else:
        for file in plan.changed:
            remark = "  (changed on the machine since)" if file.touched else ""
            yield f"  {file.change.value:8}{file.path}{remark}"
    for step in prospect.steps:
        yield f"  then    {step.what}"


KEPT = 5  #: Number of releases that a machine keeps.

_RELEASES = ".releases"
_CUSTOM = "hooks/custom.d"  # all releases share it, and it has the user's own hooks
_BUILT = " ".join(f"--exclude=./workspace/{name}" for name in ("build", "install", "log"))


def look(transport: Transport, folder: str) -> dict[str, BundleFile]:
    """Return the files of the release that runs on a host, by path; empty if there is none."""
    return _files(transport, f"{folder}/{CURRENT}")


def _files(transport: Transport, folder: str) -> dict[str, BundleFile]:
    """Return the files of a release's folder, and the README in the folder of the user's hooks."""
    script = (
        f"cd {_quoted(transport, folder)} 2>/dev/null || exit 0\n"
        f"readme=$(ls {_CUSTOM}/README 2>/dev/null || true)\n"
        f"tar -cf - --exclude=./.env --exclude=./{_CUSTOM} {_BUILT} . $readme"
    )
    archive = transport.run(script)
    return unpack(archive) if archive else {}


def steps(deployment: Deployment, bundle: Bundle, plan: Plan) -> tuple[Step, ...]:
    """Return the commands that follow the installation of the files; none if nothing changes."""
    if not plan.changed:
        return ()
    release, service = shlex.quote(deployment.release_folder), shlex.quote(deployment.service)
    is_there = f"docker image inspect {shlex.quote(bundle.image)} >/dev/null 2>&1"
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
        Step(what=f"restart {deployment.service}", script=f"systemctl restart {service}"),
    )


def apply_bundle(
    bundle: Bundle,
    folder: str,
    following: Sequence[Step],
    transport: Transport,
    report: Callable[[str], None],
) -> None:
    """Copy a bundle to its host and run the steps that follow; without steps the function does nothing.

    Args:
        bundle: Files of the agent.
        folder: Folder of the agent on the host.
        following: Steps from the function `steps`.
        transport: Transport to the host.
        report: Called with the description of each step, and with its output, as text.
    """
    if not following:
        return
    install(bundle, folder, transport)
    report(f"{bundle.agent}: files written to {transport.name}")
    root = shlex.quote(transport.root)
    prefix = f"export SFGLAB_ROOT={root}\n{root}" if transport.root else ""
    for step in following:
        if transport.root and step.on_system:
            report(f"{bundle.agent}: skipped on a folder in place of a machine: {step.what}")
            continue
        report(f"{bundle.agent}: {step.what}")
        transport.stream(prefix + step.script, lambda line: report(f"    {line}"))


def releases(transport: Transport, folder: str) -> tuple[str, ...]:
    """Return the names of the releases that a host keeps in the agent's folder, the newest first."""
    place = _quoted(transport, f"{folder}/{_RELEASES}")
    script = f"cd {place} 2>/dev/null || exit 0; ls -1dt */ 2>/dev/null || true"
    names = transport.run(script).decode(errors="replace").splitlines()
    return tuple(name.rstrip("/") for name in names if not name.endswith((".new/", ".old/")))


def released(transport: Transport, deployment: Deployment, tag: str) -> Bundle:
    """Return an earlier release from a machine.

    Raises:
        DeployError: The host does not have the release, or its files were changed.
    """
    known = releases(transport, deployment.folder)
    if tag not in known:
        allowed = ", ".join(known) or "none, because nothing has been applied there"
        raise DeployError(
            f"{transport.name}: release of {deployment.agent.name}: given {tag!r}, allowed: {allowed}"
        )
    files = _files(transport, f"{deployment.folder}/{_RELEASES}/{tag}")
    _, written = _read_manifest(files.get(MANIFEST))
    if not written:
        raise DeployError(
            f"{transport.name}: release {tag} has no manifest; apply the fleet file instead"
        )
    for path, entry in written.items():
        is_shared = path.startswith(f"{_CUSTOM}/")
        if path not in files or not (is_shared or _is_entry(files[path], entry)):
            raise DeployError(
                f"{transport.name}: release {tag} of {deployment.agent.name}: {path} is missing or was "
                "changed there; apply the fleet file instead"
            )
    members = {path: files[path] for path in (*written, MANIFEST)}
    image = f"{deployment.repository}:{tag}"
    return Bundle(agent=deployment.agent.name, tag=tag, image=image, members=members)


def install(bundle: Bundle, folder: str, transport: Transport) -> None:
    """Unpack a bundle beside the other releases of an agent, and set the link to it.

    The link changes once all files are unpacked. The user's files are in the agent's folder, outside of releases: a
    release has links to the folder of the user's hooks and to ``.env``.
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

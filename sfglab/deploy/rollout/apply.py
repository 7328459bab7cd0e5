"""Bringing a bundle to a machine, and going back to an earlier one.

A machine keeps the archives of the releases it has had, so that going back needs nothing but the machine. The
manifest is the last file of an archive: a machine that was cut off in the middle shows what is missing, and
applying again goes on.
"""

from __future__ import annotations

import shlex
from typing import TYPE_CHECKING

from sfglab.deploy.bundle import MANIFEST, Bundle, pack, unpack
from sfglab.deploy.errors import DeployError
from sfglab.deploy.rollout.plan import Change, Step, plan_changes

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.deploy.bundle import Member
    from sfglab.deploy.deployment import Deployment
    from sfglab.deploy.rollout.plan import Plan
    from sfglab.deploy.rollout.transport import Transport


KEPT = 5
"""Releases whose files a machine keeps."""

_RELEASES = ".releases"
_BUILT = " ".join(f"--exclude=./workspace/{name}" for name in ("build", "install", "log"))


def look(transport: Transport, folder: str) -> dict[str, Member]:
    """Return what a machine has in an agent's folder, by path; nothing where there is no folder.

    Raises:
        DeployError: The machine cannot be reached.
    """
    place = _quoted(transport, folder)
    script = f"cd {place} 2>/dev/null || exit 0; tar -cf - --exclude=./{_RELEASES} {_BUILT} ."
    archive = transport.run(script)
    return unpack(archive) if archive else {}


def look_and_plan(transport: Transport, folder: str, bundle: Bundle) -> Plan:
    """Return what applying a bundle to a machine would change.

    Raises:
        DeployError: The machine cannot be reached.
    """
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
    plan: Plan, bundle: Bundle, deployment: Deployment, transport: Transport, say: Callable[[str], None]
) -> None:
    """Bring a bundle to a machine and start it.

    Args:
        plan: What changes, from `look_and_plan`.
        bundle: The files.
        deployment: Whose.
        transport: The machine.
        say: Told of each step.

    Raises:
        DeployError: The machine cannot be reached, or a command failed there; applying again goes on.
    """
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
    """Return the releases whose files a machine keeps, the newest first.

    Raises:
        DeployError: The machine cannot be reached.
    """
    place = _quoted(transport, f"{folder}/{_RELEASES}")
    names = transport.run(f"ls -1t {place} 2>/dev/null || true").decode().splitlines()
    return tuple(name.removesuffix(".tar") for name in names if name.endswith(".tar"))


def released(transport: Transport, deployment: Deployment, tag: str) -> Bundle:
    """Return an earlier release as the machine kept it.

    Args:
        transport: The machine.
        deployment: Whose release.
        tag: Its name.

    Raises:
        DeployError: The machine has no such release, or what it kept is not whole.
    """
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
    return Bundle(agent=deployment.agent.name, tag=tag, image=f"{deployment.repository}:{tag}", members=members)


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

"""Checks of target hosts: detection, hooks and rollouts, on folders in place of hosts."""

from __future__ import annotations

import os
import subprocess
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab.deploy.bundle import Bundle, bundle_of, write_bundle
from sfglab.deploy.hardware.detection import detect
from sfglab.deploy.rollout import Change, apply_plan, look_and_plan, released
from sfglab.deploy.transport import Local, copy_facts
from sfglab.fleet.fleet_file import Accelerator
from sfglab.lab.checks import CheckRow, check_row
from sfglab.lab.example_machines import EXAMPLES, write_example

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from sfglab.deploy.deployment import Deployment

_HOOKS_S = 60.0
_EXTENSION = "50-mine.sh"


@dataclass(frozen=True, slots=True, kw_only=True)
class Unasked:
    """A property that cannot be checked on this machine."""

    check: str  #: Name of the property.
    why: str  #: Reason why it cannot be checked.


held = partial(check_row, shown=-1)
"""Row of a check, by `check_row`, which shows the last case as the example if all cases hold."""


def detection_checks(folder: Path) -> Iterator[CheckRow]:
    """Check detection on example hosts in a folder, which follow documentation, directly and as over SSH."""
    right, told, remote = [], [], []
    for name, example in EXAMPLES.items():
        here, copy = folder / name, folder / f"{name} (copy)"
        write_example(example, here)
        machine = detect(here)
        right.append(
            (f"{name}: {machine.accelerator.value}", machine.accelerator is example.expected)
        )
        verdicts = {evidence.accelerator for evidence in machine.evidence if evidence.reason}
        told.append((f"{name}: {len(verdicts)} verdicts", verdicts == set(Accelerator)))
        copy.mkdir()
        copy_facts(Local(folder=here), copy)
        far = detect(copy).accelerator
        remote.append((f"{name}: {far.value}", far is machine.accelerator))
    yield held("the accelerator is found", right)
    yield held("every accelerator has a verdict with its reason", told)
    yield held("from another machine the same is found", remote)


def detected_rows(folder: Path) -> Iterator[dict[str, Any]]:
    """Yield the result of detection for this machine and for the example hosts in a folder."""
    roots = {name: write_example(example, folder / name) for name, example in EXAMPLES.items()}
    for name, root in {"this machine": Path("/"), **roots}.items():
        machine = detect(root)
        others = [e for e in machine.evidence if e.sources and not e.chosen]
        yield {
            "machine": name,
            "accelerator": machine.accelerator.value,
            "why": machine.evidence_of(machine.accelerator).reason,
            "instead": "; ".join(f"{e.accelerator.value}: {e.reason}" for e in others),
        }


def hook_checks(pairs: Sequence[tuple[Deployment, Bundle]], folder: Path) -> Iterator[CheckRow]:
    """Run every agent's hooks on folders in place of its host."""
    dry, first, again, own = [], [], [], []
    for deployment, bundle in pairs:
        name, root = deployment.agent.name, folder / deployment.agent.name
        home = root / deployment.folder.lstrip("/")
        write_bundle(bundle, home)
        before = _snapshot(root)
        wrong = _initialize(home, root, "--dry-run")
        dry.append((f"{name} {wrong}".strip(), not wrong and _snapshot(root) == before))
        wrong = _initialize(home, root)
        after = _snapshot(root)
        first.append((f"{name} {wrong}".strip(), not wrong and after != before))
        wrong = _initialize(home, root)
        again.append((f"{name} {wrong}".strip(), not wrong and _snapshot(root) == after))
        (home / "hooks" / "custom.d" / _EXTENSION).write_text('touch "$SFGLAB_ROOT/mine"\n')
        wrong = _initialize(home, root)
        own.append((f"{name} {wrong}".strip(), not wrong and (root / "mine").exists()))
    yield held("a dry run changes nothing", dry)
    yield held("they prepare the machine", first)
    yield held("the second time nothing changes, not even a time stamp", again)
    yield held("the user's own run after them", own)


def rollout_checks(pairs: Sequence[tuple[Deployment, Bundle]], folder: Path) -> Iterator[CheckRow]:
    """Deploy every agent's files to folders in place of hosts, change them, and roll back."""
    planned, settled, changed, back = [], [], [], []
    for deployment, bundle in pairs:
        name, machine = deployment.agent.name, Local(folder=folder / deployment.agent.name)
        machine.folder.mkdir()
        plan = look_and_plan(machine, deployment.folder, bundle)
        planned.append((name, {file.change for file in plan.files} == {Change.NEW}))
        apply_plan(plan, bundle, deployment, machine, _ignore)
        settled.append((name, look_and_plan(machine, deployment.folder, bundle).nothing))
        other, newer = _changed(deployment, bundle)
        plan = look_and_plan(machine, deployment.folder, newer)
        paths = {file.path for file in plan.files if file.change is not Change.SAME}
        was, now = bundle.members, newer.members
        expected = {path for path in {*was, *now} if was.get(path) != now.get(path)}
        changed.append(
            (f"{name}: {len(paths)} files", paths == expected and newer.tag != bundle.tag)
        )
        apply_plan(plan, newer, other, machine, _ignore)
        old = released(machine, deployment, bundle.tag)
        apply_plan(
            look_and_plan(machine, deployment.folder, old), old, deployment, machine, _ignore
        )
        back.append(
            (f"{name}: {old.tag}", look_and_plan(machine, deployment.folder, bundle).nothing)
        )
    yield held("an empty machine is planned to get every file", planned)
    yield held("applied once, nothing is left to do", settled)
    yield held("a change is planned as exactly the files that differ", changed)
    yield held("going back by a release's name brings every file back", back)


def _changed(deployment: Deployment, bundle: Bundle) -> tuple[Deployment, Bundle]:
    """Return the same agent with one more package, and thus another release."""
    host = replace(deployment.host, packages=(*deployment.host.packages, "can-utils"))
    changed = replace(deployment, host=host)
    return changed, bundle_of(changed, bundle.members[f"image/{deployment.release.wheel}"].data)


def _initialize(home: Path, root: Path, *options: str) -> str:
    """Run the hooks; return their error, or an empty text."""
    done = subprocess.run(
        [home / "hooks" / "initialize.sh", *options],
        env=os.environ | {"SFGLAB_ROOT": str(root)},
        capture_output=True,
        text=True,
        timeout=_HOOKS_S,
        check=False,
    )
    return done.stderr.strip() or f"status {done.returncode}" if done.returncode else ""


def _snapshot(root: Path) -> dict[str, tuple[int, bytes]]:
    """Return time stamp and content of every file below a folder."""
    files = [path for path in sorted(root.rglob("*")) if path.is_file() and not path.is_symlink()]
    return {
        str(path.relative_to(root)): (path.stat().st_mtime_ns, path.read_bytes()) for path in files
    }


def _ignore(_: str) -> None:
    """Ignore the messages of each step, because the log has the outcome."""

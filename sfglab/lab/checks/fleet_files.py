"""Checks of a fleet's files: a release, its files and layers, and what checkers say of them."""

from __future__ import annotations

import hashlib
import json
import re
from collections import defaultdict
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from sfglab.deploy.bases import base_of
from sfglab.deploy.bundle import MANIFEST, bundle_of, render_bundle
from sfglab.deploy.verdicts import State
from sfglab.lab.bundle_meanings import meaning_of
from sfglab.lab.checks.machines import Unasked, held

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping, Sequence

    from sfglab.deploy.bundle import Bundle
    from sfglab.deploy.deployment import Deployment
    from sfglab.deploy.verdicts import Verdict
    from sfglab.lab.checks import CheckRow


LAYERS = ("base", "adapter", "application")
"""Paper A, Fig. 5, from the hardware upwards."""

_STAGE = re.compile(r"^FROM\s+(?P<base>\S+)\s+AS\s+(?P<name>\S+)", re.MULTILINE | re.IGNORECASE)


def file_rows(pairs: Sequence[tuple[Deployment, Bundle]]) -> Iterator[dict[str, Any]]:
    """Yield every file of every machine."""
    for _, bundle in pairs:
        for path, member in bundle.members.items():
            text = b"\0" not in member.data
            yield {
                "agent": bundle.agent,
                "path": path,
                "meaning": meaning_of(path),
                "size_bytes": len(member.data),
                "lines": member.data.count(b"\n") if text else 0,
                "sha256": hashlib.sha256(member.data).hexdigest(),
            }


def layer_rows(pairs: Sequence[tuple[Deployment, Bundle]]) -> Iterator[dict[str, Any]]:
    """Yield the three layers of each agent's image, told apart by all that they are made from."""
    for deployment, bundle in pairs:
        lines = bundle.members["Dockerfile"].data.decode().splitlines(keepends=True)
        text = "".join(line for line in lines if not line.startswith("#"))  # a comment is in no layer
        marks = [*_STAGE.finditer(text)]
        ends = [mark.start() for mark in marks[1:]] + [len(text)]
        stages = {m["name"]: text[m.start() : end] for m, end in zip(marks, ends, strict=True)}
        digest = hashlib.sha256(text[: marks[0].start()].encode())
        says = {
            "base": base_of(deployment).image.rpartition("/")[2],
            "adapter": f"ROS 2 {deployment.common.ros.value}, {deployment.host.architecture.value}",
            "application": bundle.tag,
        }
        for layer in LAYERS:
            digest.update(stages[layer].encode())
            yield {"agent": bundle.agent, "layer": layer, "says": says[layer], "digest": digest.hexdigest()}


def release_checks(pairs: Sequence[tuple[Deployment, Bundle]]) -> Iterator[CheckRow]:
    """Check that a release's name means its contents."""
    equal, other = [], []
    for deployment, bundle in pairs:
        name, release = deployment.agent.name, deployment.release
        wheel = bundle.members[f"image/{release.wheel}"].data
        equal.append((name, render_bundle(deployment) == render_bundle(deployment)))
        equal.append((name, bundle_of(deployment, wheel) == bundle))
        changes = (
            replace(release, lock=re.sub(r"^numpy==", "numpy==1!", release.lock, flags=re.MULTILINE)),
            replace(release, fleet_text=release.fleet_text + "\n"),
        )
        changed = (bundle_of(replace(deployment, release=change), wheel) for change in changes)
        other += [(name, one.tag != bundle.tag) for one in changed]
        other.append((f"{name}, wheel", bundle_of(deployment, wheel + b"x").tag != bundle.tag))
    yield held("equal contents are equal bytes and have one name", equal)
    yield held("any change of lock, fleet file or wheel is another release", other)
    yield held("the manifest is complete", (_complete(bundle) for _, bundle in pairs))


def _complete(bundle: Bundle) -> tuple[str, bool]:
    files = json.loads(bundle.members[MANIFEST].data)["files"]
    digests = {
        path: hashlib.sha256(m.data).hexdigest() for path, m in bundle.members.items() if path != MANIFEST
    }
    return bundle.agent, {path: entry["sha256"] for path, entry in files.items()} == digests


def verdict_rows(verdicts: Iterable[Verdict], names: Mapping[str, str]) -> Iterator[CheckRow | Unasked]:
    """Yield one row for each kind of check that was asked of the fleet and its files.

    Args:
        verdicts: What was said.
        names: What paths of this machine are called in the log.
    """
    by_check: dict[str, list[Verdict]] = defaultdict(list)
    for verdict in verdicts:
        by_check[verdict.check].append(verdict)
    for check, found in by_check.items():
        skipped = [verdict for verdict in found if verdict.state is State.SKIPPED]
        if skipped:
            yield Unasked(check=check, why=skipped[0].says)
        asked = [v for v in found if v.state is not State.SKIPPED]
        if asked:
            cases = (
                (f"{names.get(v.subject, v.subject)} {v.says}".strip(), v.state is State.HOLDS) for v in asked
            )
            yield held(check, cases)

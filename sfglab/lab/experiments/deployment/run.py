"""Run the deployment experiment into one log: files, checks, machines, containers, images."""

from __future__ import annotations

import time
from dataclasses import asdict
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from sfglab.deploy.fleet_check import check_fleet
from sfglab.deploy.preparing import load_source, prepare
from sfglab.deploy.release import SOURCE, make_release
from sfglab.lab.experiments.deployment.containers import container_checks
from sfglab.lab.experiments.deployment.fleets import (
    file_rows,
    layer_rows,
    refused_rows,
    release_checks,
    verdict_rows,
)
from sfglab.lab.experiments.deployment.machines import (
    detected_rows,
    detection_checks,
    held,
    hook_checks,
    rollout_checks,
)
from sfglab.lab.experiments.deployment.rows import DeployCheckRow, UncheckedRow
from sfglab.lab.hosts import Network
from sfglab.lab.paths import find_project
from sfglab.lab.progress import progress_bar
from sfglab.lab.trial_build import trial_build
from sfglab.record import LogWriter, run_context

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from sfglab.deploy.bundle import Bundle
    from sfglab.deploy.deployment import Deployment
    from sfglab.lab.experiments.deployment.config import Config


_STEPS = 7
_OF_ALL = ("Dockerfile", "compose.yaml")
_TOO_LONG = ("image/requirements.lock", "image/sfglab-")


async def run(config: Config, path: Path) -> Path:
    """Run the experiment.

    Args:
        config: What to run.
        path: The log.

    Returns:
        The log's path.

    Raises:
        DeployError: The paper's fleet cannot be rendered, or the project is not a checkout.
        ProcessFailedError: A container's process failed.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    project = find_project()
    source = load_source(project.data / config.fleet_file)
    with (
        TemporaryDirectory(prefix="sfglab-deploy-") as scratch,
        LogWriter(path) as log,
        progress_bar(_STEPS, "deployment") as advance,
    ):
        folder = Path(scratch)
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": "deployment", **asdict(config)})
        release, wheel = make_release(SOURCE, source.text)
        pairs = prepare(source, release, wheel, agents=config.agents)
        _write(log, "file", file_rows(pairs))
        _write(log, "layer", layer_rows(pairs))
        _attach(log, pairs)
        _write_checks(log, release_checks(pairs))
        advance("files")
        verdicts = check_fleet(source, release, agents=config.agents)
        _write_checks(log, verdict_rows(verdicts, {str(source.path): config.fleet_file}))
        advance("checked")
        refused = list(refused_rows(source.text, release, _new(folder, "broken")))
        _write(log, "refused", refused)
        cases = ((row.fault, row.refused) for row in refused)
        _write_checks(log, [held("fleets", "a broken fleet is refused in words that name the fault", cases)])
        advance("broken fleets")
        _write(log, "detected", detected_rows(_new(folder, "machines")))
        _write_checks(log, detection_checks(_new(folder, "detection")))
        advance("detection")
        _write_checks(log, hook_checks(pairs, _new(folder, "hooks")))
        _write_checks(log, rollout_checks(pairs, _new(folder, "rollout")))
        advance("machines")
        _write_checks(log, await _containers(config, pairs, _new(folder, "containers")))
        advance("containers")
        if config.build:
            _write_checks(log, _images(pairs[0][0], wheel, _new(folder, "images"), project.runs / "cache"))
        advance("images")
    return path


def _new(folder: Path, name: str) -> Path:
    (folder / name).mkdir()
    return folder / name


def _write(log: LogWriter, table: str, rows: Iterable[Any]) -> None:
    for row in rows:
        log.write_row(table, row, log_time_ns=time.time_ns())


def _attach(log: LogWriter, pairs: Sequence[tuple[Deployment, Bundle]]) -> None:
    """Keep one agent's texts whole, and of the others what differs most."""
    for number, (_, bundle) in enumerate(pairs):
        for path, member in bundle.members.items():
            if path in _OF_ALL or (number == 0 and not path.startswith(_TOO_LONG)):
                log.attach(f"{bundle.agent}/{path}", member.data, media_type="text/plain")


def _write_checks(log: LogWriter, rows: Iterable[DeployCheckRow | UncheckedRow]) -> None:
    for row in rows:
        _write(log, "unchecked" if isinstance(row, UncheckedRow) else "check", [row])


async def _containers(
    config: Config, pairs: Sequence[tuple[Deployment, Bundle]], folder: Path
) -> list[DeployCheckRow | UncheckedRow]:
    """Run the containers' commands where the machine has namespaces."""
    chosen = [pair for pair in pairs if pair[0].agent.name in config.containers]
    if not chosen:
        return []
    capability = Network.available()
    if not capability.ok:
        check = "agents in containers discover each other through their routers"
        return [UncheckedRow(group="containers", check=check, why=capability.reason)]
    rows = await container_checks(chosen, folder)
    return [DeployCheckRow(group="containers", **asdict(row)) for row in rows]


def _images(
    deployment: Deployment, wheel: bytes, folder: Path, cache: Path
) -> Iterator[DeployCheckRow | UncheckedRow]:
    """Build the image of one agent where the tools are, and ask it; downloads are kept for the next run."""
    path = folder / deployment.release.wheel
    path.write_bytes(wheel)
    for check in trial_build(deployment, path, folder, lambda _: None, cache=cache):
        if check.holds is None:
            yield UncheckedRow(group="images", check=check.check, why=check.seen)
        else:
            yield held("images", check.check, [(check.seen, check.holds)])

"""The experiment: a fleet's files made and checked, broken fleets, machines, containers, images."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from sfglab.deploy.bundle import Bundle, load_source, prepare
from sfglab.deploy.fleet_check import check_fleet
from sfglab.deploy.release import SOURCE, make_release
from sfglab.lab.checks import CheckRow
from sfglab.lab.checks.fleet_files import file_rows, layer_rows, refused_rows, release_checks, verdict_rows
from sfglab.lab.checks.machines import (
    Unasked,
    detected_rows,
    detection_checks,
    held,
    hook_checks,
    rollout_checks,
)
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.experiments.deployment.containers import OUTSIDER, container_checks
from sfglab.lab.hosts import Network
from sfglab.lab.paths import find_project
from sfglab.lab.trial_build import trial_build

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.deploy.deployment import Deployment
    from sfglab.lab.bench import Bench

    Pairs = Sequence[tuple[Deployment, Bundle]]

_OF_ALL = ("Dockerfile", "compose.yaml")
_TOO_LONG = ("image/requirements.lock", "image/sfglab-")


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    agents: tuple[str, ...] = ()  #: Whose files are rendered, checked and applied; none: all.
    fleet_file: str = "fleets/esslingen.yaml"  #: The fleet, in the data folder.
    #: Agents whose containers' commands are run over DDS between namespaces; none: not at all.
    containers: tuple[str, ...] = ("go2", "pi1", "workstation")
    build: bool = True  #: Whether images are built, where the tools are.
    seed: int = 0  #: Of nothing that is random; for the record.


exp = Experiment(
    "deployment",
    Config,
    where="A 4.4",
    smoke={"agents": ("go2", "steamdeck"), "containers": (), "build": False},
    paper={"containers": ("go2", *(f"pi{i}" for i in range(1, 7)), "steamdeck", "workstation")},
    actors=(
        Actor("agent", "container on the machine's bridge", "discovers the others", count="one a machine"),
        Actor("router", "machine", "lets global names out", count="one a machine"),
        Actor("onlooker", OUTSIDER, "looks at all domains from outside"),
    ),
    links=(
        Link("agent", "router", "its own domain"),
        Link("router", "agent", "what other agents say"),
        Link("router", "onlooker", "the global domain", boundary="network"),
    ),
)


@exp.table("check")
@dataclass(frozen=True, slots=True, kw_only=True)
class DeployCheckRow(CheckRow):
    """A property that was checked."""

    group: str  #: Which part of the deployment it is of.


@exp.table("unchecked")
class UncheckedRow:
    """A property that nobody could check here."""

    group: str  #: Which part of the deployment it is of.
    check: str  #: The property.
    why: str  #: What is missing.


@exp.table("detected")
class DetectedRow:
    """What detection says of a machine."""

    machine: str  #: Its name among the examples, or ``this machine``.
    accelerator: str  #: What its images are made for.
    why: str  #: The reason for it.
    #: Accelerators that are there and were not taken, and those that could be thought to be there.
    instead: str


@exp.table("file")
class BundleFileRow:
    """A file that a machine is given."""

    agent: str  #: Whose machine.
    path: str  #: Within the agent's folder.
    meaning: str  #: What it is for.
    size_bytes: int  #: Its size.
    lines: int  #: Its lines; 0 for what is no text.
    sha256: str  #: Its digest.


@exp.table("layer")
class LayerRow:
    """One layer of an agent's image."""

    agent: str  #: Whose.
    layer: str  #: ``base``, ``adapter`` or ``application``.
    says: str  #: What makes it differ from other agents' layers.
    digest: str  #: Of its instructions and all below; equal digests are one layer.


@exp.table("refused")
class RefusedFleetRow:
    """A broken fleet and what `sfglab deploy check` says of it."""

    fault: str  #: What is wrong with it.
    refused: bool  #: Whether it was refused in the words that name it.
    said: str  #: The words.


def _write(bench: Bench[Config], group: str, *rows: CheckRow | Unasked) -> None:
    for row in rows:
        table = "check" if isinstance(row, CheckRow) else "unchecked"
        bench.write(table, {"group": group, **asdict(row)})


@exp.part("fleet", total=7)
async def deploy(bench: Bench[Config]) -> None:
    """Make the fleet's files; check them, broken fleets, machines, containers, an image."""
    config = bench.config
    source = load_source(find_project().data / config.fleet_file)
    release, wheel = make_release(SOURCE, source.text)
    pairs = prepare(source, release, wheel, agents=config.agents)
    bench.write_all("file", file_rows(pairs))
    bench.write_all("layer", layer_rows(pairs))
    _attach(bench, pairs)
    _write(bench, "release", *release_checks(pairs))
    bench.advance("files")
    verdicts = check_fleet(source, release, agents=config.agents)
    _write(bench, "files", *verdict_rows(verdicts, {str(source.path): config.fleet_file}))
    bench.advance("checked")
    refused = list(refused_rows(source.text, release, bench.folder("broken")))
    bench.write_all("refused", refused)
    cases = ((row["fault"], row["refused"]) for row in refused)
    _write(bench, "fleets", held("a broken fleet is refused in words that name the fault", cases))
    bench.advance("broken fleets")
    bench.write_all("detected", detected_rows(bench.folder("machines")))
    _write(bench, "detection", *detection_checks(bench.folder("detection")))
    bench.advance("detection")
    _write(bench, "hooks", *hook_checks(pairs, bench.folder("hooks")))
    _write(bench, "rollout", *rollout_checks(pairs, bench.folder("rollout")))
    bench.advance("machines")
    await _try_containers(bench, pairs)
    bench.advance("containers")
    if config.build:
        _write(bench, "images", *_images(bench, pairs[0][0], wheel))
    bench.advance("images")


def _attach(bench: Bench[Config], pairs: Pairs) -> None:
    """Keep one agent's texts whole, and of the others what differs most."""
    for number, (_, bundle) in enumerate(pairs):
        for path, member in bundle.members.items():
            if path in _OF_ALL or (number == 0 and not path.startswith(_TOO_LONG)):
                bench.attach(f"{bundle.agent}/{path}", member.data, "text/plain")


async def _try_containers(bench: Bench[Config], pairs: Pairs) -> None:
    """Run the containers' commands where the machine has namespaces."""
    chosen = [pair for pair in pairs if pair[0].agent.name in bench.config.containers]
    if not chosen:
        return
    capability = Network.available()
    if capability.ok:
        _write(bench, "containers", *await container_checks(chosen, bench.folder("containers")))
    else:
        check = "agents in containers discover each other through their routers"
        _write(bench, "containers", Unasked(check=check, why=capability.reason))


def _images(bench: Bench[Config], deployment: Deployment, wheel: bytes) -> Sequence[CheckRow | Unasked]:
    """Build the image of one agent where the tools are, and ask it; downloads are kept for the next run."""
    folder, cache = bench.folder("images"), find_project().runs / "cache"
    path = folder / deployment.release.wheel
    path.write_bytes(wheel)
    return trial_build(deployment, path, folder, lambda _: None, cache=cache)

"""Configuration, tables and the part of the experiment on deployment.

Each fact of `facts.FACTS` gets one row: a program of another project confirmed the fact, refuted it, or was not
installed. The functions `ask_...` run a program and return its fault per fact, empty if the program confirms the fact.
"""

from __future__ import annotations

from dataclasses import dataclass
from hashlib import sha256
from typing import TYPE_CHECKING

from sfglab.codecs.probe import SOFTWARE
from sfglab.deploy.bases import base_of
from sfglab.deploy.bundle import load_source, prepare, write_bundle
from sfglab.deploy.checks import State, check_bundles
from sfglab.deploy.errors import DeployError
from sfglab.deploy.hardware import codecs_found, detect
from sfglab.deploy.programs import run_streamed
from sfglab.deploy.release import SOURCE, make_release
from sfglab.fleet.fleet_file import Accelerator
from sfglab.lab.bench import TableRow
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.experiments.deployment.containers import OUTSIDER, ask_containers
from sfglab.lab.experiments.deployment.facts import CODEC, FACTS, TRIAL, Outcome, accepted
from sfglab.lab.experiments.deployment.image import ask_image
from sfglab.lab.hosts import Network
from sfglab.lab.paths import find_project

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping
    from pathlib import Path

    from sfglab.lab.bench import Bench
    from sfglab.lab.experiments.deployment.containers import Pairs

LAYERS = ("base", "adapter", "application")
"""Layers of an image from the hardware upwards: paper A, Fig. 5."""
_HOOKS_S = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """Agents whose files are rendered, and facts that take long to ask about."""

    agents: tuple[str, ...] = ()  #: Names of the agents; empty: all.
    fleet_file: str = "fleets/esslingen.yaml"  #: Fleet file, in the data folder.
    #: Agents whose containers' commands run over DDS between namespaces; empty: none.
    containers: tuple[str, ...] = ("go2", "pi1", "workstation")
    build: bool = True  #: Whether an image is built, if the programs for it are installed.
    seed: int = 0  #: Seed without an effect, which every experiment has.


exp = Experiment(
    "deployment",
    Config,
    where="A 4.4",
    smoke={"agents": ("go2", "steamdeck"), "containers": (), "build": False},
    paper={"containers": ("go2", *(f"pi{i}" for i in range(1, 7)), "steamdeck", "workstation")},
    actors=(
        Actor("agent", "container on the machine's bridge", "discovers the others"),
        Actor("router", "machine", "forwards global names"),
        Actor("others", "other machines", "an agent and a router on each"),
        Actor("onlooker", OUTSIDER, "joins all domains, and records what it receives"),
    ),
    links=(
        Link("agent", "router", "data in the agent's own domain"),
        Link("router", "agent", "data of other agents"),
        Link("router", "others", "global names, in both directions", boundary="network"),
        Link("router", "onlooker", "global names", boundary="network"),
    ),
)


@exp.table("fact")
class FactRow(TableRow):
    """One fact of `facts.FACTS` with its outcome."""

    end: str  #: Part of the claim.
    fact: str  #: The statement.
    program: str  #: Program of another project that confirms it.
    outcome: str  #: One of `Outcome`.
    detail: str  #: Fault that the program named; empty: none.


@exp.table("layer")
class LayerRow(TableRow):
    """One layer of an agent's image."""

    agent: str  #: Name of the agent.
    layer: str  #: One of `LAYERS`.
    says: str  #: Difference from the layers of other agents.
    digest: str  #: Digest of its instructions and of all layers below; equal digests are one layer.


@exp.part("fleet", total=4)
async def deploy(bench: Bench[Config]) -> None:
    """Render the files of a fleet, and check each fact with a program of another project."""
    config = bench.config
    source = load_source(find_project().data / config.fleet_file)
    release, wheel = make_release(SOURCE, source.text)
    pairs = prepare(source, release, wheel, agents=config.agents)
    bench.write_all("layer", layer_rows(pairs))
    faults = ask_checkers(pairs) | ask_codecs()
    bench.advance("files")
    faults |= ask_hooks(pairs, bench.folder("hooks"))
    bench.advance("hooks")
    chosen = [pair for pair in pairs if pair[0].agent.name in config.containers]
    if chosen and Network.available().ok:
        faults |= await ask_containers(chosen, bench.folder("containers"))
    bench.advance("containers")
    if config.build:
        faults |= ask_image(pairs[0][0], wheel, bench.folder("image"))
    bench.advance("image")
    bench.write_all("fact", fact_rows(faults))


def fact_rows(faults: Mapping[str, str]) -> Iterator[FactRow]:
    """Yield a row for each fact.

    Args:
        faults: Fault that a program reported, by fact; empty for a confirmed fact. Facts that no program checked are
            missing.
    """
    for fact in FACTS:
        outcome = Outcome.MISSING
        if fact.name in faults:
            outcome = Outcome.REFUSED if faults[fact.name] else Outcome.CONFIRMED
        yield FactRow(
            end=fact.end,
            fact=fact.name,
            program=fact.program,
            outcome=outcome.value,
            detail=faults.get(fact.name, ""),
        )


def layer_rows(pairs: Pairs) -> Iterator[LayerRow]:
    """Yield the three layers of each agent's image."""
    for deployment, bundle in pairs:
        lines = bundle.members["Dockerfile"].text.splitlines(keepends=True)
        instructions = "".join(line for line in lines if not line.startswith("#"))
        says = {
            "base": base_of(deployment).image.rpartition("/")[2],
            "adapter": f"ROS 2 {deployment.common.ros.value}, {deployment.host.architecture.value}",
            "application": bundle.tag,
        }
        for layer in LAYERS:
            below, _, above = instructions.partition(f" AS {layer}\n")
            stage = above.partition("\nFROM ")[0]
            digest = sha256((below + stage).encode()).hexdigest()
            yield LayerRow(agent=bundle.agent, layer=layer, says=says[layer], digest=digest)


def ask_checkers(pairs: Pairs) -> dict[str, str]:
    """Check all files with the installed programs of `sfglab deploy check`, and return the fault by fact."""
    verdicts = check_bundles(bundle for _, bundle in pairs)
    asked = [verdict for verdict in verdicts if verdict.state is not State.NOT_RUN]
    return {accepted(verdict.check): verdict.detail for verdict in asked}


def ask_codecs() -> dict[str, str]:
    """Let FFmpeg open the codecs of the detected accelerator, if there is one, and return the fault by fact."""
    machine = detect()
    if machine.accelerator is Accelerator.NONE:
        return {}
    expected = [one for one in codecs_found(machine) if one.expected and one.name not in SOFTWARE]
    if any(codec.works for codec in expected):
        return {CODEC: ""}
    tried = "; ".join(f"{codec.name}: {codec.tried}" for codec in expected)
    return {CODEC: tried or f"{machine.accelerator.value} has no H.264 codec"}


def ask_hooks(pairs: Pairs, folder: Path) -> dict[str, str]:
    """Let Bash run the hooks of each agent on a folder in place of its host, and return the fault by fact."""
    faults = []
    for deployment, bundle in pairs:
        root = folder / bundle.agent
        home = root / deployment.folder.lstrip("/")
        write_bundle(bundle, home)
        (home / "hooks/custom.d/50-mine.sh").write_text('mkdir -p "$SFGLAB_ROOT/mine"\n')
        fault = _hook_fault(home / "hooks/initialize.sh", root)
        if fault:
            faults.append(f"{bundle.agent}: {fault}")
    return {TRIAL: "; ".join(faults)}


def _hook_fault(script: Path, root: Path) -> str:
    """Run the hooks twice; return the first fault."""
    command = ["env", f"SFGLAB_ROOT={root}", "timeout", f"{_HOOKS_S}", str(script)]
    states = [_snapshot(root)]
    try:
        for _ in range(2):
            run_streamed(command, lambda _: None)
            states.append(_snapshot(root))
    except DeployError as error:
        return str(error)
    before, prepared, again = states
    if prepared == before:
        return "they change nothing"
    if again != prepared:
        return "a second run changes files"
    return "" if (root / "mine").exists() else "a script of the user does not run"


def _snapshot(root: Path) -> dict[Path, int]:
    """Return the time stamps of all files below a folder."""
    return {path: path.lstat().st_mtime_ns for path in root.rglob("*") if path.is_file()}

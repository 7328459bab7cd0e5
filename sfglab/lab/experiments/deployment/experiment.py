"""The experiment: a fleet's files made and checked, broken fleets, machines, containers, images.

The claim A-DEPLOY is the share of checks that hold; what could not be checked on the machine of the run leaves
it undecided. The figures: layers as in Fig. 5, and what was checked.
"""

from __future__ import annotations

import re
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any

from sfglab.deploy.bundle import Bundle, load_source, prepare
from sfglab.deploy.fleet_check import check_fleet
from sfglab.deploy.release import SOURCE, make_release
from sfglab.lab.checks import CheckRow, lowest_share, machines
from sfglab.lab.checks.fleet_files import (
    file_rows,
    layer_rows,
    refused_rows,
    release_checks,
    verdict_rows,
)
from sfglab.lab.checks.machines import Unasked, held
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.experiments.deployment.containers import OUTSIDER, container_checks
from sfglab.lab.figures import COLORS, note, word_table
from sfglab.lab.hosts import Network
from sfglab.lab.paths import find_project
from sfglab.lab.trial_build import trial_build

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.deploy.deployment import Deployment
    from sfglab.lab.bench import Bench
    from sfglab.lab.runs import Run

    Pairs = Sequence[tuple[Deployment, Bundle]]

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

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
        Actor(
            "agent",
            "container on the machine's bridge",
            "discovers the others",
            count="one a machine",
        ),
        Actor("router", "machine", "lets global names out", count="one a machine"),
        Actor("onlooker", OUTSIDER, "looks at all domains from outside"),
    ),
    links=(
        Link("agent", "router", "its own domain"),
        Link("router", "agent", "what other agents say"),
        Link("router", "onlooker", "the global domain", boundary="network"),
    ),
)

PARTS = {
    "three image layers": (
        "images",
        "are built with ROS 2 and an accelerator",
        "neither's packages are at hand",
    ),
    "accelerator detection": (
        "detection",
        "on a machine that has one",
        "machines are folders from documentation",
    ),
    "two containers": (
        "containers",
        "Docker Compose starts them",
        "their commands run between namespaces",
    ),
    "systemd": ("files", "systemd starts the unit", "it is verified, and nobody starts it"),
    "dev container": ("files", "VS Code opens it", "its files are checked, and nobody opens them"),
    "hooks": ("hooks", "as root on a machine", "they run on folders in place of machines"),
}
"""By part of the claim the group of its checks, what takes a machine of the fleet, and what is done instead."""


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
        bench.write(
            "check" if isinstance(row, CheckRow) else "unchecked", {"group": group, **asdict(row)}
        )


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
    bench.write_all("detected", machines.detected_rows(bench.folder("machines")))
    _write(bench, "detection", *machines.detection_checks(bench.folder("detection")))
    bench.advance("detection")
    _write(bench, "hooks", *machines.hook_checks(pairs, bench.folder("hooks")))
    _write(bench, "rollout", *machines.rollout_checks(pairs, bench.folder("rollout")))
    bench.advance("machines")
    await _try_containers(bench, pairs)
    bench.advance("containers")
    if config.build:  # of one agent, where the tools are; downloads are kept for the next run
        folder, release = bench.folder("images"), pairs[0][0].release
        (folder / release.wheel).write_bytes(wheel)
        cache = find_project().runs / "cache"
        built = trial_build(
            pairs[0][0], folder / release.wheel, folder, lambda _: None, cache=cache
        )
        _write(bench, "images", *built)
    for part, (group, machine, why) in PARTS.items():
        _write(bench, group, Unasked(check=f"{part}: {machine}", why=why))
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


def _how(run: Run[Config]) -> How:
    """Return live where containers' commands did run; all else is checked on files and folders."""
    return How.LIVE if (run["check"]["group"] == "containers").any() else How.EXACT


@exp.claim("A-DEPLOY", how=_how)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of checks that hold, in the group where it is lowest."""
    share, refused = lowest_share(run["check"], "group"), run["refused"]["refused"]
    details = {
        **share.groups,
        "agents": ", ".join(dict.fromkeys(run["file"]["agent"])),
        "files of all machines": str(len(run["file"])),
        "broken fleets refused": f"{int(refused.sum())} of {len(refused)}",
        **{f"not checked here: {row.check}": str(row.why) for row in run["unchecked"].itertuples()},
    }
    return Finding(estimate=share.estimate, details=details, reason=share.reason, ends=_parts(run))


def _parts(run: Run[Config]) -> dict[str, float]:
    """Return the share that holds of every part of which nothing was left unchecked, on a machine neither."""
    sums, unchecked = (
        run["check"].groupby("group")[["held", "checked"]].sum(),
        set(run["unchecked"]["group"]),
    )
    asked, shares = set(run["check"]["check"]), sums["held"] / sums["checked"]
    return {
        part: float(shares[group])
        for part, (group, machine, _) in PARTS.items()
        if f"{part}: {machine}" in asked and group not in unchecked
    }


_LAYERS = {"base": COLORS["standard"], "adapter": COLORS["proxy"], "application": COLORS["third"]}
"""Paper A, Fig. 5, from the hardware upwards."""


@exp.figure("deployment_layers", size=(6.4, 2.7))
def draw_layers(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw every agent's image as three layers; what is the same for several is one box."""
    agents = list(dict.fromkeys(run["layer"]["agent"]))
    figure.set_size_inches(1.3 + 0.96 * len(agents), 2.7)
    axes = figure.subplots()
    for row, (layer, color) in enumerate(_LAYERS.items()):
        table = run["layer"][run["layer"]["layer"] == layer].set_index("agent").loc[agents]
        for _, same in groupby(range(len(agents)), key=list(table["digest"]).__getitem__):
            places = list(same)
            _box(axes, (places[0], places[-1], row), table["says"].iloc[places[0]], color)
    axes.set_xticks(range(len(agents)), agents)
    axes.set_yticks(range(len(_LAYERS)), ["hardware base", "adapter", "application"])
    axes.set(xlim=(-0.55, len(agents) - 0.45), ylim=(-0.5, len(_LAYERS) - 0.5))
    counts = run["layer"].groupby("layer")["digest"].nunique()
    said = f"{counts['base']} hardware bases and {counts['adapter']} adapters carry {len(agents)} agents"
    axes.set_title(f"{said}; a box across agents is the same layer")
    note(figure, "exact: as rendered from the fleet file (paper A, Fig. 5)")
    axes.tick_params(length=0)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)
    return {"agents": len(agents), **{f"distinct {name}": int(n) for name, n in counts.items()}}


def _box(axes: Axes, place: tuple[int, int, int], text: str, color: str) -> None:
    from matplotlib.patches import FancyBboxPatch

    first, last, row = place
    corner, width, shape = (
        (first - 0.44, row - 0.36),
        last - first + 0.88,
        "round,pad=0.02,rounding_size=0.05",
    )
    look: dict[str, Any] = {"facecolor": color, "alpha": 0.28, "linewidth": 0}
    axes.add_patch(FancyBboxPatch(corner, width, 0.72, boxstyle=shape, **look))
    shown = text if last > first else "\n".join(re.findall(r".{1,13}(?:[-:, ]|$)|.{13}", text))
    axes.text((first + last) / 2, row, shown, ha="center", va="center", fontsize=7)


@exp.figure("deployment_checks", size=(6.4, 3.0))
def draw_checks(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw what was checked of each part of the deployment, how many cases hold, and what nobody could ask."""
    sums = run["check"].groupby("group", sort=False)[["held", "checked"]].sum()
    kinds, left = run["check"].groupby("group")["check"].nunique(), run["unchecked"]["check"]
    rows = {}
    for group in dict.fromkeys([*sums.index, *run["unchecked"]["group"]]):
        held, checked = sums.loc[group] if group in sums.index else (0, 0)
        holds = f"{held} of {checked} (properties: {kinds[group]})" if checked else ""
        open_ = "; ".join(left[run["unchecked"]["group"] == group])
        color = "network" if not checked else "proxy" if held == checked else "standard"
        rows[group] = [(holds, COLORS[color]), (open_, COLORS["network" if open_ else "proxy"])]
    word_table(figure, ["cases that hold", "what could not be asked there"], rows, wrap=36)
    rest = (
        f"\n{len(left)} properties could not be tested on that machine; verdict: undecided"
        * bool(len(left))
    )
    figure.suptitle(
        f"{sums['held'].sum()} of {sums['checked'].sum()} cases hold{rest}", fontsize=10
    )
    note(figure, "exact, on files and folders; containers live, between network namespaces")
    shown = {str(row.Index): f"{row.held} of {row.checked}" for row in sums.itertuples()}
    return {**shown, "not asked": len(left)}

"""Commands that deploy a fleet to its target hosts: ``sfglab deploy``."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Option

from sfglab.cli.buses import say
from sfglab.cli.options import Agents, FleetFile, Json

if TYPE_CHECKING:
    from sfglab.deploy.bundle import FleetSource
    from sfglab.deploy.deployment import Release
    from sfglab.deploy.rollout import Prospect

app = typer.Typer(
    help="""Deploy a fleet: detect hardware, plan changes, render, check and apply files.

Examples:
  sfglab deploy plan data/fleets/esslingen.yaml
  sfglab deploy apply data/fleets/esslingen.yaml"""
)
_Root = Annotated[
    Path | None,
    Option(help="Folder in place of the host's /, e.g. a mounted disk image. [default: /]"),
]
_Accelerator = Annotated[
    Literal["auto", "jetson", "cuda", "rocm", "vaapi", "v4l2", "none"] | None,
    Option(help="Accelerator of the hosts; auto detects it. [default: the fleet file's]"),
]


@app.command()
def detect(
    root: _Root = None,
    as_json: Json = False,
) -> None:
    """Report the video accelerator of a host with the reason, and the codecs that work.

    Examples:
      sfglab deploy detect
      sfglab deploy detect --root /mnt/sdcard
    """
    from sfglab.deploy.hardware import codecs_found, render_machine
    from sfglab.deploy.hardware import detect as detect_machine

    machine = detect_machine(root or Path("/"))
    codecs = codecs_found(machine) if root in {None, Path("/")} else None
    values = {"machine": machine, "codecs": codecs}
    say(values, render_machine(machine, codecs), as_json=as_json)


@app.command()
def plan(
    fleet: FleetFile,
    agent: Agents = None,
    root: _Root = None,
    accelerator: _Accelerator = None,
    as_json: Json = False,
) -> None:
    """Report the changes that apply would make on each host, without making any.

    Hosts are read over SSH. Unreachable hosts are reported; planning continues for the others.

    Examples:
      sfglab deploy plan data/fleets/esslingen.yaml
      sfglab deploy plan data/fleets/esslingen.yaml --agent go2
    """
    from sfglab.deploy.rollout import render_prospects

    prospects = [prospect for prospect, _ in _prospects(fleet, agent, root, accelerator)]
    say(prospects, render_prospects(prospects), as_json=as_json)
    unplanned = [prospect for prospect in prospects if prospect.plan is None]
    raise typer.Exit(bool(unplanned))


@app.command()
def render(
    fleet: FleetFile,
    output: Annotated[
        Path, Option("--output", "-o", help="Folder in which each agent gets a folder.")
    ],
    agent: Agents = None,
    accelerator: _Accelerator = None,
) -> None:
    """Write all files of the agents into a folder, for reading or for copying by hand.

    Examples:
      sfglab deploy render data/fleets/esslingen.yaml -o build/esslingen
      sfglab deploy render data/fleets/esslingen.yaml -o build/laptop --agent workstation --accelerator none
    """
    from sfglab.deploy.bundle import prepare, write_bundle
    from sfglab.deploy.transport import chooser

    for _, bundle in prepare(*_release(fleet), agents=agent or (), choose=chooser(accelerator)):
        folder = output / bundle.agent
        write_bundle(bundle, folder)
        typer.echo(f"{folder}: {len(bundle.members)} files, release {bundle.tag}")


@app.command()
def check(
    fleet: FleetFile,
    agent: Agents = None,
    accelerator: _Accelerator = None,
    require: Annotated[
        bool, Option("--require", help="Also fail if a program for a check is not installed.")
    ] = False,
    as_json: Json = False,
) -> None:
    """Check a fleet file and the files that render writes, with programs of other projects.

    Programs: check-jsonschema (Compose and dev container files), hadolint (Dockerfiles), shellcheck (scripts),
    Docker Compose (projects), systemd-analyze (units). Programs that are not installed are named. The exit
    status is 1 if a check fails, and with --require also if one was not run.

    Examples:
      sfglab deploy check data/fleets/esslingen.yaml
      sfglab deploy check data/fleets/esslingen.yaml --require
    """
    from tqdm import tqdm

    from sfglab.deploy.bundle import prepare
    from sfglab.deploy.checks import CHECKS, State, check_bundles, check_fleet, render_verdicts
    from sfglab.deploy.transport import chooser

    source, release, wheel = _release(fleet)
    verdicts = [check_fleet(source.fleet)]
    if verdicts[0].state is State.PASSED:
        made = prepare(source, release, wheel, agents=agent or (), choose=chooser(accelerator))
        running = check_bundles(bundle for _, bundle in made)
        bar = tqdm(running, total=len(CHECKS), unit=" checks", leave=False, disable=None)
        verdicts += bar
    say(verdicts, render_verdicts(verdicts), as_json=as_json)
    states = {verdict.state for verdict in verdicts}
    raise typer.Exit(State.FAILED in states or (require and State.NOT_RUN in states))


@app.command()
def apply(
    fleet: FleetFile,
    agent: Agents = None,
    root: _Root = None,
    tag: Annotated[
        str | None,
        Option(
            help="Release to roll back to, one that sfglab deploy releases lists. [default: a new one]"
        ),
    ] = None,
    accelerator: _Accelerator = None,
) -> None:
    """Copy the files to each host, prepare it, build its container image there and start it.

    A failure on one host does not stop the others; apply again to continue after it.

    Examples:
      sfglab deploy apply data/fleets/esslingen.yaml
      sfglab deploy apply data/fleets/esslingen.yaml --agent go2
      sfglab deploy apply data/fleets/esslingen.yaml --agent go2 --tag 0.1.0-1a2b3c4d5e6f
    """
    from sfglab.deploy.errors import DeployError
    from sfglab.deploy.rollout import render_prospects

    # All hosts are read before the first one is changed.
    prospects = list(_prospects(fleet, agent, root, accelerator, tag))
    failed = False
    for prospect, action in prospects:
        typer.echo(render_prospects([prospect]))
        failed = failed or prospect.plan is None
        try:
            action()
        except DeployError as error:
            typer.echo(f"sfglab: {error}", err=True)
            failed = True
    raise typer.Exit(failed)


@app.command()
def releases(
    fleet: FleetFile, agent: Agents = None, root: _Root = None, as_json: Json = False
) -> None:
    """List the releases that each host keeps, newest first, for apply --tag.

    Example:
      sfglab deploy releases data/fleets/esslingen.yaml --agent go2
    """
    from sfglab.deploy.deployment import HOME
    from sfglab.deploy.errors import DeployError
    from sfglab.deploy.rollout import releases as kept
    from sfglab.deploy.transport import transport_to
    from sfglab.fleet.fleet_file import load_fleet

    described = load_fleet(fleet)
    hosted = [one.name for one in described.agents if one.host is not None]
    failed = False
    for name in agent or hosted:
        host = described.agent(name).host
        if host is None:
            raise DeployError(f"{fleet}: agents.{name}: no host is given; add the key host")
        try:
            found = kept(transport_to(host, root=root), f"{HOME}/{name}")
        except DeployError as error:
            typer.echo(f"sfglab: {error}", err=True)
            failed = True
            continue
        say({name: found}, f"{name}: {', '.join(found) or 'none'}", as_json=as_json)
    raise typer.Exit(failed)


def _release(fleet: Path) -> tuple[FleetSource, Release, bytes]:
    """Return a fleet file, its release and the wheel."""
    from sfglab.deploy.bundle import load_source
    from sfglab.deploy.release import SOURCE, make_release

    source = load_source(fleet)
    return source, *make_release(SOURCE, source.text)


def _prospects(
    fleet: Path,
    agents: list[str] | None,
    root: Path | None,
    accelerator: str | None,
    tag: str | None = None,
) -> Iterator[tuple[Prospect, Callable[[], None]]]:
    """Yield the changes of each agent and the call that makes them; a failure does not stop the others."""
    from sfglab.deploy.bundle import prepare
    from sfglab.deploy.errors import DeployError
    from sfglab.deploy.rollout import Prospect, apply_bundle, look, plan_changes, released, steps
    from sfglab.deploy.transport import chooser, transport_to

    source, release, wheel = _release(fleet)
    choose = chooser(accelerator, root)
    for name in agents or [agent.name for agent in source.fleet.agents]:
        host = source.fleet.agent(name).host
        machine = "?" if host is None else transport_to(host, root=root).name
        prospect = partial(Prospect, agent=name, machine=machine)
        try:
            ((deployment, bundle),) = prepare(source, release, wheel, agents=[name], choose=choose)
            transport = transport_to(deployment.host, root=root)
            if tag is not None:
                bundle = released(transport, deployment, tag)
            plan = plan_changes(bundle, look(transport, deployment.folder))
        except DeployError as error:
            yield prospect(plan=None, problem=str(error)), lambda: None
            continue
        following = steps(deployment, bundle, plan)
        folder = deployment.folder
        action = partial(apply_bundle, bundle, folder, following, transport, typer.echo)
        yield prospect(plan=plan, steps=following), action

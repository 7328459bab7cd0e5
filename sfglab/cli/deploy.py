"""Commands that bring a fleet to its machines: look, plan, write, check, apply, go back."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from typer import Argument, Option

from sfglab.cli.buses import Json, say
from sfglab.deploy.errors import DeployError

if TYPE_CHECKING:
    from sfglab.deploy.bundle import FleetSource
    from sfglab.deploy.rollout import Prospect

app = typer.Typer(
    help="A fleet's machines: what they have, what they are given, and bringing it there.",
    no_args_is_help=True,
)
_Fleet = Annotated[Path, Argument(help="A fleet file, e.g. data/fleets/esslingen.yaml")]
_Agents = Annotated[
    list[str] | None, Option("--agent", help="One agent; may be given again. All when not given.")
]
_Root = Annotated[
    Path | None, Option(help="A folder in place of the machine's root, e.g. of an image of a disk.")
]
_Accelerator = Annotated[
    str | None,
    Option(
        help="Whatever the file says: jetson, cuda, rocm, vaapi, v4l2, none, or auto to detect it."
    ),
]
_Diff = Annotated[bool, Option("--diff", help="Show changed texts line by line.")]


@app.command()
def detect(
    root: Annotated[Path, Option(help="Folder that stands for the machine's root.")] = Path("/"),
    as_json: Json = False,
) -> None:
    """Say which accelerator a machine has and why, and which codecs really open here.

    Examples:
      sfglab deploy detect
      sfglab deploy detect --root /mnt/sdcard
    """
    from sfglab.deploy.hardware.detection import codecs_found
    from sfglab.deploy.hardware.detection import detect as detect_machine
    from sfglab.deploy.hardware.machine import render_machine

    machine = detect_machine(root)
    codecs = codecs_found(machine) if root.resolve() == Path("/") else None
    say(
        {"machine": machine, "codecs": codecs},
        lambda _: render_machine(machine, codecs),
        as_json=as_json,
    )


@app.command()
def plan(
    fleet: _Fleet,
    agent: _Agents = None,
    root: _Root = None,
    accelerator: _Accelerator = None,
    diff: _Diff = False,
    as_json: Json = False,
) -> None:
    """Say what would change on each machine; changes nothing.

    Machines are asked over SSH; one that cannot be reached is told, and the others are planned.

    Examples:
      sfglab deploy plan data/fleets/esslingen.yaml
      sfglab deploy plan data/fleets/esslingen.yaml --agent go2 --diff
    """
    from sfglab.deploy.rollout import render_prospects

    prospects = [
        prospect for prospect, _ in _prospects(_source(fleet, agent, accelerator), agent, root)
    ]
    say(prospects, partial(render_prospects, diff=diff), as_json=as_json)
    raise typer.Exit(any(prospect.plan is None for prospect in prospects))


@app.command()
def render(
    fleet: _Fleet,
    output: Annotated[Path, Option("--output", "-o", help="Folder; each agent gets one in it.")],
    agent: _Agents = None,
    accelerator: _Accelerator = None,
) -> None:
    """Write all files of the agents into a folder, to be read or brought there by other means.

    Examples:
      sfglab deploy render data/fleets/esslingen.yaml -o build/esslingen
      sfglab deploy render data/fleets/esslingen.yaml -o build/laptop --agent workstation --accelerator none
    """
    from sfglab.deploy.bundle import prepare, write_bundle
    from sfglab.deploy.release import SOURCE, make_release
    from sfglab.deploy.transport import detect_over

    source = _source(fleet, agent, accelerator)
    release, wheel = make_release(SOURCE, source.text)
    for _, bundle in prepare(source, release, wheel, agents=tuple(agent or ()), detect=detect_over):
        folder = output / bundle.agent
        write_bundle(bundle, folder)
        typer.echo(f"{folder}: {len(bundle.members)} files, release {bundle.tag}")


@app.command()
def check(
    fleet: _Fleet,
    agent: _Agents = None,
    accelerator: _Accelerator = None,
    every: Annotated[bool, Option("--all", help="List what holds as well.")] = False,
    as_json: Json = False,
) -> None:
    """Check a fleet and everything that would be made of it; ends with 1 if something does not hold.

    Example:
      sfglab deploy check data/fleets/esslingen.yaml
    """
    from tqdm import tqdm

    from sfglab.deploy.fleet_check import check_fleet, fails
    from sfglab.deploy.release import SOURCE, make_release
    from sfglab.deploy.transport import detect_over
    from sfglab.deploy.verdicts import render_verdicts

    source = _source(fleet, agent, accelerator)
    release, _ = make_release(SOURCE, source.text)
    bar = partial(
        tqdm, total=len(agent or source.fleet.agents), unit=" agents", leave=False, disable=None
    )
    verdicts = check_fleet(
        source, release, agents=tuple(agent or ()), detect=detect_over, progress=bar
    )
    say(verdicts, partial(render_verdicts, every=every), as_json=as_json)
    raise typer.Exit(fails(verdicts))


@app.command()
def apply(
    fleet: _Fleet,
    agent: _Agents = None,
    root: _Root = None,
    tag: Annotated[
        str | None, Option(help="Go back to this release, as each machine kept it; see `releases`.")
    ] = None,
    accelerator: _Accelerator = None,
    dry_run: Annotated[bool, Option("--dry-run", help="Say what would change, and stop.")] = False,
    diff: _Diff = False,
) -> None:
    """Bring the files to each machine, prepare it, build its image there, and start it.

    What fails on one machine does not keep the others from theirs; applying again goes on where it ended.

    Examples:
      sfglab deploy apply data/fleets/esslingen.yaml --dry-run
      sfglab deploy apply data/fleets/esslingen.yaml --agent go2
      sfglab deploy apply data/fleets/esslingen.yaml --agent go2 --tag 0.1.0-1a2b3c4d5e6f
    """
    from sfglab.deploy.rollout import render_prospects

    failed = False
    # All machines are looked at before the first one is changed.
    for prospect, action in list(_prospects(_source(fleet, agent, accelerator), agent, root, tag)):
        typer.echo(render_prospects([prospect], diff=diff))
        failed |= prospect.plan is None
        if not dry_run:
            try:
                action()
            except DeployError as error:
                typer.echo(f"sfglab: {error}", err=True)
                failed = True
    raise typer.Exit(failed)


@app.command()
def releases(
    fleet: _Fleet, agent: _Agents = None, root: _Root = None, as_json: Json = False
) -> None:
    """List the releases that each machine keeps, the newest first: what `apply --tag` can go back to.

    Example:
      sfglab deploy releases data/fleets/esslingen.yaml --agent go2
    """
    from sfglab.deploy.deployment import HOME
    from sfglab.deploy.rollout import releases as kept
    from sfglab.deploy.transport import transport_to
    from sfglab.fleet.fleet_file import load_fleet

    described = load_fleet(fleet)
    failed = False
    for name in agent or [a.name for a in described.agents if a.host is not None]:
        host = described.agent(name).host
        if host is None:
            raise DeployError(f"{fleet}: agents.{name}: nothing says which machine it runs on")
        try:
            found = kept(transport_to(host, root=root), f"{HOME}/{name}")
            text = f"{name}: {', '.join(found) or 'none'}"
            say({name: found}, lambda _, text=text: text, as_json=as_json)  # type: ignore[misc]
        except DeployError as error:
            typer.echo(f"sfglab: {error}", err=True)
            failed = True
    raise typer.Exit(failed)


def _source(fleet: Path, agents: list[str] | None, accelerator: str | None) -> FleetSource:
    """Read a fleet file; what is said of accelerators on the command line counts more."""
    from sfglab.deploy.bundle import load_source, with_accelerator

    source = load_source(fleet)
    return source if accelerator is None else with_accelerator(source, agents or (), accelerator)


def _prospects(
    source: FleetSource, agents: list[str] | None, root: Path | None, tag: str | None = None
) -> Iterator[tuple[Prospect, Callable[[], None]]]:
    """Yield what would happen to each agent, and what makes it happen; one's failure is not the others'."""
    from sfglab.deploy.bundle import prepare
    from sfglab.deploy.release import SOURCE, make_release
    from sfglab.deploy.rollout import Prospect, apply_plan, look_and_plan, released, steps
    from sfglab.deploy.transport import detect_over, transport_to

    release, wheel = make_release(SOURCE, source.text)
    for name in agents or [agent.name for agent in source.fleet.agents]:
        host = source.fleet.agent(name).host
        machine = "?" if host is None else transport_to(host, root=root).name
        try:
            detect = partial(detect_over, root=root)
            ((deployment, bundle),) = prepare(source, release, wheel, agents=(name,), detect=detect)
            transport = transport_to(deployment.host, root=root)
            if tag is not None:
                bundle = released(transport, deployment, tag)
            plan = look_and_plan(transport, deployment.folder, bundle)
        except DeployError as error:
            yield Prospect(agent=name, machine=machine, plan=None, problem=str(error)), lambda: None
            continue
        following = steps(deployment, bundle, plan)
        action = partial(apply_plan, plan, bundle, deployment, transport, typer.echo)
        yield Prospect(agent=name, machine=machine, plan=plan, steps=following), action

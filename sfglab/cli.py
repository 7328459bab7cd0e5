"""The command line: ``sfglab --help``.

Each command is a few lines over the library; heavy modules are imported by the command that needs them.
"""

from __future__ import annotations

import json
import logging
import sys
from pathlib import Path
from typing import Annotated, NoReturn

import typer

from sfglab import __version__
from sfglab.errors import SfglabError
from sfglab.pipes import run

__all__ = ["app", "main"]

app = typer.Typer(
    help="How multi-robot ROS 2 systems move data: run the experiments, or the components beside real robots.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)


def main() -> NoReturn:
    """Run the command line; an error of ours is one line and exit status 1."""
    logging.basicConfig(format="%(levelname)s: %(message)s", level=logging.WARNING)
    try:
        app()
    except SfglabError as error:
        typer.echo(f"sfglab: {error}", err=True)
    except KeyboardInterrupt:
        typer.echo("sfglab: interrupted", err=True)
        sys.exit(130)
    sys.exit(1)


def _version(value: bool) -> None:
    if value:
        typer.echo(__version__)
        raise typer.Exit


@app.callback()
def root(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Options of the program itself."""


@app.command()
def doctor() -> None:
    """Say in plain words what this machine can do, and what an experiment will do instead."""
    from sfglab.lab.doctor import diagnose, render

    typer.echo(render(diagnose()))


@app.command()
def reproduce(
    notebooks: Annotated[list[str] | None, typer.Argument(help="Notebooks by name; all when none.")] = None,
    profile: Annotated[str, typer.Option(help="smoke (seconds), quick (minutes) or paper.")] = "quick",
    seed: Annotated[int, typer.Option(help="Seed of everything that is drawn.")] = 0,
    parameter: Annotated[
        list[str] | None, typer.Option("-p", "--parameter", help="Another parameter, as name=value.")
    ] = None,
    write: Annotated[
        bool, typer.Option("--write", help="Also replace the notebooks by their executed copies.")
    ] = False,
) -> None:
    """Run notebooks headless: logs, figures and, at the end, the ledger of claims.

    Examples:

      sfglab reproduce

      sfglab reproduce 03_decode_once --profile smoke

      sfglab reproduce 03_decode_once -p source=drive.mp4
    """
    from sfglab.lab.claims import render
    from sfglab.lab.ledger import compute_ledger
    from sfglab.lab.notebooks import PROFILES, NotebookError, find_notebooks, read_parameters, run_notebooks
    from sfglab.lab.paths import find_project

    if profile not in PROFILES:
        raise NotebookError(f"--profile: given {profile!r}, allowed are {', '.join(PROFILES)}")
    project = find_project()
    outcomes = run_notebooks(
        find_notebooks(project, notebooks or ()),
        project=project,
        parameters={"profile": profile, "seed": seed, **read_parameters(parameter or ())},
        write=write,
    )
    typer.echo(render(compute_ledger(project, profile=profile)))
    failed = [o for o in outcomes if o.error]
    for outcome in failed:
        typer.echo(f"failed: {outcome.name}: {outcome.error}", err=True)
    typer.echo(f"{len(outcomes) - len(failed)} of {len(outcomes)} notebooks ran through", err=True)
    raise typer.Exit(code=1 if failed else 0)


@app.command()
def figures() -> None:
    """Draw all figures again, from logs alone."""
    from sfglab.lab.ledger import redraw_figures
    from sfglab.lab.paths import find_project

    project = find_project()
    for name, files in redraw_figures(project).items():
        typer.echo(f"{name}: {', '.join(project.relative(f) for f in files)}")


@app.command()
def claims(
    as_json: Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")] = False,
) -> None:
    """Print the ledger: what the papers said, what we measured, and the verdict."""
    from sfglab.lab.claims import render
    from sfglab.lab.ledger import compute_ledger
    from sfglab.lab.paths import find_project

    entries = compute_ledger(find_project())
    typer.echo(json.dumps([e.as_json() for e in entries], indent=2) if as_json else render(entries))


@app.command()
def decoder(
    streams: Annotated[
        list[str] | None,
        typer.Argument(help="Remote streams by name, e.g. /global/go2/camera_front/color/ffmpeg"),
    ] = None,
    domain: Annotated[int, typer.Option(help="DDS domain of the local subscribers.")] = 0,
    interface: Annotated[str | None, typer.Option(help="Interface of the local domain.")] = None,
    remote_domain: Annotated[
        int | None, typer.Option(help="DDS domain of the remote streams; the local one when not given.")
    ] = None,
    remote_interface: Annotated[str | None, typer.Option(help="Interface of the remote domain.")] = None,
    linger: Annotated[float, typer.Option(help="Seconds a pipeline outlives its last subscriber.")] = 1.0,
) -> None:
    """Decode remote streams once for all subscribers on this device, on demand.

    Examples:

      sfglab decoder --domain 7 /global/go2/camera_front/color/ffmpeg

      sfglab decoder --domain 7 --interface lo --remote-domain 0 --remote-interface eth0

    Without streams it offers what remote agents announce on /local/<agent>/agent_discovery_event.
    """
    from sfglab.fleet.address import BusAddress
    from sfglab.fleet.decoder.app import DecoderConfig, serve_terminal
    from sfglab.names import Resource, RosFqnBuilder, Scope

    local = BusAddress(domain_id=domain, interface=interface)
    remote = (
        local
        if remote_domain is None and remote_interface is None
        else BusAddress(
            domain_id=domain if remote_domain is None else remote_domain, interface=remote_interface
        )
    )
    discovery = RosFqnBuilder().scope(Scope.LOCAL).resource(Resource.AGENT_DISCOVERY_EVENT).build()
    config = DecoderConfig(
        remote=remote,
        local=local,
        streams=tuple(streams or ()),
        discovery_topic=str(discovery),
        linger_s=linger,
    )
    run(serve_terminal(config, typer.echo))


@app.command()
def camera(
    topic: Annotated[str, typer.Argument(help="Topic, e.g. /global/go2/camera_front/color/ffmpeg")],
    source: Annotated[
        str, typer.Option(help="photos, stereo, camera:0, bag:PATH#/topic, or a video file.")
    ] = "photos",
    codec: Annotated[
        str, typer.Option(help="h264 (colour) or rvl (depth, needs a source with depth).")
    ] = "h264",
    domain: Annotated[int, typer.Option(help="DDS domain.")] = 0,
    interface: Annotated[str | None, typer.Option(help="Network interface.")] = None,
    encoder: Annotated[str, typer.Option(help="H.264 encoder by FFmpeg's name.")] = "auto",
) -> None:
    """Publish a camera stream at the settings of the paper's Table 2, from any source.

    Example:

      sfglab camera /global/go2/camera_front/color/ffmpeg --source drive.mp4
    """
    from sfglab.lab.workers.camera import CameraConfig, run_camera

    config = CameraConfig(
        domain_id=domain,
        interface=interface,
        multicast="default",
        topic=topic,
        codec=codec,
        source=source,
        encoder=encoder,
    )
    run(run_camera(config, typer.echo))


@app.command("log")
def show_log(path: Annotated[Path, typer.Argument(help="An MCAP log.")]) -> None:
    """List what a log holds: topics, tables, metadata."""
    from sfglab.record import LogReader

    with LogReader(path) as reader:
        for topic, info in reader.topics.items():
            typer.echo(f"{info.count:8d}  {topic}  ({info.type_name})")
        for name in reader.metadata_names:
            typer.echo(f"metadata  {name}: {json.dumps(reader.metadata(name))}")
        if reader.truncated:
            typer.echo("the log was cut off; what stands here is all that is in it")

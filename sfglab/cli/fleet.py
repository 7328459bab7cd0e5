"""Commands of designers: check a fleet before anything runs, and configure other people's routers for it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

app = typer.Typer(
    help="A fleet file: what crosses its borders, and routers' configurations for it.", no_args_is_help=True
)


@app.command()
def lint(file: Annotated[Path, typer.Argument(help="A fleet file, e.g. data/fleets/lab.yaml")]) -> None:
    """Say who hears what, which services are half open, which frames clash, and what discovery will cost.

    Ends with 0, 1 if there are errors, 2 if the file is no fleet.

    Example:

      sfglab fleet lint data/fleets/lab.yaml
    """
    from sfglab.fleet.border import lint_file

    text, code = lint_file(file)
    typer.echo(text, nl=False)
    raise typer.Exit(code)


@app.command("router")
def router_configuration(
    file: Annotated[Path, typer.Argument(help="A fleet file.")],
    agent: Annotated[str, typer.Option(help="Whose router.")],
    target: Annotated[
        str, typer.Option(help="dds-router, zenoh-bridge, zenoh-acl or domain-bridge.")
    ] = "dds-router",
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="Write here, not to the terminal.")
    ] = None,
) -> None:
    """Write the configuration of a router by others that lets through what our own would.

    Examples:

      sfglab fleet router data/fleets/lab.yaml --agent go2 -o go2.yaml

      sfglab fleet router data/fleets/lab.yaml --agent go2 --target zenoh-bridge
    """
    from sfglab.deploy.routers import render_router
    from sfglab.fleet.fleet_file import load_fleet

    text = render_router(load_fleet(file), agent, target)
    if output is None:
        typer.echo(text, nl=False)
    else:
        output.write_text(text, encoding="utf-8")


@app.command()
def check(
    file: Annotated[Path, typer.Argument(help="A configuration of a DDS Router (.yaml) or Zenoh (.json5).")],
    fleet: Annotated[
        Path | None, typer.Option(help="Also: does it let through what this fleet's policy does?")
    ] = None,
) -> None:
    """Check a router's configuration that somebody wrote; ends with 1 if there are errors.

    Example:

      sfglab fleet check go2.yaml --fleet data/fleets/lab.yaml
    """
    from sfglab.deploy.routers import check_file
    from sfglab.fleet.border import Severity, render_findings
    from sfglab.fleet.fleet_file import load_fleet

    findings = check_file(file, policy=load_fleet(fleet).policy if fleet is not None else None)
    typer.echo(render_findings(findings))
    raise typer.Exit(any(finding.severity is Severity.ERROR for finding in findings))

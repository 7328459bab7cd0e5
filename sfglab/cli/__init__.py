"""The command line: ``sfglab --help``.

Each command is a few lines over the library; heavy modules are imported by the command that needs them.
Commands of one kind stand in one module and are added to the program here.
"""

from __future__ import annotations

import logging
import sys
from typing import Annotated, NoReturn

import typer

from sfglab import __version__
from sfglab.cli import deploy, experiments, fleet, mapping, mocap, plan, view
from sfglab.errors import SfglabError

__all__ = ["app", "main"]

app = typer.Typer(
    help="How multi-robot ROS 2 systems move data: run the experiments, or the components beside real robots.",
    no_args_is_help=True,
    add_completion=False,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
)
experiments.add_to(app)
fleet.add_to(app)
app.add_typer(deploy.app, name="deploy")
app.add_typer(plan.app, name="follow")
mapping.add_to(app)
mocap.add_to(app)
plan.add_to(app)
view.add_to(app)


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

"""The command that opens the scene editor in the browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer


def plan(
    scene: Annotated[Path, typer.Argument(help="A scene file, e.g. data/scenes/hall.yaml")],
    port: Annotated[
        int, typer.Option(min=0, max=65535, help="Serve the editor here; 0 takes any port that is free.")
    ] = 8092,
    no_browser: Annotated[
        bool, typer.Option("--no-browser", help="Open no browser; only print the address.")
    ] = False,
    new: Annotated[
        bool, typer.Option("--new", help="Begin an empty scene; the file is made by the first save.")
    ] = False,
) -> None:
    """Plan trajectories for several robots in 3D, in the browser (paper A, section 4.5).

    Every browser that opens the address edits the same scene. Ctrl-C ends and saves nothing.

    Examples:

      sfglab plan data/scenes/hall.yaml

      sfglab plan warehouse.yaml --new

      sfglab plan data/scenes/course.yaml --port 0 --no-browser
    """
    from sfglab.spatial.scene import Editor, SceneError
    from sfglab.view.planner import Planner

    if new and scene.exists():
        raise SceneError("--new", str(scene), "a file that does not exist yet")
    if not new and not scene.exists():
        raise SceneError("scene", str(scene), "a scene file; --new begins one")
    if not scene.parent.is_dir():
        raise SceneError("scene", str(scene), "a file in a folder that exists")
    editor = Editor.open(scene)
    with Planner(editor, port=port) as planner:
        try:
            typer.echo(f"{scene.name}: {planner.url}  (Ctrl-C ends)")
            if not no_browser:
                typer.launch(planner.url)
            planner.wait()
        except KeyboardInterrupt:
            typer.echo("")
    if editor.dirty:
        typer.echo(f"{scene.name}: has changes that were not saved; the file is as it was saved last", err=True)


def add_to(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command()(plan)

"""Message types at the command line: the user's own that a command is to know, and ours for ROS 2."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

import sfglab.messages
from sfglab.files import write_files


def _register(paths: list[Path] | None) -> None:
    """Make types known here and, by the environment, in the processes that a command starts."""
    from sfglab.messages import register_interfaces
    from sfglab.messages.store import INTERFACES_VARIABLE as VARIABLE

    for path in paths or ():
        register_interfaces(path)
        os.environ[VARIABLE] = os.pathsep.join(
            filter(None, (os.environ.get(VARIABLE), str(path.absolute())))
        )


Interfaces = Annotated[
    list[Path] | None,
    Option(
        "--interfaces",
        callback=_register,
        help="Types of your own: a package's folder (source or share), a folder of packages, or a file .msg, "
        ".srv or .action; may be repeated, used ones first.",
    ),
]
"""An option of commands that meet types of users; its parameter is not looked at."""


def interfaces(
    folder: Annotated[Path, Argument(help="A workspace's folder for packages, e.g. ~/ros2_ws/src")],
) -> None:
    """Write an ament package of our message types, so that a plain ROS 2 can echo and call them.

    Example:
      sfglab interfaces ~/ros2_ws/src   # then: colcon build --packages-select sfglab_interfaces
    """
    package = Path(sfglab.messages.__file__).parent / "interfaces" / "sfglab_interfaces"
    files = {
        path.relative_to(package): path.read_bytes()
        for path in package.rglob("*")
        if path.is_file()
    }
    write_files(files, folder=folder / package.name)
    typer.echo(folder / package.name)

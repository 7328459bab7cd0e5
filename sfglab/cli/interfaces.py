"""Message types at the command line: types of users for a command, and our types for ROS 2."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer
from typer import Argument, Option

import sfglab
from sfglab.files import write_files


def _register(paths: list[Path] | None) -> None:
    """Register types in this process and, through the environment, in its child processes."""
    from sfglab.messages import register_interfaces
    from sfglab.messages.store import INTERFACES_VARIABLE

    for path in paths or ():
        register_interfaces(path)
        given = os.environ.get(INTERFACES_VARIABLE)
        known = [given] if given else []
        os.environ[INTERFACES_VARIABLE] = os.pathsep.join([*known, str(path.absolute())])


#: Option of commands that handle types of users; only its callback uses the value.
Interfaces = Annotated[
    list[Path] | None,
    Option(
        "--interfaces",
        callback=_register,
        help="Your own message types (repeatable): a package's folder (source or share), a folder "
        "of packages, or a .msg, .srv or .action file. Give packages before those that use them.",
    ),
]


def interfaces(
    folder: Annotated[
        Path, Argument(metavar="FOLDER", help="Source folder of the workspace, e.g. ~/ros2_ws/src.")
    ],
) -> None:
    """Write our message types into a ROS 2 workspace, as the package sfglab_interfaces.

    Example:
      sfglab interfaces ~/ros2_ws/src   # then: colcon build --packages-select sfglab_interfaces
    """
    source = Path(sfglab.__file__).parent / "messages" / "interfaces" / "sfglab_interfaces"
    paths = [path for path in source.rglob("*") if path.is_file()]
    files = {path.relative_to(source): path.read_bytes() for path in paths}
    package = folder / source.name
    write_files(files, folder=package)
    typer.echo(package)

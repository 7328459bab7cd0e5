"""The command that prints the JSON Schema of a file format: ``sfglab schema``."""

from __future__ import annotations

import json
from typing import Annotated, Literal

from typer import Argument

from sfglab.cli.buses import write_text
from sfglab.cli.options import OutputFile

_Name = Literal["fleet", "qos", "graph", "scene", "mocap", "claims"]


def schema(
    name: Annotated[_Name, Argument(metavar="FORMAT", help="File format.")],
    output: OutputFile = None,
) -> None:
    """Print the JSON Schema of a file format, for completion and checks in editors.

    Example of use, where the first line of the YAML file names its schema for the editor:
      sfglab schema fleet --output fleet.json
      # yaml-language-server: $schema=fleet.json
    """
    from sfglab.lab.formats import FORMATS

    write_text(json.dumps(FORMATS[name].schema(), indent=2) + "\n", output)

"""The command that prints the JSON Schema of a file format: ``sfglab schema``."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Option

from sfglab.cli.buses import write_text

_Name = Literal["fleet", "qos", "graph", "scene", "mocap", "claims"]


def schema(
    name: Annotated[_Name, Argument(help="File format.")],
    out: Annotated[Path | None, Option(help="File to write. [default: the terminal]")] = None,
) -> None:
    """Print the JSON Schema of a file format, for completion and checks in editors.

    An editor with YAML support reads it if the file's first line is
    # yaml-language-server: $schema=fleet.json

    Example:
      sfglab schema fleet --out fleet.json
    """
    from sfglab.lab.formats import FORMATS

    write_text(json.dumps(FORMATS[name].schema(), indent=2) + "\n", out)

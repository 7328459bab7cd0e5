"""The command that prints the JSON Schema of a file format."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated, Literal

from typer import Argument, Option

from sfglab.cli.buses import put_text

_Name = Literal["fleet", "qos", "graph", "scene", "mocap", "claims"]


def schema(
    name: Annotated[_Name, Argument(help="The format.")],
    out: Annotated[
        Path | None, Option(help="Write it into this file, not to the terminal.")
    ] = None,
) -> None:
    """Print the JSON Schema of a file format, by which editors complete and check such files.

    An editor with YAML support takes it from the file's first line: # yaml-language-server: $schema=fleet.json

    Example:
      sfglab schema fleet --out fleet.json
    """
    from sfglab.lab.formats import FORMATS

    put_text(json.dumps(FORMATS[name].schema(), indent=2) + "\n", out)

"""Options and arguments that several commands share."""

from __future__ import annotations

from functools import partial
from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from sfglab.domains import MAX_DOMAIN, VARIABLE

domain_option = partial(Option, min=0, max=MAX_DOMAIN)  #: Option for a DDS domain.

Json = Annotated[
    bool, Option("--json", help="Print JSON instead of text; null stands for NaN and infinity.")
]
Domain = Annotated[int, domain_option(envvar=VARIABLE, help="DDS domain.")]
RecordedDomain = Annotated[
    int | None,
    domain_option(help="DDS domain to observe instead of a file. [default: ROS_DOMAIN_ID]"),
]
ObservedTime = Annotated[
    float, Option("--duration", min=0.1, help="Time to observe the domain, s.")
]
Interface = Annotated[
    str | None,
    Option(
        help="Network interface for DDS; lo keeps traffic on this host. [default: the fleet file's if one is given, otherwise automatic]"
    ),
]
SpinTime = Annotated[
    float | None,
    Option(min=0.0, help="Time to wait for discovery, s. [default: until nothing new appears]"),
]
Duration = Annotated[
    float | None, Option(min=0.1, help="Time until the command ends, s. [default: until Ctrl-C]")
]
OutputFile = Annotated[
    Path | None, Option("--output", "-o", help="File to write. [default: the terminal]")
]
OutputFolder = Annotated[
    Path | None,
    Option("--output", "-o", help="Folder to write the file into. [default: the terminal]"),
]
Agents = Annotated[
    list[str] | None, Option("--agent", help="Agent (repeatable). [default: all agents]")
]
SceneFile = Annotated[
    Path, Argument(metavar="SCENE", help="Scene file, e.g. data/scenes/hall.yaml.")
]
FleetFile = Annotated[
    Path, Argument(metavar="FLEET", help="Fleet file, e.g. data/fleets/esslingen.yaml.")
]
Fleet = Annotated[Path | None, Option("--fleet", help="Fleet file, e.g. data/fleets/lab.yaml.")]

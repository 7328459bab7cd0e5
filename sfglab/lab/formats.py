"""Formats of user-written files: the command that reads each, an example, and its JSON Schema."""

from __future__ import annotations

from collections.abc import Callable  # noqa: TC003 - type of a field
from dataclasses import dataclass
from functools import partial
from pathlib import Path  # noqa: TC003 - type of a field
from typing import Any

from sfglab.arp.topics import TopicKeys, load_topics
from sfglab.fleet.fleet_file import FleetFile, load_fleet
from sfglab.lab.claims import Claim, load_claims
from sfglab.schema import Schema, schema_of
from sfglab.soc.graph import Graph, load_graph
from sfglab.spatial.mocap.mapping import MocapMapping, load_mapping
from sfglab.spatial.scene.files import SceneKeys, load_scene


@dataclass(frozen=True, slots=True)
class Format:
    """A file format."""

    title: str  #: Title of the format.
    read_by: str  #: First command that reads such a file.
    files: str  #: Pattern of the examples in ``data``.
    load: Callable[[Path], Any]  #: Function that reads such a file, or refuses it.
    schema: Callable[[], Schema]  #: Function that makes its JSON Schema.


FORMATS = {
    "fleet": Format(
        "Fleet",
        "sfglab fleet lint",
        "fleets/*.yaml",
        load_fleet,
        partial(schema_of, FleetFile),
    ),
    "qos": Format(
        "Topics for QoS planning",
        "sfglab qos",
        "qos/*.yaml",
        load_topics,
        partial(schema_of, TopicKeys),
    ),
    "graph": Format(
        "Computation graph", "sfglab map", "graphs/*.yaml", load_graph, partial(schema_of, Graph)
    ),
    "scene": Format(
        "Scene", "sfglab plan", "scenes/*.yaml", load_scene, partial(schema_of, SceneKeys)
    ),
    "mocap": Format(
        "Motion capture mapping",
        "sfglab mocap run",
        "mocap/*.yaml",
        load_mapping,
        partial(schema_of, MocapMapping),
    ),
    "claims": Format(
        "Claims of papers",
        "sfglab claims",
        "claims.yaml",
        load_claims,
        partial(schema_of, list[Claim]),
    ),
}

"""Formats of the files that people write: what reads each, an example, and its JSON Schema.

Knows which types stand for which format, so that `sfglab schema`, the book's reference and the tests go by one
list. Refuses to know what a format's keys mean: their types say it.
"""

from __future__ import annotations

from collections.abc import Callable  # noqa: TC003 - a field's type
from dataclasses import dataclass
from functools import partial
from pathlib import Path  # noqa: TC003 - the same
from typing import Any

from sfglab.arp.topics import FileKeys, TopicFile, load_topics
from sfglab.fleet.fleet_file import Fleet, FleetKeys, load_fleet
from sfglab.lab.claims import Claim, load_claims
from sfglab.schema import Schema, schema_of
from sfglab.soc.graph import Graph, load_graph
from sfglab.spatial.mocap.mapping import MocapMapping, load_mapping
from sfglab.spatial.scene.files import load_scene
from sfglab.spatial.scene.schema import scene_schema


@dataclass(frozen=True, slots=True, kw_only=True)
class Format:
    """A file format."""

    title: str  #: What such a file is.
    read_by: str  #: The command that takes it first.
    files: str  #: Examples in ``data``, as a pattern.
    load: Callable[[Path], Any]  #: Reads such a file, or refuses it.
    schema: Callable[[], Schema]  #: Makes its JSON Schema.


FORMATS = {
    "fleet": Format(
        title="Fleet",
        read_by="sfglab fleet lint",
        files="fleets/*.yaml",
        load=load_fleet,
        schema=partial(schema_of, FleetKeys, Fleet),
    ),
    "qos": Format(
        title="Topics for QoS planning",
        read_by="sfglab qos",
        files="qos/*.yaml",
        load=load_topics,
        schema=partial(schema_of, FileKeys, TopicFile),
    ),
    "graph": Format(
        title="Computation graph",
        read_by="sfglab map",
        files="graphs/*.yaml",
        load=load_graph,
        schema=partial(schema_of, Graph),
    ),
    "scene": Format(
        title="Scene",
        read_by="sfglab plan",
        files="scenes/*.yaml",
        load=load_scene,
        schema=scene_schema,
    ),
    "mocap": Format(
        title="Motion capture mapping",
        read_by="sfglab mocap run",
        files="mocap/*.yaml",
        load=load_mapping,
        schema=partial(schema_of, MocapMapping),
    ),
    "claims": Format(
        title="Claims of papers",
        read_by="sfglab claims",
        files="claims.yaml",
        load=load_claims,
        schema=partial(schema_of, Claim, many=True),
    ),
}

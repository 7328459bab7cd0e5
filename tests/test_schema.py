"""JSON Schemas of the files that people write say what their readers do: each key, and what stands there."""

from __future__ import annotations

import json
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import pytest
import yaml
from commands import called
from jsonschema import Draft202012Validator

from sfglab.cli.schema import _Name
from sfglab.errors import SfglabError
from sfglab.lab.formats import FORMATS

if TYPE_CHECKING:
    from collections.abc import Iterator

DATA = Path(__file__).parents[1] / "data"

#: Beside those of data/: what no file there holds, so that every mapping of every schema is met.
MORE = {
    "fleet": """
fleet: all
policy: [rt/*, {pattern: rt/tf, directions: [inward]}]
deployment: {time_servers: [a], ros: jazzy}
agents:
  a: {domain: 1, publishes: [{name: /b, qos: {depth: 2, deadline_s: 0.1}}], host: {launch: [run]}}
""",
    "graph": "nodes: {a: {hardware: {lut: 1}}, b: {hardware: null}}\ntopics: {t: {publishers: [a]}}",
    "scene": """
sfglab_scene: 1
next_id: 9
objects:
- {id: 1, kind: obstacle, name: o, shape: {kind: sphere, radius_m: 1}, pose: {xyz_m: [0, 0, 1]}}
- {id: 2, kind: agent, name: a, speed_m_s: null}
- {id: 3, kind: group, name: g}
- {id: 4, kind: trajectory, name: t, parent: 3, waypoints: [{id: 5, time_s: 0, xyz_m: [0, 0, 0]}]}
- {id: 6, kind: zone, name: z, shape: {kind: cylinder, radius_m: 1, height_m: 2}}
""",
}
CONTENTS = [
    (name, yaml.safe_load(path.read_text("utf-8")))
    for name, form in FORMATS.items()
    for path in sorted(DATA.glob(form.files))
]
CONTENTS += [(name, yaml.safe_load(text)) for name, text in MORE.items()]


def reads(name: str, content: Any, folder: Path) -> bool:
    path = folder / "file.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    try:
        FORMATS[name].load(path)
    except SfglabError:
        return False
    return True


def within(value: Any) -> Iterator[tuple[Any, Any]]:
    """Yield everything that a value holds, at any depth, with its holder and key."""
    if isinstance(value, dict | list):
        for key in list(value) if isinstance(value, dict) else range(len(value)):
            yield value, key
            yield from within(value[key])


def objects(schema: Any) -> list[dict[str, Any]]:
    """Return every mapping with fixed keys that a schema describes."""
    inner = [holder[key] for holder, key in within([schema])]
    return [
        each for each in inner if isinstance(each, dict) and "type" in each and "properties" in each
    ]


@pytest.mark.parametrize("name", FORMATS)
def test_every_mapping_of_a_schema_stands_in_an_example_and_every_key_has_a_text(name):
    contents = [content for of, content in CONTENTS if of == name]
    held = [holder[key] for holder, key in within([contents])]
    met = [set(each) for each in held if isinstance(each, dict)]
    for part in objects(FORMATS[name].schema()):
        known, needed = set(part["properties"]), set(part.get("required", ()))
        assert any(needed <= keys <= known for keys in met), known
        for key, shape in part["properties"].items():
            assert shape.get("description") or "const" in shape, f"{part['description']}: {key}"


@pytest.mark.parametrize(("name", "content"), CONTENTS)
def test_a_schema_takes_every_file_and_refuses_what_its_reader_refuses(name, content, tmp_path):
    schema = FORMATS[name].schema()
    Draft202012Validator.check_schema(schema)
    validator = Draft202012Validator(schema)
    assert list(validator.iter_errors(content)) == []
    assert reads(name, content, tmp_path)
    content = deepcopy(content)  # another test reads it, also after a failure of this one
    places = list(within([content]))
    for holder, key in places[:: len(places) // 50 + 1]:
        before = holder[key]
        for wrong in wrongs(before):
            holder[key] = wrong
            assert validator.is_valid(content) is reads(name, content, tmp_path), (key, wrong)
        if type(before) in (int, float):
            holder[key] = -1
            assert validator.is_valid(content) or not reads(name, content, tmp_path), key
        if isinstance(holder, dict):
            del holder[key]
            assert validator.is_valid(content) or not reads(name, content, tmp_path), key
        holder[key] = before


def wrongs(value: Any) -> list[Any]:
    """Return values that are wrong in place of a value, if not everything is allowed there."""
    unknown = {"no such key": [[]]}
    if isinstance(value, dict):
        return [value | unknown, 7]
    return [unknown] if isinstance(value, str) else [unknown, "no such"]


def test_the_command_prints_and_writes_what_an_editor_reads(tmp_path):
    assert list(get_args(_Name)) == list(FORMATS)
    out = tmp_path / "fleet.json"
    assert called("schema", "fleet", "--output", str(out)) == f"{out}\n"
    assert out.read_text() == called("schema", "fleet")
    assert json.loads(out.read_text()) == FORMATS["fleet"].schema()
    assert "'fleet', 'qos'" in called("schema", "flet", status=2)

"""JSON Schemas of the files that people write say what their readers do: each key, and what stands there."""

from __future__ import annotations

import copy
import json
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
TEXTS = [
    (n, path.stem, path.read_text("utf-8"))
    for n, f in FORMATS.items()
    for path in DATA.glob(f.files)
]
TEXTS += [(name, f"more_{name}", text) for name, text in MORE.items()]


def reads(name: str, content: Any, folder: Path) -> bool:
    path = folder / "file.yaml"
    path.write_text(yaml.safe_dump(content, sort_keys=False), encoding="utf-8")
    try:
        FORMATS[name].load(path)
    except SfglabError:
        return False
    return True


def mappings(
    schema: dict[str, Any], part: dict[str, Any], value: Any
) -> Iterator[tuple[dict[str, Any], Any]]:
    """Yield the schema of every mapping with fixed keys in a value, beside the mapping."""
    if "$ref" in part:
        part = schema["$defs"][part["$ref"].rpartition("/")[2]]
    for other in part.get("anyOf", part.get("oneOf", ())):
        inside = {**other, "$defs": schema["$defs"]}
        if Draft202012Validator(inside).is_valid(value):
            yield from mappings(schema, other, value)
            return
    if isinstance(value, dict):
        if "properties" in part:
            yield part, value
        for key, inner in value.items():
            each = part.get("properties", {}).get(key, part.get("additionalProperties"))
            yield from mappings(schema, each, inner)
    elif isinstance(value, list):
        for inner in value:
            yield from mappings(schema, part["items"], inner)


def objects(part: Any) -> Iterator[dict[str, Any]]:
    """Yield every mapping with fixed keys that a schema describes."""
    if isinstance(part, dict):
        if part.get("type") == "object" and "properties" in part:
            yield part
        for inner in part.values():
            yield from objects(inner)
    elif isinstance(part, list):
        for inner in part:
            yield from objects(inner)


@pytest.mark.parametrize("name", FORMATS)
def test_every_mapping_of_a_schema_stands_in_an_example(name):
    schema = FORMATS[name].schema()
    met = {
        frozenset(part["properties"])
        for text in (text for of, _, text in TEXTS if of == name)
        for part, _ in mappings(schema, schema, yaml.safe_load(text))
    }
    assert {frozenset(part["properties"]) for part in objects(schema)} - met == set()


@pytest.mark.parametrize(
    ("name", "text"), [pytest.param(n, text, id=stem) for n, stem, text in sorted(TEXTS)]
)
def test_a_schema_takes_every_file_and_refuses_what_its_reader_refuses(name, text, tmp_path):
    schema = FORMATS[name].schema()
    Draft202012Validator.check_schema(schema)
    validator = Draft202012Validator(schema)
    content = yaml.safe_load(text)
    assert list(validator.iter_errors(content)) == []
    assert reads(name, content, tmp_path)
    broken = list(mutations(schema, content, 50))
    assert len(broken) > 10
    for place, wrong in broken:
        assert not validator.is_valid(wrong), place
        assert not reads(name, wrong, tmp_path), place


def mutations(schema: dict[str, Any], content: Any, most: int) -> Iterator[tuple[str, Any]]:
    """Yield copies with one mistake each: an unknown key, one left out, a wrong kind, one out of bounds."""
    found = list(mappings(schema, schema, content))
    plans = [
        (i, key, wrong)
        for i, (part, value) in enumerate(found)
        for key in ["no such key", *part.get("required", ()), *value]
        for wrong in wrongs(part["properties"].get(key, {}), value.get(key))
        if wrong is not None or key in part.get("required", ())
    ]
    for i, key, wrong in plans[:: len(plans) // most + 1]:
        broken = copy.deepcopy(content)
        inside = list(mappings(schema, schema, broken))[i][1]
        inside[key] = wrong
        if wrong is None:
            del inside[key]
        yield f"{i}: {key}: {wrong}", broken


def wrongs(shape: dict[str, Any], value: Any) -> list[Any]:
    if "type" not in shape and "enum" not in shape:
        return [["none"]] if not shape else [None]
    low = shape.get("minimum", shape.get("exclusiveMinimum"))
    beyond = [low - 1] if low is not None else []
    return [None, {"no such": 1} if not isinstance(value, dict) else 7, *beyond]


@pytest.mark.parametrize("name", FORMATS)
def test_every_key_has_a_text(name):
    schema = FORMATS[name].schema()
    bare = [
        f"{part['description']}: {key}"
        for part in objects(schema)
        for key, shape in part["properties"].items()
        if not shape.get("description") and "const" not in shape
    ]
    assert bare == []


def test_the_command_prints_and_writes_what_an_editor_reads(tmp_path):
    assert list(get_args(_Name)) == list(FORMATS)
    out = tmp_path / "fleet.json"
    assert called("schema", "fleet", "--out", str(out)) == f"{out}\n"
    assert (
        json.loads(out.read_text())
        == json.loads(called("schema", "fleet"))
        == FORMATS["fleet"].schema()
    )
    assert "'fleet', 'qos'" in called("schema", "flet", status=2)
    topic = json.loads(called("schema", "qos"))["$defs"]["Topic"]
    assert topic["additionalProperties"] is False
    assert "name" not in topic["properties"]

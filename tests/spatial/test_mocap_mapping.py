"""The mapping of objects to frames: read strictly, refused with file, key, given and allowed."""

from __future__ import annotations

from pathlib import Path

import pytest

from sfglab.documents import DocumentError
from sfglab.spatial import Pose
from sfglab.spatial.mocap import (
    Limits,
    MappedObject,
    MocapMapping,
    load_mapping,
    read_mapping,
)

EXAMPLE = Path(__file__).parents[2] / "data" / "mocap" / "two_agents.yaml"


def test_the_example_says_what_it_says():
    mapping = load_mapping(EXAMPLE)
    assert mapping.world == "map"
    assert mapping.objects["agent_x/markers"] == MappedObject(
        id="agent_x/markers", via="agent_x/markers", frame="agent_x/base"
    )
    go2 = mapping.objects["Go2 Body"]
    assert (go2.via, go2.frame, go2.offset) == ("go2/base", "", Pose.at((0.031, -0.002, -0.118)))
    assert mapping.limits == Limits(speed_m_s=6.0, turn_rad_s=10.0)


GOOD = "world: map\nobjects:\n  a:\n    via: a/markers\n"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", r"m\.yaml:1: nothing is given, allowed: a mapping of keys to values"),
        ("[1]", r"m\.yaml:1: given \[1\], allowed: a mapping of keys to values"),
        ("objects: {a: {via: b}}", r"m\.yaml:1: world: nothing is given, allowed: 'world' is needed here"),
        ("world: map\nobjects: {}\n", r"m\.yaml:2: objects: given \{\}, allowed: .* at least one"),
        ("world: map\nobjects: [a]\n", r"m\.yaml:2: objects: given \['a'\], allowed: a mapping"),
        ("world: /map\nobjects: {a: {via: b}}", r"m\.yaml:1: world: given '/map', .* without leading slash"),
        (GOOD + "    vai: b\n", r"m\.yaml:5: objects\.a\.vai: given 'vai', .*; did you mean 'via'\?"),
        ("world: map\nobjects: {a: {frame: b}}", r"m\.yaml:2: objects\.a\.via: nothing is given"),
        ("world: map\nobjects: {a: {via: 3}}", r"objects\.a\.via: given 3, allowed: the name of a frame"),
        (
            GOOD + "    frame:\n",
            r"m\.yaml:5: objects\.a\.frame: nothing is given, allowed: the name of a frame",
        ),
        (GOOD + "  a:\n    via: c\n", r"m\.yaml:5: objects\.a: given 'a', allowed: each key once"),
        (GOOD + "  b:\n    via: a/markers\n", r"m\.yaml:6: objects\.b\.via: .* objects\.a\.via has that one"),
        (
            GOOD + "    frame: x\n  b: {via: c, frame: x}\n",
            r"m\.yaml:6: objects\.b\.frame: given 'x', .* objects\.a\.frame has",
        ),
        (GOOD + "  b: {via: map}\n", r"objects\.b\.via: given 'map', .* world has that one"),
        (GOOD + "  3: {via: c}\n", r"objects\.3: given '3', allowed: a key that is text"),
        (GOOD + "    offset:\n", r"m\.yaml:5: objects\.a\.offset: nothing is given, allowed: a mapping"),
        (GOOD + "    offset: {}\n", r"m\.yaml:5: objects\.a\.offset\.position_m: nothing is given"),
        (GOOD + "    offset: {position_m: [1, 2]}\n", r"offset\.position_m: .* 3 numbers, all finite"),
        (GOOD + "    offset: {position_m: [1, 2, .nan]}\n", r"offset\.position_m: .* finite"),
        (GOOD + "    offset: {position_m: [1, 2, x]}\n", r"position_m: given .* 3 numbers"),
        (
            GOOD + "    offset:\n      position_m: [0, 0, 0]\n      quat_xyzw: [0, 0, 0, 0]\n",
            r"m\.yaml:7: objects\.a\.offset\.quat_xyzw: .* length",
        ),
        (GOOD + "limits: {speed: 3}\n", r"m\.yaml:5: limits\.speed: given 'speed', .*did you mean 'speed_m_s'"),
        (GOOD + "limits: {speed_m_s: -1}\n", r"limits\.speed_m_s: given -1, allowed: a number above zero"),
        (GOOD + "limits: {speed_m_s: .nan}\n", r"limits\.speed_m_s: given nan"),
        (GOOD + "limits: {speed_m_s: yes}\n", r"limits\.speed_m_s: given True"),
        ("world: [", r"m\.yaml:1: given .*, allowed: YAML"),
    ],
)
def test_what_the_mapping_must_not_say_is_refused_with_its_place(text, says):
    with pytest.raises(DocumentError, match=says):
        read_mapping(text, file="m.yaml")


def test_a_missing_file_is_refused(tmp_path):
    with pytest.raises(DocumentError, match=r"none\.yaml.*readable text file"):
        load_mapping(tmp_path / "none.yaml")


def test_a_mapping_that_is_built_is_checked_too():
    objects = {id_: MappedObject(id=id_, via="a/markers") for id_ in ("a", "b")}
    with pytest.raises(DocumentError, match="a frame of its own"):
        MocapMapping(world="map", objects=objects)

"""Files that people write: each mistake is named by file, line and key, with what is given and allowed."""

from __future__ import annotations

import re
from collections.abc import Mapping  # noqa: TC003  # read at run time
from dataclasses import dataclass, field
from enum import Enum
from typing import Annotated, Literal

import pytest

from sfglab import documents
from sfglab.errors import InvalidValueError
from sfglab.fields import Bounds, between, bounds


class Colour(Enum):
    RED = "red"
    GREEN = "green"


def read(hint, text: str):
    return documents.Document(text, "f.yaml").read(hint)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: 1\na: 2", "f.yaml:2: a: given 'a', allowed: each key once in its mapping"),
        ("a: 2001-99-99", "f.yaml:1: a: given '2001-99-99', allowed: a value that YAML can read"),
        ("a: \x07", "f.yaml: not valid YAML (unacceptable character"),
        ("a: &x [1]\nb: *x", "f.yaml:2: b: given 'an alias', allowed: a value that is written out"),
        ("a: &x\n- *x", "f.yaml:2: a[0]: given 'an alias'"),
        ("a: &x b\nc:\n  *x : 1", "f.yaml:2: c: given 'an alias, a list or a mapping as a key'"),
        ("a:\n  ? [b, c]\n  : 1", "f.yaml:1: a: given 'an alias, a list or a mapping as a key'"),
        ("a: {", "not valid YAML"),
        ("1: a", "f.yaml:1: 1: given '1', allowed: a key that is text (quote it)"),
    ],
)
def test_what_is_no_yaml_or_could_mislead_is_refused_with_its_place(text, said):
    with pytest.raises(documents.DocumentError) as caught:
        documents.Document(text, "f.yaml")
    assert said in str(caught.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    """tests/test_mistakes.py has files that are no text."""
    with pytest.raises(documents.DocumentError, match=r"none\.yaml: .*, needed: a fleet file$"):
        documents.Document.of_file(tmp_path / "none.yaml", "a fleet file")


def even(value: int) -> int:
    if value % 2:
        raise InvalidValueError((), value, "an even number")
    return value


@dataclass(frozen=True, slots=True, kw_only=True)
class Wheel:
    name: str
    size_m: float = between(1.0, without=(0,))
    place: documents.Place = field(default=documents.NOWHERE, compare=False)


@dataclass(frozen=True, slots=True, kw_only=True)
class Engine:
    fuel: Literal["sun", "wind"] = "sun"
    place: documents.Place = field(default=documents.NOWHERE, compare=False)


SMALL = documents.Matching(re.compile("[a-z]+"), "small letters")
TAG = documents.Matching(re.compile("t."), "tags")


@dataclass(frozen=True, slots=True, kw_only=True)
class Car:
    source: Annotated[str, SMALL] = field(metadata=documents.named("from"))
    doors: int = field(metadata=bounds(1, 5))
    seats: Annotated[int, documents.ReadAs(int, even)] = 2
    colour: Colour = Colour.RED
    load: float = between(0.5, 0, 1, without=(1,))
    lit: bool = False
    maybe: Annotated[float | None, documents.OR_NULL] = None
    at_m: tuple[float, float] = (0, 0)
    engine: Engine = field(default_factory=Engine)
    spare: Wheel | None = None
    tags: tuple[Annotated[str, TAG], ...] = ()
    wheels: tuple[Annotated[Wheel, documents.ShortFor("name")], ...] = ()
    axles: Annotated[tuple[Wheel, ...], documents.ByName("name")] = ()
    parts: Annotated[Mapping[str, Wheel], documents.ByName("name")] = field(default_factory=dict)
    prices: Mapping[str, Annotated[float, Bounds(0)]] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.doors > self.seats:
            raise InvalidValueError("doors", self.doors, f"up to the seats, {self.seats}")


def test_a_mapping_is_read_as_the_dataclass_says():
    text = """\
from: berlin
doors: 3
seats: 4
colour: green
load: 0
lit: true
maybe:
at_m: [1, 2.5]
engine: {fuel: wind}
tags: [t1, t2]
wheels: [front, {name: back, size_m: 0.5}]
axles: {a: {size_m: 2}}
parts: {b: {}}
prices: {x: 1.5}
"""
    car = read(Car, text)
    assert car == Car(
        source="berlin",
        doors=3,
        seats=4,
        colour=Colour.GREEN,
        load=0.0,
        lit=True,
        at_m=(1, 2.5),
        engine=Engine(fuel="wind"),
        tags=("t1", "t2"),
        wheels=(Wheel(name="front"), Wheel(name="back", size_m=0.5)),
        axles=(Wheel(name="a", size_m=2),),
        parts={"b": Wheel(name="b")},
        prices={"x": 1.5},
    )
    assert str(car.wheels[1].place) == "f.yaml:11: wheels[1]"


def test_what_is_left_out_has_its_default_and_stands_where_its_holder_does():
    car = read(Car, "from: a\ndoors: 1\n")
    assert car == Car(source="a", doors=1)
    assert car.engine.place == documents.Place(file="f.yaml", key="engine", line=1)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("# from:\ndoors: 1", "from: nothing is given, needed: the key 'from'"),
        ("# from:\nform: a", "needed: the key 'from'; did you misspell it as 'form'?"),
        ("from: A", "f.yaml:2: from: given 'A', allowed: small letters"),
        ("doors: 6", "doors: given 6, allowed: a whole number from 1 to 5"),
        ("doors: 3", "f.yaml:2: doors: given 3, allowed: up to the seats, 2"),
        ("seats: 3", "seats: given 3, allowed: an even number"),
        ("colour: rad", "colour: given 'rad', allowed: red or green; did you mean 'red'?"),
        ("load: 1", "load: given 1, allowed: a finite number from 0, below 1"),
        ("load: 1" + "0" * 400, "allowed: a finite number from 0, below 1"),
        ("lit: 1", "lit: given 1, allowed: true or false"),
        ("at_m: [1, 2, 3]", "at_m: given [1, 2, 3], allowed: 2 values"),
        ("engine: {fuel: sum}", "engine.fuel: given 'sum', allowed: sun or wind; did you mean"),
        ("tags: [1]", "tags[0]: given 1, allowed: a text (quote it)"),
        ("place: {}", "place: given 'place', allowed: the keys at_m, axles"),
        ("maybe: x", "maybe: given 'x', allowed: a number or nothing"),
        ("wheels: [a, {name: b, size_m: 0}]", "wheels[1].size_m: given 0, allowed: a finite"),
        ("axles: {a: {name: b}}", "axles.a.name: given 'name', allowed: no key 'name' here"),
        ("axles: {'': {}}", "f.yaml:3: axles: given '', allowed: names that are not empty"),
        ("door: 2", "; did you mean 'doors'?"),
    ],
)
def test_a_mistake_in_what_a_dataclass_says_is_named_alike(text, said):
    needed = {"from": "from: a\n", "doors": "doors: 1\n"}
    with pytest.raises(documents.DocumentError) as caught:
        read(Car, "".join(line for key, line in needed.items() if f"{key}:" not in text) + text)
    assert said in str(caught.value)


def test_a_document_may_be_a_list():
    text = "- name: a\n- name: b\n  size_m: "
    front, back = read(list[Wheel], f"{text}2\n")
    assert (front, back) == (Wheel(name="a"), Wheel(name="b", size_m=2.0))
    assert str(back.place) == "f.yaml:2: [1]"
    with pytest.raises(documents.DocumentError, match=r"^f\.yaml:3: \[1\]\.size_m: given 0"):
        read(list[Wheel], f"{text}0\n")
    for hint, text, allowed in ((list[Wheel], "1", "a list"), (Wheel, "[1]", "a mapping of keys")):
        with pytest.raises(documents.DocumentError, match=f"allowed: {allowed}"):
            read(hint, text)

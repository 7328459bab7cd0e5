"""Files that people write: each mistake is named by file, line and key, with what is given and allowed."""

from __future__ import annotations

import re
from collections.abc import Mapping  # noqa: TC003  # read at run time
from dataclasses import dataclass, field
from enum import Enum
from typing import Literal

import pytest

from sfglab import documents
from sfglab.errors import InvalidValueError
from sfglab.fields import between, bounds


class Colour(Enum):
    RED = "red"
    GREEN = "green"


def section(text: str) -> documents.Section:
    return documents.Document(text, "f.yaml").section()


def test_values_come_as_they_stand_and_defaults_where_nothing_does():
    top = section("a: 1\nb: 2.5\nc: [1, 2.5]\ne: [x, y]\n")
    assert [top.whole("a", low=0), top.positive("b")] == [1, 2.5]
    assert [top.texts("e"), top.texts("g")] == [("x", "y"), ()]
    assert [top.positive("f", None), top.text("h", "t")] == [None, "t"]
    assert [top.numbers("c", 2), top.numbers("d", 3, (0, 0, 1))] == [(1, 2.5), (0, 0, 1)]
    assert (top.has("b"), top.has("d")) == (True, False)
    assert str(top.place_of("b")) == "f.yaml:2: b"
    top.close()


@pytest.mark.parametrize(
    ("text", "read", "said"),
    [
        ("a: -1", lambda s: s.positive("a"), "f.yaml:1: a: given -1, allowed: a number above zero"),
        ("a: .inf", lambda s: s.positive("a"), "given inf, allowed: a number above zero"),
        ("a: .nan", lambda s: s.positive("a"), "given nan"),
        ("a: true", lambda s: s.positive("a"), "given True"),
        ("a: 1", lambda s: s.close(), "f.yaml:1: a: given 'a', allowed: "),
        (
            "a: {b: {c: 1}}",
            lambda s: s.section("a").section("b").text("c"),
            "f.yaml:1: a.b.c: given 1",
        ),
        ("[1]", lambda s: s, "f.yaml:1: given [1], allowed: a mapping of keys to values"),
        (
            "a: 1\na: 2",
            lambda s: s,
            "f.yaml:2: a: given 'a', allowed: each key once in its mapping",
        ),
        (
            "a: 2001-99-99",
            lambda s: s,
            "f.yaml:1: a: given '2001-99-99', allowed: a value that YAML can read",
        ),
        ("a: \x07", lambda s: s, "f.yaml: given 'unacceptable character"),
        (
            "a: &x [1]\nb: *x",
            lambda s: s,
            "f.yaml:2: b: given 'an alias', allowed: every value written out",
        ),
        ("a: &x\n- *x", lambda s: s, "f.yaml:2: a[0]: given 'an alias'"),
        ("a: 1" + "0" * 400, lambda s: s.positive("a"), "allowed: a number above zero"),
        ("a: [1, .nan]", lambda s: s.numbers("a", 2), "a: given [1, nan], allowed: 2 numbers"),
        ("a: [1, yes]", lambda s: s.numbers("a", 2), "a: given [1, True], allowed: 2 numbers"),
        ("a: 1", lambda s: s.numbers("a", 1), "a: given 1, allowed: 1 numbers"),
        ("a: {", lambda s: s, "allowed: YAML"),
    ],
)
def test_a_mistake_is_named_by_file_line_key_what_is_given_and_what_is_allowed(text, read, said):
    with pytest.raises(documents.DocumentError) as caught:
        read(section(text))
    assert said in str(caught.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(documents.DocumentError, match=r"none\.yaml: .*, allowed: a fleet file$"):
        documents.Document.of_file(tmp_path / "none.yaml", "a fleet file")
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(documents.DocumentError, match=r"bytes\.yaml"):
        documents.Document.of_file(tmp_path / "bytes.yaml")


def test_what_is_missing_stands_where_its_holder_does():
    document = documents.Document("x: 1\na:\n  b: 1\n", "f.yaml")
    assert document.place(("a", "c")) == documents.Place(file="f.yaml", key="a.c", line=2)


def test_only_a_close_word_is_suggested():
    assert documents.suggestion("hardwear", ["hardware"]) == "; did you mean 'hardware'?"
    assert not documents.suggestion("moon", ["hardware"])


def even(section: documents.Section, key: str) -> int:
    value = section.whole(key, low=0)
    if value % 2:
        raise InvalidValueError("anything", value, "an even number")
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Car:
    source: str = field(
        metadata=documents.named("from") | documents.matching(re.compile("[a-z]+"), "small letters")
    )
    doors: int = field(metadata=bounds(1, 5))
    seats: int = field(default=2, metadata=documents.read_by(even))
    colour: Colour = Colour.RED
    colours: frozenset[Colour] = frozenset()
    load: float = between(0.5, 0, 1, without=(1,))
    lit: bool = False
    maybe: float | None = field(default=None, metadata=documents.OR_NULL)
    limit: float | str = "none"
    at_m: tuple[float, float] = (0, 0)
    engine: Engine = field(default_factory=Engine)
    spare: Wheel | None = None
    tags: tuple[str, ...] = field(default=(), metadata=documents.matching(re.compile("t."), "tags"))
    wheels: tuple[Wheel, ...] = field(default=(), metadata=documents.short_for("name"))
    axles: tuple[Wheel, ...] = field(default=(), metadata=documents.by_name("name"))
    parts: Mapping[str, Wheel] = field(default_factory=dict, metadata=documents.by_name("name"))
    prices: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.doors > self.seats:
            raise InvalidValueError("doors", self.doors, f"up to the seats, {self.seats}")


def test_a_mapping_is_read_as_the_dataclass_says():
    car = section("""\
from: berlin
doors: 3
seats: 4
colour: green
colours: [red]
load: 0
lit: true
maybe:
limit: 3
at_m: [1, 2.5]
engine: {fuel: wind}
tags: [t1, t2]
wheels: [front, {name: back, size_m: 0.5}]
axles: {a: {size_m: 2}}
parts: {b: {}}
prices: {x: 1.5}
""").read(Car)
    assert car == Car(
        source="berlin",
        doors=3,
        seats=4,
        colour=Colour.GREEN,
        colours=frozenset({Colour.RED}),
        load=0.0,
        lit=True,
        limit=3.0,
        at_m=(1, 2.5),
        engine=Engine(fuel="wind"),
        tags=("t1", "t2"),
        wheels=(Wheel(name="front"), Wheel(name="back", size_m=0.5)),
        axles=(Wheel(name="a", size_m=2),),
        parts={"b": Wheel(name="b")},
        prices={"x": 1.5},
    )
    assert str(car.wheels[1].place) == "f.yaml:13: wheels[1]"


def test_what_is_left_out_has_its_default_and_stands_where_its_holder_does():
    car = section("from: a\n").read(Car, doors=1)
    assert car == Car(source="a", doors=1)
    assert car.engine.place == documents.Place(file="f.yaml", key="engine", line=1)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("# from:\ndoors: 1", "from: nothing is given, allowed: 'from' is needed here"),
        ("# from:\nform: a", "allowed: 'from' is needed here; did you mean it by 'form'?"),
        ("from: A", "f.yaml:2: from: given 'A', allowed: small letters"),
        ("doors: 6", "doors: given 6, allowed: a whole number from 1 to 5"),
        ("doors: 3", "f.yaml:2: doors: given 3, allowed: up to the seats, 2"),
        ("seats: 3", "seats: given 3, allowed: an even number"),
        ("colour: rad", "colour: given 'rad', allowed: red or green; did you mean 'red'?"),
        (
            "colours: [red, gren]",
            "colours: given 'gren', allowed: red or green; did you mean 'green'?",
        ),
        ("load: 1", "load: given 1, allowed: a finite number from 0, below 1"),
        ("load: 1" + "0" * 400, "allowed: a finite number from 0, below 1"),
        ("prices: {x: .inf}", "prices.x: given inf, allowed: a finite number from 0"),
        ("lit: 1", "lit: given 1, allowed: true or false"),
        ("limit: []", "limit: given [], allowed: a number or a text"),
        ("at_m: [1]", "at_m: given [1], allowed: 2 numbers, all finite"),
        ("engine: 1", "engine: given 1, allowed: a mapping of keys to values"),
        (
            "engine: {fuel: sum}",
            "engine.fuel: given 'sum', allowed: sun or wind; did you mean 'sun'?",
        ),
        ("spare:", "spare: nothing is given, allowed: a mapping"),
        ("tags: [x]", "tags: given 'x', allowed: tags"),
        ("tags: [1]", "tags: given [1], allowed: a list of texts (quote numbers)"),
        ("wheels: 3", "wheels: given 3, allowed: a list"),
        (
            "wheels: [a, {name: b, size_m: 0}]",
            "wheels[1].size_m: given 0, allowed: a number above zero",
        ),
        ("axles: {a: {name: b}}", "axles.a.name: given 'name', allowed: size_m"),
        ("prices: {x: -1}", "prices.x: given -1, allowed: a finite number from 0"),
        ("door: 2", "door: given 'door', allowed: at_m, axles, colour"),
        ("door: 2", "; did you mean 'doors'?"),
    ],
)
def test_a_mistake_in_what_a_dataclass_says_is_named_alike(text, said):
    needed = {"from": "from: a\n", "doors": "doors: 1\n"}
    with pytest.raises(documents.DocumentError) as caught:
        section("".join(line for key, line in needed.items() if f"{key}:" not in text) + text).read(
            Car
        )
    assert said in str(caught.value)


def test_a_document_may_be_a_list():
    first, second = documents.Document("- name: a\n- name: b\n  size_m: 0\n", "f.yaml").items()
    assert first.read(Wheel) == Wheel(name="a")
    with pytest.raises(documents.DocumentError, match=r"^f\.yaml:3: \[1\]\.size_m: given 0"):
        second.read(Wheel)
    with pytest.raises(documents.DocumentError, match="given 1, allowed: a list"):
        list(documents.Document("1", "f.yaml").items())

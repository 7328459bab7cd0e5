"""Files that people write: each mistake is named by file, line and key, with what is given and allowed."""

from __future__ import annotations

from enum import Enum

import pytest

from sfglab.documents import Document, DocumentError, Place, Section, suggestion


class Colour(Enum):
    RED = "red"
    GREEN = "green"


def section(text: str) -> Section:
    return Document(text, "f.yaml").section()


def test_values_come_as_they_stand_and_defaults_where_nothing_does():
    top = section("a: 1\nb: 2.5\nc: yes\nd: red\ne: [x, y]\n")
    assert (top.whole("a", low=0), top.number("b"), top.flag("c"), top.choice("d", Colour.GREEN)) == (
        1,
        2.5,
        True,
        Colour.RED,
    )
    assert top.texts("e") == ("x", "y")
    assert (top.number("f", None), top.choice("g", Colour.GREEN), top.text("h", "t")) == (
        None,
        Colour.GREEN,
        "t",
    )
    top.close()


def test_numbers_come_as_a_tuple_and_what_was_asked_for_is_known():
    top = section("a: [1, 2.5]\nb: 1\n")
    assert top.numbers("a", 2) == (1, 2.5)
    assert top.numbers("c", 3, (0, 0, 1)) == (0, 0, 1)
    assert top.has("b")
    assert not top.has("d")
    assert str(top.place_of("b")) == "f.yaml:2: b"
    top.close()


@pytest.mark.parametrize(
    ("text", "read", "said"),
    [
        ("a: -1", lambda s: s.number("a"), "f.yaml:1: a: given -1, allowed: a finite number from 0"),
        ("a: .inf", lambda s: s.number("a"), "given inf, allowed: a finite number from 0"),
        ("a: .nan", lambda s: s.number("a"), "given nan"),
        ("a: true", lambda s: s.number("a"), "given True"),
        ("a: 2", lambda s: s.number("a", low=1, high=2), "allowed: a finite number from 1, below 2"),
        (
            "x: 0\na: rad",
            lambda s: s.choice("a", Colour.RED),
            "f.yaml:2: a: given 'rad', allowed: red or green; did",
        ),
        ("a: [1]", lambda s: s.texts("a"), "a: given [1], allowed: a list of texts (quote numbers)"),
        ("a: 1", lambda s: s.close(), "f.yaml:1: a: given 'a', allowed: "),
        ("a: {b: {c: 1}}", lambda s: s.section("a").section("b").flag("c"), "f.yaml:1: a.b.c: given 1"),
        ("[1]", lambda s: s, "f.yaml:1: given [1], allowed: a mapping of keys to values"),
        ("a: 1\na: 2", lambda s: s, "f.yaml:2: a: given 'a', allowed: each key once in its mapping"),
        ("a: 2001-99-99", lambda s: s, "f.yaml:1: a: given '2001-99-99', allowed: a value that YAML can read"),
        ("a: \x07", lambda s: s, "f.yaml: given 'unacceptable character"),
        ("a: &x [1]\nb: *x", lambda s: s, "f.yaml:2: b: given 'an alias', allowed: every value written out"),
        ("a: &x\n- *x", lambda s: s, "f.yaml:2: a[0]: given 'an alias'"),
        ("a: 1" + "0" * 400, lambda s: s.number("a"), "allowed: a finite number from 0"),
        ("a: 1" + "0" * 400, lambda s: s.positive("a"), "allowed: a number above zero"),
        ("a: [1, 2]", lambda s: s.numbers("a", 3), "a: given [1, 2], allowed: 3 numbers, all finite"),
        ("a: [1, .nan]", lambda s: s.numbers("a", 2), "a: given [1, nan], allowed: 2 numbers"),
        ("a: [1, yes]", lambda s: s.numbers("a", 2), "a: given [1, True], allowed: 2 numbers"),
        ("a: 1", lambda s: s.numbers("a", 1), "a: given 1, allowed: 1 numbers"),
        ("a: {", lambda s: s, "allowed: YAML"),
    ],
)
def test_a_mistake_is_named_by_file_line_key_what_is_given_and_what_is_allowed(text, read, said):
    with pytest.raises(DocumentError) as caught:
        read(section(text))
    assert said in str(caught.value)


def test_a_file_that_cannot_be_read_is_named(tmp_path):
    with pytest.raises(DocumentError, match=r"none\.yaml: .*, allowed: a fleet file$"):
        Document.of_file(tmp_path / "none.yaml", "a fleet file")
    (tmp_path / "bytes.yaml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DocumentError, match=r"bytes\.yaml"):
        Document.of_file(tmp_path / "bytes.yaml")


def test_what_is_missing_stands_where_its_holder_does():
    document = Document("x: 1\na:\n  b: 1\n", "f.yaml")
    assert document.place(("a", "c")) == Place(file="f.yaml", key="a.c", line=2)


def test_only_a_close_word_is_suggested():
    assert suggestion("hardwear", ["hardware"]) == "; did you mean 'hardware'?"
    assert not suggestion("moon", ["hardware"])

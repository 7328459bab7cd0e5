"""YAML files that people write, read strictly into dataclasses, with the line of every mistake.

`Section.read` reads a mapping by the fields of a dataclass: keys, types, bounds (`sfglab.fields.between`) and
defaults are declared there and nowhere else. What depends on more than its field is read key by key.
"""

from __future__ import annotations

import dataclasses
import re
import sys
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from sfglab.errors import InvalidValueError
from sfglab.fields import BOUNDS, Bounds, alternatives_of, choices_of, typed_fields
from sfglab.files import read_text

if TYPE_CHECKING:
    import yaml

KeyPath = tuple[str | int, ...]  #: Keys and list positions from the top of a document.
_TEXT = "tag:yaml.org,2002:str"
_MOST_CHARACTERS, _LONGEST_PLAIN = 2**20, 1000  # ten times the largest fleet; of what is no text
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029]")

T = TypeVar("T")
_REQUIRED: Any = object()


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where something stands in a file."""

    file: str = ""  #: Name of the file.
    #: Keys from the top, as in ``agents.go2.publishes[2]``; empty for the whole file.
    key: str = ""
    line: int = 0  #: Line from 1; 0 where there is none.

    def __str__(self) -> str:
        where = f"{self.file}:{self.line}" if self.line else self.file
        return ": ".join(part for part in (where, self.key) if part)


NOWHERE = Place()


class DocumentError(InvalidValueError):
    """A file does not say what it must say."""

    place: Place


def suggestion(word: object, known: Iterable[str]) -> str:
    """Return ``; did you mean 'x'?`` for the closest known word, or nothing when none is close."""
    close = get_close_matches(str(word), list(known), n=1, cutoff=0.6)
    return f"; did you mean {close[0]!r}?" if close else ""


class Document:
    """A YAML file's plain values and the line of each; its name is for messages.

    With `one_line` no text has a line break or another control character. A `DocumentError` says where it is
    not YAML, a key stands twice or is not text, or there is an alias, with which a file could contain itself.
    """

    def __init__(self, text: str, file: str, *, one_line: bool = False) -> None:
        import yaml

        self.file = file
        self._text = text
        self._one_line = one_line
        self._lines: dict[KeyPath, int] = {(): 1}
        self._seen: set[int] = set()
        if len(text) > _MOST_CHARACTERS:
            raise DocumentError(
                Place(file=file), f"{len(text)} characters", f"at most {_MOST_CHARACTERS}"
            )
        try:
            node = yaml.compose(text, Loader=yaml.SafeLoader)
            #: Mappings, lists and scalars.
            self.value = None if node is None else self._read(yaml.SafeLoader(""), node, ())
        except (
            yaml.YAMLError,
            RecursionError,
            ValueError,
        ) as error:  # ValueError: no character has the number
            if isinstance(error, DocumentError):
                raise
            mark = getattr(error, "problem_mark", None)
            place = Place(file=file, line=mark.line + 1 if mark else 0)
            raise DocumentError(
                place, getattr(error, "problem", None) or str(error), "YAML"
            ) from error

    @classmethod
    def of_file(
        cls, path: Path | str, what: str = "a readable text file", *, one_line: bool = False
    ) -> Document:
        """Read a file; `what` says in a `DocumentError` what it should be."""
        try:
            text = read_text(Path(path), what)
        except InvalidValueError as error:
            raise DocumentError(Place(file=str(path)), error.given, what) from error
        return cls(text, str(path), one_line=one_line)

    def place(self, path: KeyPath) -> Place:
        """Return where a value stands; of what is missing, where its nearest holder does."""
        known = path
        while known not in self._lines:
            known = known[:-1]
        return Place(file=self.file, key=_key_text(path), line=self._lines[known])

    def section(self) -> Section:
        """Return the whole document as a section; raises `DocumentError` if it is not a mapping."""
        return Section(self, (), self.value)

    def items(self) -> Iterator[Section]:
        """Yield a section for every item of a document that is a list; raises as `section` does."""
        return _sections(self, (), self.value)

    def _read(self, loader: yaml.SafeLoader, node: yaml.Node, path: KeyPath) -> Any:
        import yaml

        self._lines.setdefault(path, node.start_mark.line + 1)
        if id(node) in self._seen:
            raise DocumentError(
                self._alias(path), "an alias", "every value written out where it belongs"
            )
        self._seen.add(id(node))
        if self._one_line and isinstance(node, yaml.ScalarNode) and _CONTROL.search(node.value):
            raise DocumentError(self.place(path), node.value, "a text of one line")
        if isinstance(node, yaml.MappingNode):
            return dict(self._read_pairs(loader, node, path))
        if isinstance(node, yaml.SequenceNode):
            return [self._read(loader, item, (*path, i)) for i, item in enumerate(node.value)]
        if (
            node.tag != _TEXT and len(node.value) > _LONGEST_PLAIN
        ):  # a number by base 60 takes quadratic time
            raise DocumentError(
                self.place(path), node.value, f"at most {_LONGEST_PLAIN} characters, or quoted"
            )
        try:
            return loader.construct_object(node)
        # A date that is none, or a tag whose text is not of its kind: PyYAML looks before it has checked.
        except (ValueError, OverflowError, LookupError, AttributeError, TypeError) as error:
            raise DocumentError(
                self.place(path), node.value, "a value that YAML can read"
            ) from error

    def _alias(self, path: KeyPath) -> Place:
        """Return where the first alias stands; its node only knows where it was written out."""
        import yaml

        mark = next(
            (e.start_mark for e in yaml.parse(self._text) if isinstance(e, yaml.AliasEvent)), None
        )
        return Place(file=self.file, key=_key_text(path), line=mark.line + 1 if mark else 0)

    def _read_pairs(
        self, loader: yaml.SafeLoader, node: yaml.MappingNode, path: KeyPath
    ) -> Iterator[tuple[str, Any]]:
        seen: set[str] = set()
        for key, value in node.value:
            inner = (*path, str(key.value))
            place = Place(file=self.file, key=_key_text(inner), line=key.start_mark.line + 1)
            self._lines[inner] = place.line
            if key.tag != _TEXT:
                raise DocumentError(place, key.value, "a key that is text (quote it)")
            if self._one_line and _CONTROL.search(key.value):
                raise DocumentError(place, key.value, "a key of one line")
            if key.value in seen:
                raise DocumentError(place, key.value, "each key once in its mapping")
            seen.add(key.value)
            yield key.value, self._read(loader, value, inner)


def _is_finite(value: object) -> bool:
    """Tell whether a value is a number that a float can hold."""
    return (
        isinstance(value, int | float)
        and not isinstance(value, bool)
        and abs(value) <= sys.float_info.max
    )


def _is_text(value: object) -> bool:
    return isinstance(value, str) and value != ""


def _key_text(path: KeyPath) -> str:
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += f".{part}" if text else part
    return text


class Section:
    """One mapping of a document; `close` refuses keys that nobody has read.

    Its readers return what stands at a key, or the default where nothing does, and raise a `DocumentError`
    where something else stands there, or nothing and there is no default; where there is no mapping, too.
    """

    def __init__(self, document: Document, path: KeyPath, value: Any) -> None:
        if not isinstance(value, dict):
            raise DocumentError(document.place(path), value, "a mapping of keys to values")
        self._document = document
        self._path = path
        self._known: set[str] = set()
        self._all_known = False
        self._values: dict[str, Any] = value

    @property
    def here(self) -> Place:
        """Where the section stands."""
        return self._document.place(self._path)

    def place_of(self, key: str) -> Place:
        """Return where a key stands, or the section where it does not."""
        return self._document.place((*self._path, key))

    def refusal(self, key: str, given: object, allowed: str) -> DocumentError:
        """Return the error for what stands at a key."""
        return DocumentError(self.place_of(key), given, allowed)

    def has(self, key: str) -> bool:
        """Tell whether anything stands at a key, which is then known to `close`."""
        self._known.add(key)
        return key in self._values

    def get(self, key: str, default: Any = _REQUIRED) -> Any:
        """Return what stands at a key, whatever it is."""
        self._known.add(key)
        if key not in self._values:
            if default is _REQUIRED:
                raise self.refusal(key, None, f"{key!r} is needed here{self._slip(key)}")
            return default
        return self._values[key]

    def _checked(self, key: str, default: Any, allowed: str, *, fits: Callable[[Any], bool]) -> Any:
        value = self.get(key, default)
        if key in self._values and not fits(value):
            raise self.refusal(key, value, allowed)
        return value

    def text(self, key: str, default: Any = _REQUIRED, *, choices: tuple[str, ...] = ()) -> Any:
        """Return a text, or the default where there is none."""
        value = self._checked(key, default, "a text", fits=_is_text)
        if choices and key in self._values and value not in choices:
            raise self.refusal(key, value, " or ".join(choices) + suggestion(value, choices))
        return value

    def whole(self, key: str, default: Any = _REQUIRED, *, low: int) -> Any:
        """Return a whole number, or the default where there is none."""
        return self._number(key, default, int, Bounds(low))

    def positive(self, key: str, default: Any = _REQUIRED) -> Any:
        """Return a number above zero, or the default where there is none."""
        return self._number(key, default, float, Bounds(0, without=(0,)))

    def _number(self, key: str, default: Any, kind: type[int | float], bounds: Bounds) -> Any:
        word = "a number" if bounds.low in bounds.without else "a finite number"
        word = "a whole number" if kind is int else word

        def fits(value: Any) -> bool:
            return (type(value) is int if kind is int else _is_finite(value)) and value in bounds

        value = self._checked(key, default, f"{word} {bounds}".rstrip(), fits=fits)
        return kind(value) if key in self._values else value

    def numbers(self, key: str, count: int, default: Any = _REQUIRED) -> Any:
        """Return a list of so many finite numbers as they stand, as a tuple, or the default."""

        def fits(value: Any) -> bool:
            return isinstance(value, list) and len(value) == count and all(map(_is_finite, value))

        value = self._checked(key, default, f"{count} numbers, all finite", fits=fits)
        return tuple(value) if isinstance(value, list) else value

    def texts(self, key: str) -> tuple[str, ...]:
        """Return a list of texts, none where nothing stands."""

        def fits(value: Any) -> bool:
            return isinstance(value, list) and all(map(_is_text, value))

        return tuple(self._checked(key, (), "a list of texts (quote numbers)", fits=fits))

    def section(self, key: str) -> Section:
        """Return the mapping at a key, an empty one where there is none."""
        return Section(self._document, (*self._path, key), self.get(key, {}))

    def members(self, key: str) -> Iterator[tuple[Any, Section]]:
        """Yield name and section for every member of a mapping of mappings."""
        inner = self.section(key)
        for name in inner._values:  # noqa: SLF001 - of the same class
            yield name, inner.section(name)

    def items(self, key: str, *, short: str = "") -> Iterator[Section]:
        """Yield a section for each item of a list; a text stands for a mapping with the key `short`."""
        return _sections(self._document, (*self._path, key), self.get(key, []), short)

    def read(self, cls: type[T], *, whole_section: bool = True, **given: Any) -> T:
        """Return the section as a dataclass, each field from the key of its name, and close it if whole.

        What may stand at a key follows from the field's type: ``str`` (not empty), ``bool``, ``int`` and
        ``float`` (from 0, or as `sfglab.fields.between` says), an enumeration by its values, a ``Literal``,
        another dataclass, lists (tuple, frozenset) of texts, choices or dataclasses, tuples of so many numbers,
        mappings by name, and unions of what differs in YAML. A `Place` is where the section stands. Metadata
        says what a type cannot: `named`, `read_by`, `matching`, `by_name`, `short_for`, `OR_NULL`. An
        `InvalidValueError` of the class is refused at its field's key. Types must be importable at run time;
        given are fields that are not read here.
        """
        typed = typed_fields(typing.cast("Any", cls)).values()
        fields = {f.metadata.get("key", f.name): f for f in typed if f.init and f.name not in given}
        self._known |= {key for key, f in fields.items() if f.type is not Place}
        self._all_known = True
        for key, f in fields.items():
            if f.type is Place:
                given[f.name] = self.here
            elif key in self._values or f.default is f.default_factory:  # both are missing
                given[f.name] = self._read_field(key, f.type, f.metadata)
            elif f.default_factory is f.type:  # all defaults, read all the same for their place
                given[f.name] = self.section(key).read(f.default_factory)
        if whole_section:
            self.close()
        with _refused_at(self.here, {f.name: self.place_of(key) for key, f in fields.items()}):
            return cls(**given)

    def _read_field(self, key: str, hint: Any, extra: Mapping[str, Any]) -> Any:
        value = self.get(key)
        if value is None and "null" in extra:
            return None
        if "read" in extra:
            with _refused_at(self.place_of(key)):
                return extra["read"](self, key)
        if "names" in extra:
            return self._read_by_name(key, hint, extra["names"])
        options = {_kind_of(option): option for option in alternatives_of(hint)}
        kind = next((k for k in options if isinstance(value, _KINDS[k])), next(iter(options)))
        if len(options) > 1 and not isinstance(value, _KINDS[kind]):
            raise self.refusal(key, value, " or ".join(options))
        read = {"a mapping": self._read_mapping, "a list": self._read_list}.get(
            kind, self._read_scalar
        )
        return read(key, options[kind], extra)

    def _read_scalar(self, key: str, hint: Any, extra: Mapping[str, Any]) -> Any:
        if hint in (int, float):
            return self._number(key, _REQUIRED, hint, extra.get(BOUNDS, Bounds(0)))
        if hint is bool:
            return self._checked(
                key, _REQUIRED, "true or false", fits=lambda value: isinstance(value, bool)
            )
        choices = choices_of(hint)
        text = self.text(key, choices=tuple(choices))
        self._match(key, [text], extra)
        return choices.get(text, text)

    def _read_mapping(self, key: str, hint: Any, extra: Mapping[str, Any]) -> Any:
        inner = self.section(key)
        if isinstance(hint, type):
            return inner.read(typing.cast("type[Any]", hint))
        each, read = typing.get_args(hint)[1], inner._read_field  # noqa: SLF001 - of the same class
        return {name: read(name, each, extra) for name in inner._values}  # noqa: SLF001 - of the same class

    def _read_by_name(self, key: str, hint: Any, field: str) -> Any:
        cls: Any = next(filter(dataclasses.is_dataclass, typing.get_args(hint)))
        values = {name: section.read(cls, **{field: name}) for name, section in self.members(key)}
        return values if issubclass(typing.get_origin(hint), Mapping) else tuple(values.values())

    def _read_list(self, key: str, hint: Any, extra: Mapping[str, Any]) -> Any:
        made, (each, *more) = typing.get_origin(hint), typing.get_args(hint)
        if each in (int, float):
            return self.numbers(key, 1 + len(more))
        if dataclasses.is_dataclass(each):
            items = self.items(key, short=extra.get("short", ""))
            return made(item.read(typing.cast("type[Any]", each)) for item in items)
        texts, choices = self.texts(key), choices_of(each)
        for text in texts:
            if choices and text not in choices:
                raise self.refusal(key, text, " or ".join(choices) + suggestion(text, choices))
        self._match(key, texts, extra)
        return made(choices.get(text, text) for text in texts)

    def _match(self, key: str, texts: Iterable[str], extra: Mapping[str, Any]) -> None:
        pattern, allowed = extra.get("matching", (None, ""))
        for text in texts:
            if pattern is not None and not pattern.fullmatch(text):
                raise self.refusal(key, text, allowed)

    def close(self) -> None:
        """Refuse the first key that was not read, with those that are allowed and what was probably meant."""
        for key in self._values:
            if key not in self._known:
                raise self.refusal(
                    key, key, ", ".join(sorted(self._known)) + suggestion(key, self._known)
                )

    def _slip(self, key: str) -> str:
        """Return which unknown key a missing one was probably meant by; key by key, it may be known later."""
        unknown = [other for other in self._values if other not in self._known]
        close = get_close_matches(key, unknown, n=1, cutoff=0.6 if self._all_known else 0.75)
        return f"; did you mean it by {close[0]!r}?" if close else ""


@contextmanager
def _refused_at(
    place: Place, fields: Mapping[str, Place] = types.MappingProxyType({})
) -> Iterator[None]:
    """Let an error that is not about a place say one: its field's, or the one given."""
    try:
        yield
    except DocumentError:
        raise
    except InvalidValueError as error:
        raise DocumentError(
            fields.get(str(error.place), place), error.given, error.allowed
        ) from error


def _sections(document: Document, path: KeyPath, value: Any, short: str = "") -> Iterator[Section]:
    if not isinstance(value, list):
        raise DocumentError(document.place(path), value, "a list")
    for position, item in enumerate(value):
        yield Section(
            document, (*path, position), {short: item} if short and isinstance(item, str) else item
        )


# What a field's type cannot say, as its metadata: ``field(metadata=named("from") | bounds(1, 9))``.

OR_NULL: Mapping[str, Any] = {"null": True}  #: Null may stand there, and says None.


def named(key: str) -> dict[str, Any]:
    """Read a field from a key of another name."""
    return {"key": key}


def read_by(read: Callable[[Section, str], Any], like: Any = None) -> dict[str, Any]:
    """Read a field by a function of section and key, whose errors are refused there; `like` says its form."""
    return {"read": read, "like": like} if like else {"read": read}


def matching(pattern: re.Pattern[str], allowed: str) -> dict[str, Any]:
    """Refuse texts that do not match a pattern; says what is allowed instead."""
    return {"matching": (pattern, allowed)}


def by_name(field: str) -> dict[str, Any]:
    """Read a tuple or a mapping of dataclasses from a mapping whose keys become one of their fields."""
    return {"names": field}


def short_for(key: str) -> dict[str, Any]:
    """Let a text in a list of dataclasses stand for a mapping with this one key."""
    return {"short": key}


_KINDS: dict[str, Any] = {
    "a mapping": dict,
    "a list": list,
    "true or false": bool,
    "a number": int | float,
    "a text": str,
}


def _kind_of(hint: Any) -> str:
    """Return which of `_KINDS` says a type in YAML."""
    origin = typing.get_origin(hint) or hint
    if dataclasses.is_dataclass(origin) or origin in (dict, Mapping):
        return "a mapping"
    if origin in (tuple, frozenset, list):
        return "a list"
    return {bool: "true or false", int: "a number", float: "a number"}.get(origin, "a text")

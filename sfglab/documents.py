"""YAML files that people write, read key by key and strictly, with the line of every mistake.

Knows files, lines and key paths, and says for every refusal what was given and what is allowed. Refuses to
know what a file is about: fleets, topics, graphs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from difflib import get_close_matches
from enum import Enum
from typing import TYPE_CHECKING, Any, TypeVar

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    import pathlib
    from collections.abc import Iterable, Iterator

    import yaml


KeyPath = tuple[str | int, ...]
"""Keys and list positions from the top of a document."""

_Choice = TypeVar("_Choice", bound=Enum)
_REQUIRED: Any = object()


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where something stands in a file."""

    file: str = ""  #: Name of the file.
    key: str = ""  #: Keys from the top, as in ``agents.go2.publishes[2]``; empty for the whole file.
    line: int = 0  #: Line from 1; 0 where there is none.

    def __str__(self) -> str:
        where = f"{self.file}:{self.line}" if self.line else self.file
        return ": ".join(part for part in (where, self.key) if part)


NOWHERE = Place()


class DocumentError(SfglabError, ValueError):
    """A file does not say what it must say.

    Attributes:
        place: Where.
        given: What stands there; None where nothing does.
        allowed: What is allowed in its place.
    """

    def __init__(self, place: Place, given: object, allowed: str) -> None:
        self.place = place
        self.given = given
        self.allowed = allowed
        super().__init__(place, given, allowed)  # all arguments, so that the error survives pickling

    def __str__(self) -> str:
        given = "nothing is given" if self.given is None else f"given {self.given!r}"
        return f"{self.place}: {given}, allowed: {self.allowed}"


def suggestion(word: object, known: Iterable[str]) -> str:
    """Return ``; did you mean 'x'?`` for the closest known word, or nothing when none is close."""
    close = get_close_matches(str(word), list(known), n=1, cutoff=0.6)
    return f"; did you mean {close[0]!r}?" if close else ""


class Document:
    """A YAML file's plain values and the line of each.

    Args:
        text: What stands in the file.
        file: Its name, for messages.

    Attributes:
        value: Mappings, lists and scalars.
        file: The file's name.

    Raises:
        DocumentError: It is not YAML, a key stands there twice, a key is not text, or there is an alias, with
            which a file could contain itself.
    """

    def __init__(self, text: str, file: str) -> None:
        import yaml

        self.file = file
        self._text = text
        self._lines: dict[KeyPath, int] = {(): 1}
        self._seen: set[int] = set()
        try:
            loader = yaml.SafeLoader(text)
            try:
                node = loader.get_single_node()
                self.value = None if node is None else self._read(loader, node, ())
            finally:
                loader.dispose()
        except (yaml.YAMLError, RecursionError) as error:
            mark = getattr(error, "problem_mark", None)
            place = Place(file=file, line=mark.line + 1 if mark else 0)
            problem = getattr(error, "problem", None) or str(error)
            raise DocumentError(place, problem, "YAML") from error

    @classmethod
    def of_file(cls, path: pathlib.Path, what: str = "a readable text file") -> Document:
        """Read a file.

        Args:
            path: Where it is.
            what: What it should be, for messages.

        Raises:
            DocumentError: It cannot be read, or is not YAML.
        """
        try:
            text = path.read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            raise DocumentError(Place(file=str(path)), str(error), what) from error
        return cls(text, str(path))

    def place(self, path: KeyPath) -> Place:
        """Return where a value stands; of what is missing, where its nearest holder does."""
        known = path
        while known not in self._lines:
            known = known[:-1]
        return Place(file=self.file, key=_key_text(path), line=self._lines[known])

    def section(self) -> Section:
        """Return the whole document as a section.

        Raises:
            DocumentError: It is not a mapping.
        """
        return Section(self, (), self.value)

    def _read(self, loader: yaml.SafeLoader, node: yaml.Node, path: KeyPath) -> Any:
        import yaml

        self._lines.setdefault(path, node.start_mark.line + 1)
        if id(node) in self._seen:
            raise DocumentError(self._alias(path), "an alias", "every value written out where it belongs")
        self._seen.add(id(node))
        if isinstance(node, yaml.MappingNode):
            return dict(self._read_pairs(loader, node, path))
        if isinstance(node, yaml.SequenceNode):
            return [self._read(loader, item, (*path, i)) for i, item in enumerate(node.value)]
        try:
            return loader.construct_object(node)
        except (ValueError, OverflowError) as error:  # it looks like a date, and is none
            raise DocumentError(self.place(path), node.value, "a value that YAML can read") from error

    def _alias(self, path: KeyPath) -> Place:
        """Return where the first alias stands; its node only knows where it was written out."""
        import yaml

        marks = (e.start_mark for e in yaml.parse(self._text) if isinstance(e, yaml.AliasEvent))
        mark = next(marks, None)
        return Place(file=self.file, key=_key_text(path), line=mark.line + 1 if mark else 0)

    def _read_pairs(
        self, loader: yaml.SafeLoader, node: yaml.MappingNode, path: KeyPath
    ) -> Iterator[tuple[str, Any]]:
        seen: set[str] = set()
        for key, value in node.value:
            inner = (*path, str(key.value))
            place = Place(file=self.file, key=_key_text(inner), line=key.start_mark.line + 1)
            self._lines[inner] = place.line
            if key.tag != "tag:yaml.org,2002:str":
                raise DocumentError(place, key.value, "a key that is text (quote it)")
            if key.value in seen:
                raise DocumentError(place, key.value, "each key once in its mapping")
            seen.add(key.value)
            yield key.value, self._read(loader, value, inner)


def _is_finite(value: object) -> bool:
    """Tell whether a value is a number that a float can hold."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _key_text(path: KeyPath) -> str:
    text = ""
    for part in path:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            text += f".{part}" if text else part
    return text


class Section:
    """One mapping of a document, read key by key; `close` refuses keys that nobody has read.

    Args:
        document: Where it stands.
        path: Its keys from the top.
        value: What stands there.

    Raises:
        DocumentError: It is not a mapping.
    """

    def __init__(self, document: Document, path: KeyPath, value: Any) -> None:
        self._document = document
        self._path = path
        self._known: set[str] = set()
        self._values: dict[str, Any] = {}
        if not isinstance(value, dict):
            raise DocumentError(document.place(path), value, "a mapping of keys to values")
        self._values = value

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
        """Return what stands at a key, whatever it is.

        Raises:
            DocumentError: Nothing does, and there is no default.
        """
        self._known.add(key)
        if key not in self._values:
            if default is _REQUIRED:
                raise self.refusal(key, None, f"{key!r} is needed here")
            return default
        return self._values[key]

    def text(self, key: str, default: Any = _REQUIRED, *, choices: tuple[str, ...] = ()) -> Any:
        """Return a text, or the default where there is none.

        Raises:
            DocumentError: It is not text, is empty, or is not among the choices.
        """
        value = self.get(key, default)
        if key not in self._values:
            return value
        if not isinstance(value, str) or not value:
            raise self.refusal(key, value, "a text")
        if choices and value not in choices:
            raise self.refusal(key, value, " or ".join(choices) + suggestion(value, choices))
        return value

    def whole(self, key: str, default: Any = _REQUIRED, *, low: int, high: int | None = None) -> Any:
        """Return a whole number, or the default where there is none.

        Raises:
            DocumentError: It is no whole number, or it is out of range.
        """
        value = self.get(key, default)
        if key not in self._values:
            return value
        if isinstance(value, bool) or not isinstance(value, int) or value < low or (high and value > high):
            allowed = f"a whole number from {low}" + (f" to {high}" if high else "")
            raise self.refusal(key, value, allowed)
        return value

    def positive(self, key: str, default: Any = _REQUIRED) -> Any:
        """Return a number above zero, or the default where there is none.

        Raises:
            DocumentError: It is no number, or not above zero.
        """
        value = self.get(key, default)
        if key not in self._values:
            return value
        if not _is_finite(value) or value <= 0:
            raise self.refusal(key, value, "a number above zero")
        return float(value)

    def number(
        self, key: str, default: Any = _REQUIRED, *, low: float = 0.0, high: float = float("inf")
    ) -> Any:
        """Return a finite number from one bound, included, to another, excluded, or the default.

        Raises:
            DocumentError: It is no number, or is out of range.
        """
        value = self.get(key, default)
        if key not in self._values:
            return value
        if not _is_finite(value) or not low <= value < high:
            upper = "" if high == float("inf") else f", below {high:g}"
            raise self.refusal(key, value, f"a finite number from {low:g}{upper}")
        return float(value)

    def numbers(self, key: str, count: int, default: Any = _REQUIRED) -> Any:
        """Return a list of so many finite numbers as they stand, as a tuple, or the default.

        Raises:
            DocumentError: It is no list, holds more or fewer, or something else.
        """
        value = self.get(key, default)
        if key not in self._values:
            return value
        if not isinstance(value, list) or len(value) != count or not all(map(_is_finite, value)):
            raise self.refusal(key, value, f"{count} numbers, all finite")
        return tuple(value)

    def choice(self, key: str, default: _Choice) -> _Choice:
        """Return the member of an enumeration whose value stands there, or the default.

        Raises:
            DocumentError: It has no such member.
        """
        value = self.text(key, default.value, choices=tuple(member.value for member in type(default)))
        return type(default)(value)

    def flag(self, key: str, default: Any = _REQUIRED) -> Any:
        """Return true or false, or the default where there is neither.

        Raises:
            DocumentError: It is neither.
        """
        value = self.get(key, default)
        if key in self._values and not isinstance(value, bool):
            raise self.refusal(key, value, "true or false")
        return value

    def texts(self, key: str, default: tuple[str, ...] = ()) -> tuple[str, ...]:
        """Return a list of texts, or the default where there is none.

        Raises:
            DocumentError: It is not a list of texts.
        """
        value = self.get(key, list(default))
        if not isinstance(value, list) or not all(isinstance(item, str) and item for item in value):
            raise self.refusal(key, value, "a list of texts (quote numbers)")
        return tuple(value)

    def section(self, key: str) -> Section:
        """Return the mapping at a key, an empty one where there is none.

        Raises:
            DocumentError: Something else stands there.
        """
        return Section(self._document, (*self._path, key), self.get(key, {}))

    def members(self, key: str) -> Iterator[tuple[str, Section]]:
        """Yield name and section for every member of a mapping of mappings.

        Raises:
            DocumentError: It, or a member, is something else.
        """
        inner = self.section(key)
        for name in inner._values:  # noqa: SLF001 - of the same class
            yield name, inner.section(name)

    def items(self, key: str, *, short: str = "") -> Iterator[Section]:
        """Yield a section for every item of a list, nothing where there is no list.

        Args:
            key: Where the list stands.
            short: A text among the items stands for a mapping with this one key.

        Raises:
            DocumentError: It is not a list, or an item is not a mapping.
        """
        value = self.get(key, [])
        if not isinstance(value, list):
            raise self.refusal(key, value, "a list")
        for position, item in enumerate(value):
            content = {short: item} if short and isinstance(item, str) else item
            yield Section(self._document, (*self._path, key, position), content)

    def close(self) -> None:
        """Refuse the first key that was not read.

        Raises:
            DocumentError: With the keys that are allowed and the one that was probably meant.
        """
        for key in self._values:
            if key not in self._known:
                allowed = ", ".join(sorted(self._known)) + suggestion(key, self._known)
                raise self.refusal(key, key, allowed)

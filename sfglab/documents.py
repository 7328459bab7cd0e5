"""YAML files that people write, read strictly into dataclasses, with the line of every mistake.

`Document.read` reads values by the fields of a dataclass: keys, types, bounds (`sfglab.fields.between`)
and defaults are declared there and nowhere else; pydantic checks them (`sfglab.validation`). `OR_NULL`,
`ReadAs`, `Matching`, `ByName` and `ShortFor` are written beside a type, in ``Annotated``.
"""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar, get_args, get_origin

from sfglab.errors import InvalidValueError, KeyPath, key_text
from sfglab.files import read_text
from sfglab.validation import Source, read, value_at

if TYPE_CHECKING:
    from collections.abc import Callable

    import yaml

_TEXT = "tag:yaml.org,2002:str"
_ALIAS = "tag:sfglab:alias"
_MOST_CHARACTERS = 2**20  # ten times the largest fleet
_LONGEST_PLAIN = 1000  # characters of a value that is no text
_EXPONENT = re.compile(r"[-+]?[0-9.]+[eE][-+]?[0-9]+")
_CONTROL = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029]")

T = TypeVar("T")


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Place of a value in a file.

    `Document.read` fills in the field ``place`` of a dataclass; the file has no key of this name.
    """

    file: str = ""  #: Name of the file.
    #: Keys from the top, as in ``agents.go2.publishes[2]``; empty for the whole file.
    key: str = ""
    line: int = 0  #: Line from 1; 0 where there is none.

    def __str__(self) -> str:
        where = f"{self.file}:{self.line}" if self.line else self.file
        return ": ".join(part for part in (where, self.key) if part)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: Any) -> Any:
        from pydantic_core.core_schema import is_instance_schema

        return is_instance_schema(cls)

    @classmethod
    def __get_pydantic_json_schema__(cls, core: Any, handler: Any) -> Any:
        from pydantic_core import PydanticOmit

        raise PydanticOmit


NOWHERE = Place()


class DocumentError(InvalidValueError):
    """A file violates its format; the error names the place, the given value and the allowed values."""

    place: Place


class Document:
    """The plain values of a YAML file, and the line of each value.

    Args:
        text: Text of the file.
        file: Name of the file in errors.
        one_line: Whether texts with a line break or another control character are refused.

    Raises:
        DocumentError: The text is not YAML; a key is duplicate or is not text; or there is an alias, with which a
            file could contain itself.
    """

    def __init__(self, text: str, file: str, *, one_line: bool = False) -> None:
        import yaml

        self.file = file
        self._one_line = one_line
        self._lines: dict[KeyPath, int] = {(): 1}
        if len(text) > _MOST_CHARACTERS:
            raise self.refusal(
                (), f"{len(text)} characters", f"at most {_MOST_CHARACTERS} characters"
            )
        try:
            self._loader = _loader_class()(text)
            node = self._loader.get_single_node()
            #: Mappings, lists and scalars.
            self.value: Any = None if node is None else self._read(node, ())
        except DocumentError:
            raise
        # A ValueError is a number of a character that does not exist.
        except (yaml.YAMLError, RecursionError, ValueError) as error:
            mark = getattr(error, "problem_mark", None)
            place = Place(file=file, line=mark.line + 1 if mark else 0)
            problem = getattr(error, "problem", None) or str(error)
            given = ValueError(f"not valid YAML ({problem})")
            raise DocumentError(
                place, given, "complete brackets and quotes, spaces as indentation"
            ) from error

    @classmethod
    def of_file(
        cls, path: Path | str, what: str = "a readable text file", *, one_line: bool = False
    ) -> Document:
        """Read a file.

        Args:
            path: Path of the file.
            what: Description of the expected file in errors.
            one_line: As for the class.

        Raises:
            DocumentError: The file cannot be read, or as for the class.
        """
        try:
            text = read_text(Path(path), what)
        except InvalidValueError as error:
            raise DocumentError(Place(file=str(path)), error.given, what) from error
        return cls(text, str(path), one_line=one_line)

    def place(self, path: KeyPath) -> Place:
        """Return the place of a value; for a missing value, the place of the nearest mapping or list that exists."""
        known = path
        while known not in self._lines:
            known = known[:-1]
        return Place(file=self.file, key=key_text(path), line=self._lines[known])

    def read(self, hint: type[T]) -> T:
        """Return the values as an object of a type, such as a dataclass.

        Raises:
            DocumentError: A key is unknown or missing, or a value is not allowed.
        """
        try:
            made: T = read(hint, self.value, source=Source.FILE)
        except InvalidValueError as error:
            raise self.refusal(error.place, error.given, error.allowed) from error
        self._locate(made, ())
        return made

    def refusal(self, path: KeyPath, given: object, allowed: str) -> DocumentError:
        """Return the error for the value at a path, with the given value and the allowed values in words."""
        if isinstance(given, str) and _EXPONENT.fullmatch(given):
            allowed += (
                "; YAML reads this as text, and as a number with a point and a sign, as in 1.0e-9"
            )
        return DocumentError(self.place(path), given, allowed)

    def _locate(self, made: Any, path: KeyPath) -> None:
        """Set the field ``place`` of all dataclasses in an object that was made from the values at a path."""
        inner: dict[Any, Any] = {}
        if isinstance(made, dict):
            inner = made
        elif isinstance(made, tuple | list):
            value = value_at(self.value, path)
            keys = value if isinstance(value, dict) else range(len(made))
            inner = dict(zip(keys, made, strict=False))
        elif dataclasses.is_dataclass(made):
            for field in dataclasses.fields(made):
                one = getattr(made, field.name)
                if isinstance(one, Place):
                    object.__setattr__(made, field.name, self.place(path))
                else:
                    inner[field.metadata.get("alias", field.name)] = one
        for key, one in inner.items():
            self._locate(one, (*path, key))

    def _read(self, node: Any, path: KeyPath) -> Any:
        """Return the plain values of a node, and store their lines."""
        self._lines.setdefault(path, node.start_mark.line + 1)
        if node.tag == _ALIAS:
            raise self.refusal(path, "an alias", "a value that is written out here")
        if node.id == "mapping":
            return self._read_mapping(node, path)
        if node.id == "sequence":
            return [self._read(item, (*path, i)) for i, item in enumerate(node.value)]
        self._check_line(node.value, path, "a text")
        # The conversion of a number in base 60 takes quadratic time.
        if node.tag != _TEXT and len(node.value) > _LONGEST_PLAIN:
            allowed = f"at most {_LONGEST_PLAIN} characters, or quoted"
            raise self.refusal(path, node.value, allowed)
        try:
            return self._loader.construct_object(node)
        # A date that is none, or a tag whose text is not of its kind: PyYAML looks before it has checked.
        except (ValueError, OverflowError, LookupError, AttributeError, TypeError) as error:
            raise self.refusal(path, node.value, "a value that YAML can read") from error

    def _read_mapping(self, node: Any, path: KeyPath) -> dict[str, Any]:
        made: dict[str, Any] = {}
        for key_node, value in node.value:
            if key_node.id != "scalar" or key_node.tag == _ALIAS:
                raise self.refusal(path, "an alias, a list or a mapping as a key", "text as a key")
            key = key_node.value
            inner = (*path, key)
            self._lines[inner] = key_node.start_mark.line + 1
            if key_node.tag != _TEXT:
                raise self.refusal(inner, key, "a key that is text (quote it)")
            self._check_line(key, inner, "a key")
            if key in made:
                raise self.refusal(inner, key, "each key once in its mapping")
            made[key] = self._read(value, inner)
        return made

    def _check_line(self, text: str, path: KeyPath, what: str) -> None:
        if self._one_line and _CONTROL.search(text):
            raise self.refusal(path, text, f"{what} of one line")


@cache
def _loader_class() -> type[yaml.SafeLoader]:
    import yaml

    class Loader(yaml.SafeLoader):
        """Loader that gives each alias a node of its own, with the alias's line, instead of the repeated node."""

        def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
            if not self.check_event(yaml.AliasEvent):
                return super().compose_node(parent, index)
            event = self.get_event()  # type: ignore[no-untyped-call]
            return yaml.ScalarNode(_ALIAS, event.anchor, event.start_mark, event.end_mark)

    return Loader


# Rules that a field's type cannot express are written beside the type: ``Annotated[str, Matching(...)]``.


class OrNull:
    """Rule: the file may have null, which becomes None."""

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core.core_schema import none_schema, union_schema

        return union_schema([handler(source)["schema"], none_schema()])


OR_NULL = OrNull()


def named(key: str) -> dict[str, Any]:
    """Return metadata for a dataclass field whose key in the file has another name."""
    return {"alias": key}


@dataclass(frozen=True, slots=True)
class ReadAs:
    """Rule: the file has a value of another type, from which a function makes the field's value."""

    form: Any  #: Type of the value in the file.
    #: Function that makes the value; its `InvalidValueError` gets the place in the file.
    make: Callable[[Any], Any]

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core.core_schema import no_info_after_validator_function

        return no_info_after_validator_function(self.make, handler.generate_schema(self.form))


@dataclass(frozen=True, slots=True)
class Matching:
    """Rule: the whole text matches a regular expression."""

    pattern: re.Pattern[str]  #: Regular expression.
    allowed: str  #: Description of the allowed texts for errors.

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core.core_schema import no_info_after_validator_function

        return no_info_after_validator_function(self._checked, handler(source))

    def _checked(self, text: str) -> str:
        if not self.pattern.fullmatch(text):
            raise InvalidValueError((), text, self.allowed)
        return text

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        return {**handler(core), "pattern": f"^(?:{self.pattern.pattern})$"}


@dataclass(frozen=True, slots=True)
class ByName:
    """Rule: the file has a mapping from one field of some dataclasses to their other fields.

    The annotated type is a mapping, or a tuple of the dataclasses. These are used in no other place of a file.
    """

    field: str  #: Name of the field whose values are the keys.

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core import core_schema

        is_tuple = get_origin(source) is tuple
        member = get_args(source)[0 if is_tuple else 1]
        members = core_schema.dict_schema(core_schema.str_schema(), handler.generate_schema(member))
        named = core_schema.no_info_before_validator_function(self._named, members)
        if not is_tuple:
            return named
        return core_schema.no_info_after_validator_function(
            lambda made: tuple(made.values()), named
        )

    def _named(self, given: Any) -> Any:
        """Return the members with their names; pydantic refuses a value that is no mapping later."""
        if not isinstance(given, dict):
            return given
        members = {}
        for name, values in given.items():
            if not name:
                raise InvalidValueError((), name, "names that are not empty")
            members[name] = values
            if isinstance(values, dict):
                if self.field in values:
                    allowed = f"no key {self.field!r} here, because {name!r} above gives it"
                    raise InvalidValueError((name, self.field), self.field, allowed)
                members[name] = {**values, self.field: name}
        return members

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        shape = handler(core)
        members = handler.resolve_ref_schema(shape["additionalProperties"])
        members["properties"].pop(self.field, None)
        members["required"] = [key for key in members["required"] if key != self.field]
        return shape


@dataclass(frozen=True, slots=True)
class ShortFor:
    """Rule: the file may have a text in place of a mapping with one key."""

    key: str  #: Key that the text is the value of.

    def __get_pydantic_core_schema__(self, source: Any, handler: Any) -> Any:
        from pydantic_core.core_schema import no_info_before_validator_function

        return no_info_before_validator_function(self._whole, handler(source))

    def _whole(self, given: Any) -> Any:
        return {self.key: given} if isinstance(given, str) else given

    def __get_pydantic_json_schema__(self, core: Any, handler: Any) -> Any:
        text = {"type": "string", "minLength": 1}
        said = {"description": f"The same as {{{self.key}: ...}}."}
        return {"anyOf": [handler(core), text | said]}

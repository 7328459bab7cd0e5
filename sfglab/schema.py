"""JSON Schema of the files that people write, made from the dataclasses that read them.

The types, bounds, names and texts by which `sfglab.documents.Section.read` refuses a file say here what an
editor completes and checks. What depends on several keys is the reader's alone.
"""

from __future__ import annotations

import dataclasses
import math
import typing
from collections.abc import Mapping
from typing import Any

from sfglab.documents import Place
from sfglab.fields import (
    BOUNDS,
    Bounds,
    alternatives_of,
    choices_of,
    field_docs,
    to_json,
    typed_fields,
)

DIALECT = "https://json-schema.org/draft/2020-12/schema"

Schema = dict[str, Any]


def schema_of(*classes: type[Any], many: bool = False) -> Schema:
    """Return the JSON Schema (2020-12) of a file with the fields of these dataclasses, or a list of such."""
    maker = SchemaMaker()
    top = maker.mapping(*classes)
    return maker.finished({"type": "array", "items": top} if many else top)


def text_schema(**more: Any) -> Schema:
    """Return the schema of a text, which is never empty."""
    return {"type": "string", "minLength": 1, **more}


class SchemaMaker:
    """Makes the schemas of one file: each class once, under ``$defs``."""

    def __init__(self) -> None:
        self._defs: dict[str, Schema] = {}

    def finished(self, top: Schema) -> Schema:
        """Return a file's schema from that of its topmost value."""
        return {"$schema": DIALECT, **top, "$defs": self._defs}

    def mapping(self, *classes: type[Any], without: str = "") -> Schema:
        """Return the schema of a mapping with the fields of dataclasses, but for one that stands elsewhere."""
        properties: dict[str, Schema] = {}
        required = []
        for cls in classes:
            docs = field_docs(cls)
            for field in typed_fields(typing.cast("Any", cls)).values():
                if field.name == without or _is_elsewhere(field):
                    continue
                key = field.metadata.get("key", field.name)
                properties[key] = self.value(field.type, field.metadata) | _said(field, docs)
                if field.default is field.default_factory:  # both are missing
                    required.append(key)
        return {
            "description": (classes[-1].__doc__ or "").partition("\n\n")[0].replace("\n    ", " "),
            "type": "object",
            "properties": properties,
            "required": required,
            "additionalProperties": False,
        }

    def value(self, hint: Any, extra: Mapping[str, Any]) -> Schema:
        """Return the schema of a value of an annotated type, with its field's metadata."""
        hint = extra.get("like") or hint
        parts = [self._one(option, extra) for option in alternatives_of(hint)]
        if type(None) in typing.get_args(hint) and ("null" in extra or "read" in extra):
            parts.append({"type": "null"})
        return parts[0] if len(parts) == 1 else {"anyOf": parts}

    def _one(self, hint: Any, extra: Mapping[str, Any]) -> Schema:
        origin = typing.get_origin(hint) or hint
        if dataclasses.is_dataclass(hint):
            return self.reference(typing.cast("type[Any]", hint))
        if origin in (dict, Mapping) or "names" in extra:
            return {"type": "object", "additionalProperties": self._member(hint, extra)}
        return (
            self._list(hint, extra) if origin in (tuple, list, frozenset) else _scalar(hint, extra)
        )

    def _member(self, hint: Any, extra: Mapping[str, Any]) -> Schema:
        if "names" not in extra:
            return self.value(typing.get_args(hint)[1], extra)
        cls: Any = next(filter(dataclasses.is_dataclass, typing.get_args(hint)))
        return self.reference(cls, without=extra["names"])

    def _list(self, hint: Any, extra: Mapping[str, Any]) -> Schema:
        each, *more = typing.get_args(hint)
        if each in (int, float):
            count = 1 + len(more)
            return {
                "type": "array",
                "items": {"type": "number"},
                "minItems": count,
                "maxItems": count,
            }
        items = self.value(each, {key: value for key, value in extra.items() if key != "like"})
        if extra.get("short"):
            items = {
                "anyOf": [items, text_schema(description=f"The same as {{{extra['short']}: ...}}.")]
            }
        return {"type": "array", "items": items}

    def reference(self, cls: type[Any], *, without: str = "") -> Schema:
        """Return a reference to the schema of a dataclass's mapping."""
        name = _name(cls) + ("Named" if without else "")
        if name not in self._defs:
            self._defs[name] = {}
            self._defs[name] = self.mapping(cls, without=without)
        return {"$ref": f"#/$defs/{name}"}

    def definition(self, cls: type[Any]) -> Schema:
        """Return the schema that references to a dataclass's mapping mean."""
        return self._defs[_name(cls)]


def _name(cls: type[Any]) -> str:
    return cls.__name__.removeprefix("_").removesuffix("Keys")


def _scalar(hint: Any, extra: Mapping[str, Any]) -> Schema:
    if choices := choices_of(hint):
        return {"enum": list(choices)}
    if hint in (int, float):
        free = Bounds(-math.inf if "read" in extra else 0)
        return {"type": "integer" if hint is int else "number"} | limits(extra.get(BOUNDS, free))
    if hint is bool:
        return {"type": "boolean"}
    pattern, _ = extra.get("matching", (None, ""))
    return text_schema(pattern=f"^(?:{pattern.pattern})$") if pattern else text_schema()


def limits(bounds: Bounds) -> Schema:
    """Return the keywords that say a number's bounds."""
    low = "exclusiveMinimum" if bounds.low in bounds.without else "minimum"
    high = "exclusiveMaximum" if bounds.high in bounds.without else "maximum"
    return {
        word: end for word, end in ((low, bounds.low), (high, bounds.high)) if math.isfinite(end)
    }


def _is_elsewhere(field: dataclasses.Field[Any]) -> bool:
    """Return whether a field does not stand in the file as it is."""
    place = field.type is Place or Place in typing.get_args(field.type)
    return place or not field.init or field.metadata.get("elsewhere", False)


def _said(field: dataclasses.Field[Any], docs: Mapping[str, str]) -> Schema:
    """Return a field's text and default; a default of its own class's making is that class's to say."""
    said: Schema = {"description": docs[field.name]} if docs.get(field.name) else {}
    other_form = {"like", "names"} & field.metadata.keys()
    if field.default is not dataclasses.MISSING and field.default is not None and not other_form:
        plain = to_json(field.default)
        said["default"] = sorted(plain) if isinstance(field.default, frozenset) else plain
    return said


#: Metadata of a field that a file holds in another form.
ELSEWHERE: Mapping[str, Any] = {"elsewhere": True}

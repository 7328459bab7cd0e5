"""Types as pydantic checks them, and the JSON Schema of the files that people write.

Pydantic describes a type by nested mappings. `core_of` adds rules that stand beside no field: numbers,
truth values and texts must be of their own kind, "3" is no number, and no key is unknown. Pydantic
makes validators and JSON Schemas of the same description, so an editor completes and checks what
`sfglab.documents.Document.read` accepts. Only the reader checks conditions between several keys.
"""

from __future__ import annotations

from enum import Enum
from functools import cache
from typing import Any

from sfglab.fields import field_docs

DIALECT = "https://json-schema.org/draft/2020-12/schema"

Core = dict[str, Any]  #: Pydantic's description of a type.
Schema = dict[str, Any]


class Source(Enum):
    """The origin of values, which decides how strictly they are read."""

    FILE = "file"  #: A person, in a file: no text is empty, and null stands for nothing left out.
    VALUES = "values"  #: A person, in a program, a command or a form.
    LOG = "log"  #: Some version of sfglab: unknown keys and bounds do not count.


_EXACT: dict[str, Core] = {
    **{kind: {"strict": True} for kind in ("int", "float", "bool", "str")},
    "dataclass-args": {"extra_behavior": "forbid"},
}
_RULES: dict[Source, dict[str, Core]] = {
    Source.FILE: {
        **_EXACT,
        "float": {"strict": True, "allow_inf_nan": False},
        "str": {"strict": True, "min_length": 1},
    },
    Source.VALUES: _EXACT,
    Source.LOG: {},
}
"""Additions to descriptions, by their ``type``."""
_LIMITS = ("ge", "gt", "le", "lt")


@cache
def core_of(hint: Any, source: Source) -> Core:
    """Return the description of a type for values of a source."""
    from pydantic import TypeAdapter

    core: Core = _ruled(TypeAdapter(hint).core_schema, source)
    return core


def _ruled(core: Any, source: Source) -> Any:
    if isinstance(core, list):
        return [_ruled(one, source) for one in core]
    if not isinstance(core, dict):
        return core
    kind = core.get("type")
    if kind == "nullable" and source is Source.FILE:
        return _ruled(core["schema"], source)
    left_out = _LIMITS if source is Source.LOG else ()
    made = {key: _ruled(value, source) for key, value in core.items() if key not in left_out}
    return made | _RULES[source].get(str(kind), {})


def schema_of(hint: Any) -> Schema:
    """Return the JSON Schema (2020-12) of a file whose values are of a type."""
    return {"$schema": DIALECT, **json_schema(hint, Source.FILE)}


@cache
def json_schema(hint: Any, source: Source) -> Schema:
    """Return the JSON Schema of a type for values of a source."""
    made: Schema = _generator()().generate(core_of(hint, source))
    return made


@cache
def _generator() -> type[Any]:
    from pydantic.json_schema import GenerateJsonSchema

    class Generator(GenerateJsonSchema):
        """Says what a class and its fields are, from their documentation."""

        def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ARG002
            return False

        def dataclass_schema(self, schema: Any) -> Schema:
            made = super().dataclass_schema(schema)
            cls = schema["cls"]
            about = (cls.__doc__ or "").partition("\n\n")[0]
            made["description"] = " ".join(about.split())
            made["additionalProperties"] = False
            del made["title"]  # a name of ours
            for name, text in _docs(cls).items():
                if name in made["properties"]:
                    made["properties"][name]["description"] = text
            return made

        def default_schema(self, schema: Any) -> Schema:
            made = super().default_schema(schema)
            if made.get("default") is None or isinstance(made["default"], dict):
                made.pop("default", None)  # says nothing
            return made

        def tuple_schema(self, schema: Any) -> Schema:
            made = super().tuple_schema(schema)
            if "prefixItems" in made:
                first, *others = made.pop("prefixItems")
                assert all(other == first for other in others), "only tuples of one type are used"
                made["items"] = first
            return made

    return Generator


def _docs(cls: type[Any]) -> dict[str, str]:
    """Return the documentation of a class's fields by their keys in a file."""
    texts = field_docs(getattr(cls, "documented", cls)) | field_docs(cls)
    return {
        cls.__dataclass_fields__[name].metadata.get("alias", name): text
        for name, text in texts.items()
        if name in cls.__dataclass_fields__
    }

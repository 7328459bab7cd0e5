"""JSON Schema of the files that people write, made by pydantic from the dataclasses that read them.

Types, bounds, names and texts by which `sfglab.documents.Document.read` refuses a file say here what an
editor completes and checks. Only the reader checks conditions between several keys.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from sfglab.fields import field_docs
from sfglab.validation import file_reader

DIALECT = "https://json-schema.org/draft/2020-12/schema"

Schema = dict[str, Any]


def schema_of(hint: Any) -> Schema:
    """Return the JSON Schema (2020-12) of a file whose values are of a type."""
    made: Schema = _generator()().generate(file_reader(hint).core)
    return {"$schema": DIALECT, **_plain(made)}


@cache
def _generator() -> type[Any]:
    from pydantic.json_schema import GenerateJsonSchema

    class Generator(GenerateJsonSchema):
        """Says what a class and its fields are, from their documentation, in their order."""

        def sort(self, value: Any, parent_key: str | None = None) -> Any:  # noqa: ARG002
            return value

        def dataclass_schema(self, schema: Any) -> Schema:
            made = super().dataclass_schema(schema)
            cls = schema["cls"]
            about = (cls.__doc__ or "").partition("\n\n")[0]
            made["description"] = " ".join(about.split())
            for name, text in _docs(cls).items():
                if name in made["properties"]:
                    made["properties"][name]["description"] = text
            return made

        def tuple_schema(self, schema: Any) -> Schema:
            made = super().tuple_schema(schema)
            if "prefixItems" in made:  # of one type here
                made["items"] = made.pop("prefixItems")[0]
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


def _plain(schema: Any) -> Any:
    """Return a schema without titles, which only repeat names, and defaults that say nothing."""
    if isinstance(schema, list):
        return [_plain(one) for one in schema]
    if not isinstance(schema, dict):
        return schema
    made = {key: _plain(one) for key, one in schema.items()}
    if isinstance(made.get("title"), str):
        del made["title"]
    if made.get("uniqueItems") and "default" in made:
        made["default"] = sorted(made["default"])  # a set has no order
    is_mapping = made.get("type") == "object"
    if "default" in made and (made["default"] is None or is_mapping):
        del made["default"]
    return made

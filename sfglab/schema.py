"""JSON Schema of the files that people write, so that an editor completes and checks them.

The schema is made from the same description of a type as the validator of `sfglab.validation`, so an editor
accepts all files that `sfglab.documents.Document.read` accepts. Only the reader checks conditions between keys.
"""

from __future__ import annotations

from functools import cache
from typing import Any

from sfglab.fields import field_docs
from sfglab.validation import Source, core_of

DIALECT = "https://json-schema.org/draft/2020-12/schema"

Schema = dict[str, Any]


def schema_of(hint: Any) -> Schema:
    """Return the JSON Schema (2020-12) of a file with the values of a type, such as a dataclass."""
    return {"$schema": DIALECT, **_generator()().generate(core_of(hint, Source.FILE))}


@cache
def _generator() -> type[Any]:
    from pydantic.json_schema import GenerateJsonSchema

    class Generator(GenerateJsonSchema):
        """Generator that uses the documentation of classes and fields as descriptions."""

        def field_title_should_be_set(self, schema: Any) -> bool:  # noqa: ARG002
            return False

        def dataclass_schema(self, schema: Any) -> Schema:
            made = super().dataclass_schema(schema)
            cls = schema["cls"]
            about = (cls.__doc__ or "").partition("\n\n")[0]
            made["description"] = " ".join(about.split())
            made["additionalProperties"] = False
            del made["title"]  # a Python name has no meaning in a file
            for name, text in _docs(cls).items():
                if name in made["properties"]:
                    made["properties"][name]["description"] = text
            return made

        def default_schema(self, schema: Any) -> Schema:
            made = super().default_schema(schema)
            if made.get("default") is None or isinstance(made["default"], dict):
                made.pop("default", None)  # such a default gives no information
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
    texts = {}
    for name, text in field_docs(cls).items():
        if name in cls.__dataclass_fields__:
            texts[cls.__dataclass_fields__[name].metadata.get("alias", name)] = text
    return texts

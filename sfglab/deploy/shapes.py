"""Foreign files: JSON5 with the lines of its values, shapes by JSON Schema, and the translator of its messages.

Of what JSON5 adds to JSON, comments, trailing commas, single quotes and keys without quotes are taken. A shape
is a file of the folder ``schemas`` (JSON Schema 2020-12 as YAML), which may also hold ``x-allowed``, words for
what is allowed; ``x-finding``, parts of the finding in place of the general ones, whose texts may name
``{given}``, ``{cause}`` and keys around the value; and at its top ``x-why``: what follows, by code.
"""

from __future__ import annotations

import ipaddress
import json
import re
from collections import defaultdict
from functools import cache
from importlib import import_module, resources
from typing import TYPE_CHECKING, Any, Protocol

from sfglab.deploy.errors import MissingProgramError
from sfglab.documents import Document, Place
from sfglab.fleet.lint import Finding, Severity
from sfglab.validation import suggestion

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sfglab.errors import KeyPath

_TYPES = {
    "array": "a list",
    "boolean": "true or false",
    "integer": "a whole number",
    "number": "a number",
    "object": "a mapping",
    "string": "a text",
}


class Readable(Protocol):
    """A file's values, and where each stands; a `Document` is one."""

    value: Any

    def place(self, path: KeyPath) -> Place:
        """Return where a value stands; of what is missing, where its nearest holder does."""


def check_shape(document: Readable, shape: str) -> tuple[Finding, ...]:
    """Return where a document has not a shape of ``schemas``, by line; or raise `MissingProgramError`."""
    validator = _validator(shape)
    errors = validator.iter_errors(document.value)
    found = (
        _finding(document, error, validator.schema, *one)
        for error in errors
        for one in _faults(error)
    )
    # The library goes through some of a schema's keys in the order of a set.
    return tuple(
        sorted(dict.fromkeys(found), key=lambda finding: (finding.place.line or 0, finding.what))
    )


@cache
def _validator(shape: str) -> Any:
    import yaml

    try:
        jsonschema: Any = import_module("jsonschema")
    except ImportError as error:
        raise MissingProgramError("jsonschema") from error
    text = (
        resources.files(__package__)
        .joinpath("schemas", f"{shape}.yaml")
        .read_text(encoding="utf-8")
    )
    standard = jsonschema.Draft202012Validator
    # To the standard 1.0 is an integer; readers of these files refuse it.
    types = standard.TYPE_CHECKER.redefine("integer", lambda _, value: type(value) is int)
    formats = jsonschema.FormatChecker()
    formats.checks("ip", raises=ValueError)(lambda value: bool(ipaddress.ip_address(value)) or True)
    return jsonschema.validators.extend(standard, type_checker=types)(
        yaml.safe_load(text), format_checker=formats
    )


def _finding(
    document: Readable, error: Any, schema: Any, inner: KeyPath, parts: dict[str, str]
) -> Finding:
    path = (*error.absolute_path, *inner)
    own = dict(error.schema.get("x-finding", {})) if isinstance(error.schema, dict) else {}
    texts = _around(document.value, path) | {"given": error.instance, "cause": error.cause}
    parts = parts | {key: str(text).format_map(texts) for key, text in own.items()}
    code = parts.get("code", "schema")
    return Finding(
        severity=Severity(parts.get("severity", "error")),
        code=code,
        place=document.place(path),
        what=parts["what"],
        why=parts.get("why") or schema["x-why"].get(code) or schema["x-why"]["schema"],
        remedy=parts.get("remedy", ""),
    )


def _around(value: Any, path: KeyPath) -> dict[str, Any]:
    """Return the innermost mapping on the way to a place, for texts that name its keys."""
    found: dict[str, Any] = {}
    for key in (*path, None):
        found = value if isinstance(value, dict) else found
        try:
            value = value[key]
        except (KeyError, IndexError, TypeError):
            break
    return defaultdict(lambda: None, found)


def _faults(error: Any) -> Iterator[tuple[KeyPath, dict[str, str]]]:
    """Yield what an error says: where below its own place, and the parts of its finding."""
    given, asked = error.instance, error.validator_value
    match error.validator:
        case "additionalProperties":
            known = tuple(error.schema["properties"])
            for key in given:
                if key not in known:
                    yield (key,), _unknown(key, known)
        case "required":
            for key in asked:
                if key not in given:
                    yield (key,), _missing(key)
        case "anyOf":
            yield (
                (),
                _missing(
                    " or ".join(branch["required"][0] for branch in asked if "required" in branch)
                ),
            )
        case "dependentRequired":
            yield (), {"what": _torn(error, [key for key in asked if key in given])}
        case "uniqueItems":
            twice = [(n, item) for n, item in enumerate(given) if item in given[:n]]
            yield from (((n,), {"what": f"{item} stands there twice"}) for n, item in twice)
        case _:
            # The schema of a key's name does not say in its path which key it is.
            inner = (given,) if "propertyNames" in error.absolute_schema_path else ()
            yield inner, {"what": f"given {given!r}, allowed: {_allowed(error)}"}


def _unknown(key: str, known: tuple[str, ...]) -> dict[str, str]:
    what = f"unknown key {key!r}{suggestion(key, known)}"
    return {"code": "unknown-key", "what": what, "remedy": f"allowed here: {', '.join(known)}"}


def _missing(key: str) -> dict[str, str]:
    return {"code": "missing-key", "what": f"{key} is missing", "remedy": f"add {key}"}


def _torn(error: Any, given: list[str]) -> str:
    missing = [key for key in error.validator_value if key not in given]
    return f"{error.absolute_path[-1]} has {', '.join(given)} without {', '.join(missing)}"


def _allowed(error: Any) -> str:
    """Return words for what is allowed in the place of a value."""
    schema = error.schema if isinstance(error.schema, dict) else {}
    given, asked = error.instance, error.validator_value
    words = schema.get("x-allowed", asked if error.validator == "enum" else None)
    if isinstance(words, list):
        return ", ".join(map(str, words)) + suggestion(given, words)
    return str(words) if words else _WORDS.get(error.validator, _by_message)(error, schema, asked)


def _type(_error: Any, schema: Any, asked: Any) -> str:
    names = " or ".join(_TYPES[name] for name in ([asked] if isinstance(asked, str) else asked))
    keys = ", ".join(schema.get("properties", ()))
    return f"{names} with {keys}" if keys and asked == "object" else names


def _range(_error: Any, schema: Any, asked: Any) -> str:
    if "maximum" in schema:
        return f"{schema['minimum']} to {schema['maximum']}"
    return f"{asked} or more" if schema.get("type") == "integer" else f"at least {asked:g}"


def _by_message(error: Any, _schema: Any, _asked: Any) -> str:
    return f"what fits the schema ({error.message})"


_WORDS: dict[str, Callable[[Any, Any, Any], str]] = {
    "type": _type,
    "minimum": _range,
    "maximum": _range,
    "exclusiveMinimum": lambda _error, _schema, asked: f"above {asked:g}",
    "minItems": lambda _error, _schema, asked: f"a list of at least {asked}",
    "const": lambda _error, _schema, asked: repr(asked),
}
"""What is allowed, by the keyword that is not fulfilled."""


# Every token takes all that belongs to it and gives nothing back (possessive), closed or not, so that no text
# is read twice: time is linear.
_TRIVIA = r"//[^\n]*+|/\*(?:[^*]|\*(?!/))*+(?:\*/|\Z)"
_TOKEN = re.compile(
    rf"""
      (?P<string>"(?:\\.|[^"\\\n])*+(?:"|(?=\n)|\\?\Z)|'(?:\\.|[^'\\\n])*+(?:'|(?=\n)|\\?\Z))
    | (?P<comment>{_TRIVIA})
    | (?P<comma>,(?=(?:\s|{_TRIVIA})*+[}}\]]))
    | (?P<colon>:)
    | (?P<tab>\t)
    | (?P<word>[A-Za-z_$][\w$]*+)
    | (?P<number>-?\d++(?:\.\d*+)?(?:[eE][+-]?\d++)?)
    """,
    re.VERBOSE | re.DOTALL,
)


def read_json5(text: str, file: str) -> Document:
    """Read a JSON5 file's text; a `DocumentError` says where it is none, or has more than is taken here."""
    return Document(_TOKEN.sub(_as_yaml, text), file)


def _as_yaml(token: re.Match[str]) -> str:
    """Return what stands for a token in YAML, with as many lines."""
    found = token.group()
    match token.lastgroup:
        case "string":
            return _string(found)
        case "colon":
            return ": "
        case "word":
            return found
        case "number":  # of a power, YAML 1.1 asks for a dot and a sign
            return repr(float(found)) if "e" in found.lower() else found
        case _:
            return "\n" * found.count("\n") + " "


def _string(found: str) -> str:
    """Return a string of YAML; a pair of surrogates, which YAML does not know, becomes one character."""
    inner = found[1:-1]
    if len(found) == 1 or found[-1] != found[0]:
        return found  # never closed, as YAML will say
    if found[0] == "'":
        inner = inner.replace("\\'", "'").replace('"', '\\"')
    try:
        value = json.loads(f'"{inner}"')
    except json.JSONDecodeError:
        return f'"{inner}"'  # an escape that JSON does not have; YAML may
    plain = (c if " " <= c <= "~" and c not in '"\\' else f"\\U{ord(c):08x}" for c in value)
    return f'"{"".join(plain)}"'

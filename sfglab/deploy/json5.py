"""JSON5 as routers and editors write it, read with the lines of its values, which the library lacks.

Comments, trailing commas, single quotes and keys without quotes are taken; they are most of what JSON5 adds to
JSON. Hexadecimal numbers, ``Infinity`` and line continuations are not. The text becomes flow-style YAML of the
same lines, so that places are those of the file.
"""

from __future__ import annotations

import json
import re

from sfglab.documents import Document

_TOKEN = re.compile(
    r"""
      (?P<string>"(?:\\.|[^"\\\n])*"|'(?:\\.|[^'\\\n])*')
    | (?P<comment>//[^\n]*|/\*.*?\*/)
    | (?P<comma>,(?=(?:\s|//[^\n]*|/\*.*?\*/)*[}\]]))
    | (?P<colon>:)
    | (?P<tab>\t)
    | (?P<word>[A-Za-z_$][\w$]*)
    | (?P<power>-?\d+(?:\.\d*)?[eE][+-]?\d+)
    """,
    re.VERBOSE | re.DOTALL,
)


def read_json5(text: str, file: str) -> Document:
    """Read the text of a JSON5 file; `file` is its name, for places.

    Raises:
        DocumentError: It is not JSON5, or has more of it than is taken here.
    """
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
        case "power":
            return repr(float(found))  # YAML 1.1 asks for a dot and a sign
        case _:
            return "\n" * found.count("\n") + " "


def _string(found: str) -> str:
    """Return a string of YAML; a pair of surrogates, which YAML does not know, becomes one character."""
    inner = found[1:-1]
    if found[0] == "'":
        inner = inner.replace("\\'", "'").replace('"', '\\"')
    try:
        value = json.loads(f'"{inner}"')
    except json.JSONDecodeError:
        return f'"{inner}"'  # an escape that JSON does not have; YAML may
    plain = (c if " " <= c <= "~" and c not in '"\\' else f"\\U{ord(c):08x}" for c in value)
    return f'"{"".join(plain)}"'

"""What looks like a secret in a file: keys, tokens, passwords. Says where and of what kind, never the secret.

Knows shapes that providers document, and names followed by a value; refuses to guess from randomness alone, so
that digests of lock files and of images pass.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from sfglab.deploy.checking.verdicts import Verdict, verdict_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from sfglab.deploy.files import BundleFile


SECRET_NAME = re.compile(
    r"(?:^|_)(?:password|passwd|passphrase|secret|token|credentials?|(?:api|access|private|auth|secret)?_?key)s?$",
    re.IGNORECASE,
)
"""Names of variables that hold secrets."""

_SHAPES = {
    "a private key": r"-----BEGIN (?:[A-Z0-9]+ )*PRIVATE KEY",
    "an access key of AWS": r"\b(?:AKIA|ASIA)[0-9A-Z]{16}\b",
    "a token of GitHub": r"\b(?:gh[opusr]_[A-Za-z0-9]{36}|github_pat_[A-Za-z0-9_]{22})",
    "a token of GitLab": r"\bglpat-[A-Za-z0-9_-]{20}",
    "a token of Docker Hub": r"\bdckr_pat_[A-Za-z0-9_-]{20}",
    "a token of NVIDIA's registry": r"\bnvapi-[A-Za-z0-9_-]{40}",
    "a token of Slack": r"\bxox[abeoprs]-[A-Za-z0-9-]{10}",
    "a key of Google's": r"\bAIza[0-9A-Za-z_-]{35}",
    "a signed token (JWT)": r"\beyJ[A-Za-z0-9_-]{10,}\.eyJ[A-Za-z0-9_-]{10,}\.",
    "a password in an address": r"\b[a-z][a-z0-9+.-]*://[^\s/:@'\"${}]+:[^\s/@'\"${}]+@",
}
_KNOWN = {kind: re.compile(shape) for kind, shape in _SHAPES.items()}
_ASSIGNED = re.compile(
    r"""(?P<name>[A-Za-z_][\w-]*)["']?\s*(?:=|:(?=\s))\s*["']?(?P<value>[^\s"'#,;]{6,})""",
)
_NO_SECRET = re.compile(
    r"[=$<%*/~.{\[(]|.*[({]|(?:true|false|null|none)$|sha(?:256|384|512)[:-]", re.IGNORECASE
)
"""How values begin that are none: a variable, a path, a placeholder, a call, a comparison, a digest."""


def check_secrets(files: Mapping[str, BundleFile]) -> tuple[Verdict, ...]:
    """Return one verdict about each file.

    Args:
        files: The agent's folder.
    """
    return tuple(verdict_of("no secrets", name, leaks, file.text) for name, file in files.items())


def leaks(text: str) -> Iterator[str]:
    """Yield where a text holds what looks like a secret."""
    for number, line in enumerate(text.splitlines(), start=1):
        kinds = [kind for kind, shape in _KNOWN.items() if shape.search(line)]
        if not kinds:
            kinds = [f"a value for {match['name']}" for match in _ASSIGNED.finditer(line) if _is_secret(match)]
        yield from (f"line {number}: it looks like {kind}" for kind in kinds)


def _is_secret(match: re.Match[str]) -> bool:
    name = match["name"].replace("-", "_")
    return bool(SECRET_NAME.search(name)) and not _NO_SECRET.match(match["value"])

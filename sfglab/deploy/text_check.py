"""Linters of single texts: secrets by our own patterns, Dockerfiles by hadolint, scripts by ShellCheck."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from functools import cache, partial
from typing import TYPE_CHECKING

from sfglab.deploy.programs import answer_of, find_program
from sfglab.deploy.verdicts import State, Verdict, verdict_of

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
    r"""(?P<name>[A-Za-z_][\w-]*)["']?\s*(?:=|:(?=\s))\s*["']?(?P<value>[^\s"'#,;]{6,})"""
)
_NO_SECRET = re.compile(
    r"[=$<%*/~.{\[(]|.*[({]|(?:true|false|null|none)$|sha(?:256|384|512)[:-]", re.IGNORECASE
)
"""How values begin that are none: a variable, a path, a placeholder, a call, a comparison, a digest."""


def check_secrets(files: Mapping[str, BundleFile]) -> tuple[Verdict, ...]:
    """Return one verdict about each file."""
    return tuple(verdict_of("no secrets", name, leaks, file.text) for name, file in files.items())


def leaks(text: str) -> Iterator[str]:
    """Yield where a text holds what looks like a secret."""
    for number, line in enumerate(text.splitlines(), start=1):
        kinds = [kind for kind, shape in _KNOWN.items() if shape.search(line)]
        if not kinds:
            kinds = [
                f"a value for {match['name']}"
                for match in _ASSIGNED.finditer(line)
                if _is_secret(match)
            ]
        yield from (f"line {number}: it looks like {kind}" for kind in kinds)


def _is_secret(match: re.Match[str]) -> bool:
    name = match["name"].replace("-", "_")
    return bool(SECRET_NAME.search(name)) and not _NO_SECRET.match(match["value"])


HADOLINT = "hadolint"
NAME = "Dockerfile"


def check_dockerfiles(files: Mapping[str, BundleFile]) -> tuple[Verdict, ...]:
    """Return hadolint's verdict about each Dockerfile of a folder, whose comments say what is on purpose."""
    recipes = [name for name in files if name.rpartition("/")[2].startswith(NAME)]
    if not recipes:
        return (
            Verdict(check=HADOLINT, subject=NAME, state=State.FAILS, says="there is no Dockerfile"),
        )
    return tuple(verdict_of(HADOLINT, name, _hadolint, files[name].text) for name in recipes)


def _hadolint(text: str) -> Iterator[str]:
    program = find_program(HADOLINT)
    output = answer_of((program, "--no-color", "--format", "json", NAME), ((NAME, text),))
    for finding in json.loads(output):
        message = " ".join(finding["message"].split())
        yield f"line {finding['line']}: {message} ({finding['code']})"


SHELLCHECK = "shellcheck"
STARTS = "programs can be started"


def check_shell(files: Mapping[str, BundleFile]) -> tuple[Verdict, ...]:
    """Return two verdicts about each script of a folder: by ShellCheck, and on its permissions.

    A script has the suffix ``.sh``, or a first line that names a shell. Scripts may read each other.
    """
    scripts = {
        name: file for name, file in files.items() if name.endswith(".sh") or _shebang(file.text)
    }
    if not scripts:
        says = "there is no shell script among the files"
        return (Verdict(check=SHELLCHECK, subject="*.sh", state=State.SKIPPED, says=says),)
    comments = cache(partial(_shellcheck, {name: file.text for name, file in scripts.items()}))
    linted = [verdict_of(SHELLCHECK, name, lambda name=name: comments()[name]) for name in scripts]
    return (
        *linted,
        *(verdict_of(STARTS, name, _startable, file) for name, file in scripts.items()),
    )


def _shebang(text: str) -> bool:
    first = text.partition("\n")[0]
    return first.startswith("#!") and first.split()[-1].rpartition("/")[2] in {"sh", "bash", "dash"}


def _startable(file: BundleFile) -> Iterator[str]:
    if _shebang(file.text) and file.mode & 0o111 != 0o111:
        yield f"its first line says it is a program, but its mode is {file.mode:o}: allowed is 755"
    if "\r" in file.text:
        yield "lines end with CR LF, which no shell on Linux takes: allowed is LF"


def _shellcheck(texts: Mapping[str, str]) -> dict[str, list[str]]:
    """Return ShellCheck's comments by file; its own formats' name for them is ``json1``."""
    program = find_program(SHELLCHECK)
    options = ("--norc", "--format=json1", "--external-sources", "--source-path=SCRIPTDIR")
    output = answer_of((program, *options, "--", *texts), tuple(texts.items()))
    found: dict[str, list[str]] = defaultdict(list)
    for comment in json.loads(output)["comments"]:
        words = f"line {comment['line']}: {comment['message']} (SC{comment['code']})"
        if words not in found[comment["file"]]:  # a file that others read is seen more than once
            found[comment["file"]].append(words)
    return found

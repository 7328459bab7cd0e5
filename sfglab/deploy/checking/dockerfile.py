"""Recipes of images: hadolint's findings. Our own rules for them stand beside what renders them."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING

from sfglab.deploy.checking.programs import answer_of, find_program
from sfglab.deploy.checking.verdicts import State, Verdict, verdict_of

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from sfglab.deploy.files import BundleFile


LINTER = "hadolint"
NAME = "Dockerfile"


def check_dockerfiles(files: Mapping[str, BundleFile]) -> tuple[Verdict, ...]:
    """Return hadolint's verdict about each Dockerfile of a folder.

    What a recipe does against a rule on purpose, it says by hadolint's own comment with the reason beside it.

    Args:
        files: The agent's folder.
    """
    recipes = [name for name in files if name.rpartition("/")[2].startswith(NAME)]
    if not recipes:
        return (Verdict(check=LINTER, subject=NAME, state=State.FAILS, says="there is no Dockerfile"),)
    return tuple(verdict_of(LINTER, name, _hadolint, files[name].text) for name in recipes)


def _hadolint(text: str) -> Iterator[str]:
    program = find_program(LINTER)
    output = answer_of((program, "--no-color", "--format", "json", NAME), ((NAME, text),))
    for finding in json.loads(output):
        message = " ".join(finding["message"].split())
        yield f"line {finding['line']}: {message} ({finding['code']})"

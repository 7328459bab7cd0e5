"""What is wrong with a Dockerfile by our own rules, beside those of a linter.

The rules: three layers by name and in order; everything pinned; nothing runs as root; no secrets; nothing
fetched that is not compared with a digest, and no script run as it comes from the network.
"""

from __future__ import annotations

import re
from itertools import pairwise
from typing import TYPE_CHECKING

from sfglab.deploy.errors import DeployError
from sfglab.deploy.images.dockerfile import STAGES
from sfglab.deploy.images.dockerfile_parts import Instruction, Stage, parse_dockerfile, stages_of
from sfglab.documents import Place
from sfglab.fleet.border import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Iterator


_SECRET = re.compile(
    r"(?:^|_)(?:PASSWORD|PASSWD|TOKEN|SECRET|CREDENTIALS?|(?:API|PRIVATE|ACCESS)?_?KEY)(?:_|$)", re.IGNORECASE
)
_ASSIGNMENT = re.compile(r"(\w+)=(\"(?:[^\"\\]|\\.)*\"|'[^']*'|\S*)")
_VARIABLE = re.compile(r"\$\{?(\w+)(?::?-([^}]*))?\}?")
_PIPED_SCRIPT = re.compile(r"\b(?:curl|wget)\b[^;&]*\|\s*(?:sudo\s+)?(?:env\s+)?(?:/\S*/)?(?:ba|da|z)?sh\b")
_REMOTE = re.compile(r"\b(?:https?|ftp|git)://")
_ROOT = frozenset({"", "0", "root"})


def check_dockerfile(text: str, file: str = "Dockerfile") -> tuple[Finding, ...]:
    """Return what is wrong with a Dockerfile, in the order of its lines.

    Args:
        text: The Dockerfile.
        file: Its name, for people.
    """
    try:
        instructions = parse_dockerfile(text)
        stages = stages_of(instructions)
    except DeployError as error:
        return (_finding(_at(file, 0), "dockerfile-syntax", str(error), "no builder can read it"),)
    findings = [
        *_check_pins(file, instructions, stages),
        *_check_layers(file, stages),
        *_check_users(file, stages),
        *(finding for each in instructions for finding in _check_instruction(file, each)),
    ]
    return tuple(sorted(findings, key=lambda finding: finding.place.line))


def _check_pins(
    file: str, instructions: tuple[Instruction, ...], stages: tuple[Stage, ...]
) -> Iterator[Finding]:
    if not stages:
        yield _finding(_at(file, 0), "no-stage", "no FROM", "there is nothing to build from")
        return
    defaults = _defaults(instructions)
    known: set[str] = set()
    for stage in stages:
        image = _VARIABLE.sub(lambda match: defaults.get(match[1]) or match[2] or "", stage.image)
        if image not in known and image != "scratch" and not _is_pinned(image):
            what = f"FROM {stage.image}: given {image!r}, allowed: a tag other than latest, or a digest"
            why = "the same text builds another image tomorrow"
            yield _finding(_at(file, stage.line), "unpinned-image", what, why, "name a version")
        known.add(stage.name)


def _defaults(instructions: tuple[Instruction, ...]) -> dict[str, str]:
    """Return the defaults of the arguments before the first FROM, the only ones that a FROM sees."""
    defaults = {}
    for each in instructions:
        if each.name == "FROM":
            break
        if each.name == "ARG":
            defaults.update({name: value.strip("\"'") for name, value in _ASSIGNMENT.findall(each.value)})
    return defaults


def _is_pinned(image: str) -> bool:
    name, _, digest = image.partition("@")
    if digest:
        return re.fullmatch(r"sha256:[0-9a-f]{64}", digest) is not None
    tag = name.rsplit("/", 1)[-1].partition(":")[2]
    return tag not in {"", "latest"}


def _check_layers(file: str, stages: tuple[Stage, ...]) -> Iterator[Finding]:
    names = [stage.name for stage in stages]
    if [name for name in names if name in STAGES] != list(STAGES):
        what = f"stages: given {', '.join(name or '(no name)' for name in names)}, allowed: {', '.join(STAGES)}"
        why = "the three layers are what agents share (paper A, section 4.4, Fig. 5)"
        yield _finding(_at(file, stages[0].line if stages else 0), "layers", what, why)
        return
    origins = {stage.name: stage for stage in stages}
    for below, above in pairwise(STAGES):
        if origins[above].image != below:
            what = f"stage {above}: given FROM {origins[above].image}, allowed: FROM {below}"
            yield _finding(_at(file, origins[above].line), "layers", what, "a layer stands on the one below it")


def _check_users(file: str, stages: tuple[Stage, ...]) -> Iterator[Finding]:
    """The last stage is what a builder makes when nobody says which; the application is what robots run."""
    origins = {stage.name: stage for stage in stages if stage.name}
    for stage in dict.fromkeys((*stages[-1:], *(s for s in stages if s.name == STAGES[-1]))):
        user = _user(stage, origins)
        if user.partition(":")[0] in _ROOT:
            given = f"given {user or 'nothing'!r}, allowed: not root"
            what = f"stage {stage.name or stages.index(stage)}: USER: {given}"
            why = "what breaks out of a container of root is root outside"
            yield _finding(
                _at(file, stage.line), "runs-as-root", what, why, "end the stage with USER 10001:10001"
            )


def _user(stage: Stage, origins: dict[str, Stage]) -> str:
    users = [each.value for each in stage.instructions if each.name == "USER"]
    if users:
        return users[-1]
    below = origins.get(stage.image)
    return "" if below is None or below is stage else _user(below, origins)


def _check_instruction(file: str, each: Instruction) -> Iterator[Finding]:
    if each.name in {"ARG", "ENV"}:
        yield from _check_secrets(file, each)
    if each.name == "ADD" and _REMOTE.search(each.value) and "--checksum=" not in each.value:
        what = f"ADD {each.value}: from the network without a digest"
        yield _finding(
            _at(file, each.line), "unchecked-download", what, "nobody knows what it will be", "add --checksum"
        )
    if each.name == "RUN" and _PIPED_SCRIPT.search(each.value):
        why = "it runs as root and is never the same twice for certain"
        yield _finding(_at(file, each.line), "piped-script", "RUN: a download is piped into a shell", why)
    if each.name in {"ADD", "COPY"} and _copies_everything(each.value):
        what = f"{each.name} {each.value}: the whole folder"
        why = "whatever lies there gets into the image, secrets too"
        yield _finding(_at(file, each.line), "copies-everything", what, why, "name what is needed")


def _check_secrets(file: str, each: Instruction) -> Iterator[Finding]:
    for name, value in _assignments(each):
        if _SECRET.search(name) and value.strip("\"'"):
            what = f"{each.name} {name}: a secret with a value"
            why = "it stands in the image's history for all who have the image"
            yield _finding(_at(file, each.line), "secret", what, why, "use RUN --mount=type=secret")


def _assignments(each: Instruction) -> list[tuple[str, str]]:
    if each.name == "ENV" and "=" not in each.value.split(maxsplit=1)[0]:
        name, _, value = each.value.partition(" ")  # the old form, ENV NAME value
        return [(name, value)]
    return _ASSIGNMENT.findall(each.value)


def _copies_everything(value: str) -> bool:
    words = [word for word in value.split() if not word.startswith("--")]
    return not value.startswith("--from=") and any(word in {".", "./", "/"} for word in words[:-1])


def _at(file: str, line: int) -> Place:
    return Place(file=file, line=line)


def _finding(place: Place, code: str, what: str, why: str, remedy: str = "") -> Finding:
    return Finding(severity=Severity.ERROR, code=code, place=place, what=what, why=why, remedy=remedy)

"""Faults of a Dockerfile by our own rules, beside those of a linter."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

from sfglab.deploy.dockerfile import STAGES
from sfglab.deploy.errors import DeployError
from sfglab.documents import Place
from sfglab.fleet.lint import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Iterator


INSTRUCTIONS = (
    *("ADD", "ARG", "CMD", "COPY", "ENTRYPOINT", "ENV", "EXPOSE", "FROM", "HEALTHCHECK", "LABEL", "ONBUILD"),
    *("RUN", "SHELL", "STOPSIGNAL", "USER", "VOLUME", "WORKDIR"),
)
"""All but MAINTAINER, which is gone (Dockerfile reference)."""

_HERE_DOCUMENT = re.compile(r"<<-?[\"']?(\w+)[\"']?")
_FROM = re.compile(r"(?:--platform=\S+\s+)?(?P<image>\S+)(?:\s+[Aa][Ss]\s+(?P<name>\S+))?")


@dataclass(frozen=True, slots=True, kw_only=True)
class Instruction:
    """One instruction."""

    name: str  #: In capitals, as in ``RUN``.
    value: str  #: What follows it, continued lines joined and comments between them left out.
    line: int  #: Where it starts, from 1.


@dataclass(frozen=True, slots=True, kw_only=True)
class Stage:
    """From one FROM to the next."""

    name: str  #: What it is called; empty without a name.
    image: str  #: What it starts from, as it is written.
    line: int  #: Where it starts.
    instructions: tuple[Instruction, ...]  #: What follows its FROM.


def parse_dockerfile(text: str) -> tuple[Instruction, ...]:
    """Return the instructions of a Dockerfile.

    Raises:
        DeployError: A line is no instruction, or a here-document does not end.
    """
    lines = text.splitlines()
    instructions: list[Instruction] = []
    at = 0
    while at < len(lines):
        start, at = at, at + 1
        if _is_nothing(lines[start]):
            continue
        value, at = _joined(lines, start)
        value, at = _with_documents(lines, value, at)
        instructions.append(_instruction(value, start + 1))
    return tuple(instructions)


def stages_of(instructions: tuple[Instruction, ...]) -> tuple[Stage, ...]:
    """Return the stages; what stands before the first FROM belongs to none.

    Raises:
        DeployError: A FROM names no image.
    """
    starts = [number for number, each in enumerate(instructions) if each.name == "FROM"]
    stages = []
    for start, end in pairwise((*starts, len(instructions))):
        head = instructions[start]
        match = _FROM.fullmatch(head.value)
        if match is None:
            raise DeployError(f"line {head.line}: FROM: given {head.value!r}, allowed: image AS name")
        stages.append(
            Stage(
                name=match["name"] or "",
                image=match["image"],
                line=head.line,
                instructions=instructions[start + 1 : end],
            )
        )
    return tuple(stages)


def _is_nothing(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith("#")


def _joined(lines: list[str], start: int) -> tuple[str, int]:
    """Return a line with those that continue it, and the number of the next."""
    parts, at = [lines[start].strip()], start + 1
    while parts[-1].endswith("\\") and at < len(lines):
        if not _is_nothing(lines[at]):
            parts[-1] = parts[-1][:-1].rstrip()
            parts.append(lines[at].strip())
        at += 1
    return " ".join(parts), at


def _with_documents(lines: list[str], value: str, at: int) -> tuple[str, int]:
    if value.split(maxsplit=1)[0].upper() not in {"RUN", "COPY", "ADD"}:
        return value, at
    for end in _HERE_DOCUMENT.findall(value):
        document: list[str] = []
        while at < len(lines) and lines[at].strip() != end:
            document.append(lines[at])
            at += 1
        if at == len(lines):
            raise DeployError(
                f"line {at}: given the end of the file, allowed: {end}, which ends a here-document"
            )
        value, at = "\n".join((value, *document)), at + 1
    return value, at


def _instruction(text: str, line: int) -> Instruction:
    name, _, value = text.partition(" ")
    if name.upper() not in INSTRUCTIONS:
        known = ", ".join(INSTRUCTIONS)
        raise DeployError(f"line {line}: given {name!r}, allowed: an instruction ({known})")
    if not value.strip():
        raise DeployError(f"line {line}: {name.upper()}: given nothing, allowed: its arguments")
    return Instruction(name=name.upper(), value=value.strip(), line=line)


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

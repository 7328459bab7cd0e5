"""A Dockerfile as instructions and stages: just enough of the format to judge one.

Knows comments, continued lines and here-documents (Dockerfile reference, "Format"); refuses to know what an
instruction does.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise

from sfglab.deploy.errors import DeployError

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

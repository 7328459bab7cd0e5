"""Faults of a Dockerfile by our own rules, beside those of a linter."""

from __future__ import annotations

import re
from dataclasses import dataclass
from itertools import pairwise, takewhile
from typing import TYPE_CHECKING

from sfglab.deploy.dockerfile import STAGES
from sfglab.deploy.errors import DeployError
from sfglab.deploy.verdicts import Broken, Rules
from sfglab.documents import Place
from sfglab.fleet.lint.report import Finding, an_error

if TYPE_CHECKING:
    from collections.abc import Iterator

INSTRUCTIONS = (
    *(
        "ADD",
        "ARG",
        "CMD",
        "COPY",
        "ENTRYPOINT",
        "ENV",
        "EXPOSE",
        "FROM",
        "HEALTHCHECK",
        "LABEL",
        "ONBUILD",
    ),
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
    """Return a Dockerfile's instructions; a `DeployError` says which line is none, or what is not ended."""
    lines = text.splitlines()
    rest = enumerate(lines, start=1)
    instructions = []
    for number, line in rest:
        if _is_nothing(line):
            continue
        parts = [line.strip()]
        while parts[-1].endswith("\\") and (
            more := next((m for _, m in rest if not _is_nothing(m)), None)
        ):
            parts = [*parts[:-1], parts[-1][:-1].rstrip(), more.strip()]
        value = " ".join(parts)
        takes_documents = value.split(maxsplit=1)[0].upper() in {"RUN", "COPY", "ADD"}
        for end in _HERE_DOCUMENT.findall(value) if takes_documents else ():
            for _, inner in rest:
                if inner.strip() == end:
                    break
                value += f"\n{inner}"
            else:
                raise DeployError(
                    f"line {len(lines)}: given the end of the file, allowed: {end}, which ends a here-document"
                )
        instructions.append(_instruction(value, number))
    return tuple(instructions)


def stages_of(instructions: tuple[Instruction, ...]) -> tuple[Stage, ...]:
    """Return the stages, from the first FROM on; a `DeployError` says which FROM names no image."""
    starts = [number for number, each in enumerate(instructions) if each.name == "FROM"]
    stages = []
    for start, end in pairwise((*starts, len(instructions))):
        head = instructions[start]
        match = _FROM.fullmatch(head.value)
        if match is None:
            raise DeployError(
                f"line {head.line}: FROM: given {head.value!r}, allowed: image AS name"
            )
        name, inner = match["name"] or "", instructions[start + 1 : end]
        stages.append(Stage(name=name, image=match["image"], line=head.line, instructions=inner))
    return tuple(stages)


def _is_nothing(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith("#")


def _instruction(text: str, line: int) -> Instruction:
    name, _, value = text.partition(" ")
    if name.upper() not in INSTRUCTIONS:
        known = ", ".join(INSTRUCTIONS)
        raise DeployError(f"line {line}: given {name!r}, allowed: an instruction ({known})")
    if not value.strip():
        raise DeployError(f"line {line}: {name.upper()}: given nothing, allowed: its arguments")
    return Instruction(name=name.upper(), value=value.strip(), line=line)


_SECRET = re.compile(
    r"(?:^|_)(?:PASSWORD|PASSWD|TOKEN|SECRET|CREDENTIALS?|(?:API|PRIVATE|ACCESS)?_?KEY)(?:_|$)",
    re.IGNORECASE,
)
_ASSIGNMENT = re.compile(r"(\w+)=(\"(?:[^\"\\]|\\.)*\"|'[^']*'|\S*)")
_VARIABLE = re.compile(r"\$\{?(\w+)(?::?-([^}]*))?\}?")
_PIPED_SCRIPT = re.compile(
    r"\b(?:curl|wget)\b[^;&]*\|\s*(?:sudo\s+)?(?:env\s+)?(?:/\S*/)?(?:ba|da|z)?sh\b"
)
_REMOTE = re.compile(r"\b(?:https?|ftp|git)://")


@dataclass(frozen=True, slots=True)
class Recipe:
    """A Dockerfile as rules are asked about it; a place is a line."""

    instructions: tuple[Instruction, ...]
    stages: tuple[Stage, ...]

    def named(self, *names: str) -> Iterator[Instruction]:
        """Yield the instructions of some names."""
        yield from (each for each in self.instructions if each.name in names)


RULES: Rules[Recipe, int] = Rules()  #: What a Dockerfile may hold that builders can read.


def check_dockerfile(text: str, file: str = "Dockerfile") -> tuple[Finding, ...]:
    """Return what is wrong with a Dockerfile, in the order of its lines; `file` is its name, for people."""
    try:
        instructions = parse_dockerfile(text)
        recipe = Recipe(instructions, stages_of(instructions))
    except DeployError as error:
        place, why = Place(file=file), "no builder can read it"
        return (an_error(code="dockerfile-syntax", place=place, what=str(error), why=why),)
    broken = RULES.broken(recipe, lambda line: Place(file=file, line=line))
    return tuple(sorted(broken, key=lambda finding: finding.place.line))


@RULES.add("no-stage", "there is nothing to build from")
def _no_stage(recipe: Recipe) -> Iterator[Broken[int]]:
    if not recipe.stages:
        yield Broken(0, "no FROM")


@RULES.add("unpinned-image", "the same text builds another image tomorrow", "name a version")
def _unpinned(recipe: Recipe) -> Iterator[Broken[int]]:
    # A FROM sees the defaults of the arguments before the first one, and no others.
    head = takewhile(lambda each: each.name != "FROM", recipe.instructions)
    assigned = [
        pair for each in head if each.name == "ARG" for pair in _ASSIGNMENT.findall(each.value)
    ]
    defaults = {name: value.strip("\"'") for name, value in assigned}
    known = {"scratch"}
    for stage in recipe.stages:
        image = _VARIABLE.sub(lambda match: defaults.get(match[1]) or match[2] or "", stage.image)
        if image not in known and not _is_pinned(image):
            what = f"FROM {stage.image}: given {image!r}, allowed: a tag other than latest, or a digest"
            yield Broken(stage.line, what)
        known.add(stage.name)


def _is_pinned(image: str) -> bool:
    name, _, digest = image.partition("@")
    if digest:
        return re.fullmatch(r"sha256:[0-9a-f]{64}", digest) is not None
    tag = name.rsplit("/", 1)[-1].partition(":")[2]
    return tag not in {"", "latest"}


def _layers(recipe: Recipe) -> list[str]:
    return [stage.name for stage in recipe.stages if stage.name in STAGES]


@RULES.add("layers", "the three layers are what agents share (paper A, section 4.4, Fig. 5)")
def _missing_layer(recipe: Recipe) -> Iterator[Broken[int]]:
    if _layers(recipe) != list(STAGES):
        given = ", ".join(stage.name or "(no name)" for stage in recipe.stages)
        line = recipe.stages[0].line if recipe.stages else 0
        yield Broken(line, f"stages: given {given}, allowed: {', '.join(STAGES)}")


@RULES.add("layers", "a layer stands on the one below it")
def _displaced_layer(recipe: Recipe) -> Iterator[Broken[int]]:
    origins = {stage.name: stage for stage in recipe.stages}
    for below, above in pairwise(STAGES) if _layers(recipe) == list(STAGES) else ():
        if origins[above].image != below:
            what = f"stage {above}: given FROM {origins[above].image}, allowed: FROM {below}"
            yield Broken(origins[above].line, what)


@RULES.add(
    "runs-as-root",
    "what breaks out of a container of root is root outside",
    "end the stage with USER 10001:10001",
)
def _root(recipe: Recipe) -> Iterator[Broken[int]]:
    """The last stage is what a builder makes when nobody says which; the application is what robots run."""
    stages = recipe.stages
    origins = {stage.name: stage for stage in stages if stage.name}
    for stage in dict.fromkeys((*stages[-1:], *(s for s in stages if s.name == STAGES[-1]))):
        user = _user(stage, origins)
        if user.partition(":")[0] in {"", "0", "root"}:
            given = f"given {user or 'nothing'!r}, allowed: not root"
            yield Broken(stage.line, f"stage {stage.name or stages.index(stage)}: USER: {given}")


def _user(stage: Stage, origins: dict[str, Stage]) -> str:
    users = [each.value for each in stage.instructions if each.name == "USER"]
    if users:
        return users[-1]
    below = origins.get(stage.image)
    return "" if below is None or below is stage else _user(below, origins)


@RULES.add(
    "secret",
    "it stands in the image's history for all who have the image",
    "use RUN --mount=type=secret",
)
def _secret(recipe: Recipe) -> Iterator[Broken[int]]:
    for each in recipe.named("ARG", "ENV"):
        for name, value in _assignments(each):
            if _SECRET.search(name) and value.strip("\"'"):
                yield Broken(each.line, f"{each.name} {name}: a secret with a value")


def _assignments(each: Instruction) -> list[tuple[str, str]]:
    if each.name == "ENV" and "=" not in each.value.split(maxsplit=1)[0]:
        name, _, value = each.value.partition(" ")  # the old form, ENV NAME value
        return [(name, value)]
    return _ASSIGNMENT.findall(each.value)


@RULES.add("unchecked-download", "nobody knows what it will be", "add --checksum")
def _unchecked(recipe: Recipe) -> Iterator[Broken[int]]:
    for each in recipe.named("ADD"):
        if _REMOTE.search(each.value) and "--checksum=" not in each.value:
            yield Broken(each.line, f"ADD {each.value}: from the network without a digest")


@RULES.add("piped-script", "it runs as root and is never the same twice for certain")
def _piped(recipe: Recipe) -> Iterator[Broken[int]]:
    for each in recipe.named("RUN"):
        if _PIPED_SCRIPT.search(each.value):
            yield Broken(each.line, "RUN: a download is piped into a shell")


@RULES.add(
    "copies-everything",
    "whatever lies there gets into the image, secrets too",
    "name what is needed",
)
def _everything(recipe: Recipe) -> Iterator[Broken[int]]:
    for each in recipe.named("ADD", "COPY"):
        words = [word for word in each.value.split() if not word.startswith("--")]
        if not each.value.startswith("--from=") and {".", "./", "/"} & set(words[:-1]):
            yield Broken(each.line, f"{each.name} {each.value}: the whole folder")

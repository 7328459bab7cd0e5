"""Checks of rendered files by programs of other projects; a program that is not installed is named.

Each program reads the files of all agents, in a folder with one folder per agent. Files of the same name
and content are read once, except by a program that reads an agent's files together.
"""

from __future__ import annotations

import os
import subprocess
from collections import Counter
from dataclasses import dataclass
from enum import Enum
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from sfglab.deploy.bundle import write_bundle
from sfglab.deploy.errors import EXTRA, MissingProgramError
from sfglab.deploy.programs import find_program
from sfglab.fleet.lint import Severity, lint, render_findings
from sfglab.tables import columns

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Sequence

    from sfglab.deploy.bundle import Bundle
    from sfglab.fleet.fleet_file import Fleet

_LIMIT_S = 300.0
_DEVCONTAINER = str(Path(__file__).parent / "schemas" / "devcontainer.yaml")
_ENVIRONMENT = {
    "LC_ALL": "C.UTF-8",
    "SFGLAB_TAG": "checked",
    "SFGLAB_VIDEO_GID": "44",
    "SFGLAB_RENDER_GID": "44",
}
"""Variables of the programs; a Compose file needs the last three, which the hooks write into ``.env``."""


class State(Enum):
    """Result of a check, the worst first."""

    FAILED = "failed"
    NOT_RUN = "not run"
    PASSED = "passed"


@dataclass(frozen=True, slots=True, kw_only=True)
class Check:
    """A check of an agent's files by an external program, such as a linter."""

    name: str  #: Name of the check.
    program: str  #: Name of the program, with a subcommand that may be missing.
    arguments: tuple[str, ...]  #: Arguments before the files.
    files: tuple[str, ...]  #: Patterns of the files in an agent's folder.
    install: str = EXTRA  #: Way to install the program.
    #: Whether the program runs once per agent, with its folder in place of ``{}``; otherwise once for all
    #: different files.
    each: bool = False
    #: Whether the exit status has no meaning, so that each printed line about the files is a fault.
    by_output: bool = False


_COMPOSE = "install Docker with its Compose plug-in"
CHECKS = (
    Check(
        name="Compose files",
        program="check-jsonschema",
        arguments=("--builtin-schema", "vendor.compose-spec"),
        files=("compose.yaml", "compose.dev.yaml"),
    ),
    Check(
        name="dev container files",
        program="check-jsonschema",
        arguments=("--regex-variant", "python", "--schemafile", _DEVCONTAINER),
        files=(".devcontainer/devcontainer.json",),
    ),
    Check(
        name="Dockerfiles",
        program="hadolint",
        arguments=("--no-color",),
        files=("Dockerfile",),
    ),
    Check(
        name="shell scripts",
        program="shellcheck",
        arguments=("--norc", "--format=gcc", "--external-sources", "--source-path=SCRIPTDIR"),
        files=("hooks/*.sh", "image/entrypoint.sh"),
    ),
    Check(
        name="Compose projects",
        program="docker compose",
        arguments=("--file", "{}/compose.yaml", "config", "--quiet"),
        files=("compose.yaml",),
        install=_COMPOSE,
        each=True,
    ),
    Check(
        name="Compose projects for development",
        program="docker compose",
        arguments=("-f", "{}/compose.yaml", "-f", "{}/compose.dev.yaml", "config", "--quiet"),
        files=("compose.dev.yaml",),
        install=_COMPOSE,
        each=True,
    ),
    Check(
        name="service units",
        program="systemd-analyze",
        arguments=("verify", "--man=no"),
        files=("systemd/*.service",),
        install="apt install systemd",
        by_output=True,
    ),
)
"""All checks, in the order in which they run."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Verdict:
    """Result of one check, with the program's output."""

    check: str  #: Name of the check.
    program: str  #: Name of the program.
    state: State  #: Result.
    files: int = 0  #: Number of files that the program read.
    detail: str = ""  #: Output of the program, or how to install it; empty if the check passed.


def check_fleet(fleet: Fleet) -> Verdict:
    """Return the result of the fleet linter, whose errors fail."""
    findings = [one for one in lint(fleet).findings if one.severity is Severity.ERROR]
    return Verdict(
        check="fleet file",
        program="sfglab fleet lint",
        state=State.FAILED if findings else State.PASSED,
        files=1,
        detail=render_findings(findings) if findings else "",
    )


def check_bundles(bundles: Iterable[Bundle]) -> Iterator[Verdict]:
    """Yield the result of each check of `CHECKS` about the files of agents, when it is known."""
    with TemporaryDirectory(prefix="sfglab-check-") as name:
        folder = Path(name)
        for bundle in bundles:
            write_bundle(bundle, folder / bundle.agent)
        for check in CHECKS:
            yield _verdict(check, folder)


def _verdict(check: Check, folder: Path) -> Verdict:
    verdict = partial(Verdict, check=check.name, program=check.program)
    try:
        command = _command(check)
    except MissingProgramError as error:
        return verdict(state=State.NOT_RUN, detail=str(error))
    files = _files_of(check, folder)
    if not files:
        missing = f"no agent has a file {' or '.join(check.files)}"
        return verdict(state=State.FAILED, detail=missing)
    runs = [[*check.arguments, *files]]
    if check.each:
        agents = [Path(file).parts[0] for file in files]
        runs = [[word.replace("{}", agent) for word in check.arguments] for agent in agents]
    faults: list[str] = []
    for arguments in runs:
        faults += _faults(check, [*command, *arguments], folder)
    state = State.FAILED if faults else State.PASSED
    return verdict(state=state, files=len(files), detail="\n".join(faults))


def _command(check: Check) -> list[str]:
    """Return the path of a check's program, and its subcommand.

    Raises:
        MissingProgramError: The program or the subcommand is not installed.
    """
    name, *subcommand = check.program.split()
    command = [find_program(name, check.install), *subcommand]
    if subcommand:
        asked = subprocess.run([*command, "version"], capture_output=True, check=False)
        if asked.returncode != 0:
            raise MissingProgramError(check.program, check.install)
    return command


def _files_of(check: Check, folder: Path) -> list[str]:
    """Return the files that a check reads: all files of each agent, or each different file once."""
    found: dict[object, str] = {}
    for pattern in check.files:
        for path in sorted(folder.glob(f"*/{pattern}")):
            key = path if check.each else (path.name, path.read_bytes())
            found.setdefault(key, str(path.relative_to(folder)))
    return list(found.values())


def _faults(check: Check, command: Sequence[str], folder: Path) -> list[str]:
    """Return the output of a program about files that it does not accept, as lines."""
    try:
        done = subprocess.run(
            command,
            cwd=folder,
            env=os.environ | _ENVIRONMENT,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            timeout=_LIMIT_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return [f"{check.program} did not finish: {error}"]
    output = done.stdout.replace(f"{folder}/", "")
    lines = [line for line in output.splitlines() if line.strip()]
    if check.by_output:
        return [line for line in lines if _is_about_a_unit(line)]
    if done.returncode == 0:
        return []
    return lines or [f"{check.program} ended with status {done.returncode} and no message"]


def _is_about_a_unit(line: str) -> bool:
    """Return whether a line is about a unit of an agent, and not about a program that this host lacks."""
    return "sfglab-" in line and "is not executable" not in line


def render_verdicts(verdicts: Sequence[Verdict]) -> str:
    """Return a table of results with the output of each program that found faults, and a count."""
    rows = [("result", "check", "program", "files")]
    rows += [(one.state.value, one.check, one.program, str(one.files)) for one in verdicts]
    lines = columns(rows)
    for row in range(len(verdicts), 0, -1):
        detail = verdicts[row - 1].detail.splitlines()
        lines[row + 1 : row + 1] = [f"    {text}" for text in detail]
    counts = Counter(verdict.state for verdict in verdicts)
    lines.append(", ".join(f"{counts[state]} {state.value}" for state in reversed(State)))
    return "\n".join(lines)

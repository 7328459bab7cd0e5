"""Shell scripts of a folder: ShellCheck's findings, and that programs can be started."""

from __future__ import annotations

import json
from collections import defaultdict
from typing import TYPE_CHECKING, Any

from sfglab.deploy.checking.programs import answer_of, find_program
from sfglab.deploy.checking.verdicts import SkippedError, State, Verdict, verdict_of
from sfglab.deploy.errors import DeployError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from sfglab.deploy.files import BundleFile


LINTER = "shellcheck"
STARTS = "programs can be started"
_ANY = 0o111


def shell_scripts(files: Mapping[str, BundleFile]) -> dict[str, BundleFile]:
    """Return the scripts among files: by their suffix, or by a first line that names a shell."""
    return {name: file for name, file in files.items() if name.endswith(".sh") or _shebang(file.text)}


def check_shell(files: Mapping[str, BundleFile]) -> tuple[Verdict, ...]:
    """Return two verdicts about each script: by ShellCheck, and on its permissions.

    Args:
        files: The agent's whole folder, because scripts read each other.
    """
    scripts = shell_scripts(files)
    if not scripts:
        says = "there is no shell script among the files"
        return (Verdict(check=LINTER, subject="*.sh", state=State.SKIPPED, says=says),)
    verdicts = [verdict_of(STARTS, name, _startable, file) for name, file in scripts.items()]
    return (*_linted(scripts), *verdicts)


def _shebang(text: str) -> bool:
    first = text.partition("\n")[0]
    return first.startswith("#!") and first.split()[-1].rpartition("/")[2] in {"sh", "bash", "dash"}


def _startable(file: BundleFile) -> Iterator[str]:
    if _shebang(file.text) and file.mode & _ANY != _ANY:
        yield f"its first line says it is a program, but its mode is {file.mode:o}: allowed is 755"
    if "\r" in file.text:
        yield "lines end with CR LF, which no shell on Linux takes: allowed is LF"


def _linted(scripts: Mapping[str, BundleFile]) -> Iterator[Verdict]:
    try:
        comments = _shellcheck({name: file.text for name, file in scripts.items()})
    except SkippedError as error:
        state, says = State.SKIPPED, str(error)
    except DeployError as error:
        state, says = State.FAILS, str(error)
    else:
        for name in scripts:
            yield verdict_of(LINTER, name, comments.__getitem__, name)
        return
    for name in scripts:
        yield Verdict(check=LINTER, subject=name, state=state, says=says)


def _shellcheck(texts: Mapping[str, str]) -> dict[str, list[str]]:
    """Return ShellCheck's comments by file; its own formats' name for them is ``json1``."""
    program = find_program(LINTER)
    options = ("--norc", "--format=json1", "--external-sources", "--source-path=SCRIPTDIR")
    output = answer_of((program, *options, "--", *texts), tuple(texts.items()))
    found: dict[str, list[str]] = defaultdict(list)
    for comment in json.loads(output)["comments"]:
        words = _sentence(comment)
        if words not in found[comment["file"]]:  # a file that others read is seen more than once
            found[comment["file"]].append(words)
    return found


def _sentence(comment: dict[str, Any]) -> str:
    return f"line {comment['line']}: {comment['message']} (SC{comment['code']})"

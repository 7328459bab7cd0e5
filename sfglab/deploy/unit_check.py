"""Faults of a systemd unit: our own rules, and `systemd-analyze verify` where the machine has it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.deploy.errors import DeployError
from sfglab.deploy.shapes import check_shape
from sfglab.deploy.verdicts import worst_first
from sfglab.documents import Place
from sfglab.fleet.lint import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.errors import KeyPath

ANALYZE = "systemd-analyze"
STAND_INS = ("docker.service",)
UNIT_FOLDERS = (
    "/etc/systemd/system",
    "/run/systemd/system",
    "/usr/lib/systemd/system",
    "/lib/systemd/system",
)
_TIMEOUT_S = 30.0
_NAME = re.compile(r"[\w:.@-]+\.service", re.ASCII)
_SAYS = re.compile(r"(?P<file>[^\s:]+\.service):(?:(?P<line>\d+):)? (?P<what>.+)")
_MISSING = re.compile(r"Command (\S+) is not executable")


class Unit:
    """A unit's sections: the values of each key, in their order; lines that end in a backslash go on."""

    def __init__(self, text: str, name: str) -> None:
        self.value: dict[str, dict[str, list[str]]] = {}  #: Values by section and key.
        self.odd: list[int] = []  #: Numbers of the lines that assign nothing.
        self._name = name
        self._lines: dict[KeyPath, int] = {}
        section = ""
        lines = enumerate(text.splitlines(), 1)
        for number, first in lines:
            line = first.strip()
            while line.endswith("\\"):
                line = line[:-1] + " " + next(lines, (0, ""))[1].strip()
            key, equals, value = (part.strip() for part in line.partition("="))
            if line.startswith("[") and line.endswith("]"):
                section = line[1:-1]
                self.value.setdefault(section, {})
                self._lines.setdefault((section,), number)
            elif line and line[0] not in "#;" and equals and section:
                values = self.value[section].setdefault(key, [])
                self._lines.setdefault((section, key), number)
                self._lines[section, key, len(values)] = number
                values.append(value)
            elif line and line[0] not in "#;":
                self.odd.append(number)

    def place(self, path: KeyPath) -> Place:
        """Return where a value stands; of what is missing, line 0."""
        return Place(
            file=self._name, key=".".join(map(str, path[:2])), line=self._lines.get(path, 0)
        )


def check_unit(text: str, name: str) -> tuple[Finding, ...]:
    """Return what is wrong with a service unit of a name as ``sfglab-go2.service``, the worst first.

    Raises:
        DeployError: The name is no service's.
        MissingProgramError: The library that reads JSON Schema is not installed.
    """
    if not _NAME.fullmatch(name):
        raise DeployError(f"unit: given {name!r}, allowed: a file name that ends in .service")
    unit = Unit(text, name)
    what, why = "neither a [Section] nor Key=value", "systemd does not read it"
    findings = [_finding("syntax", Place(file=name, line=number), what, why) for number in unit.odd]
    findings += check_shape(unit, "systemd-unit")
    if shutil.which(ANALYZE):
        findings += _verify(text, name)
    else:
        findings.append(
            _remark("verify", name, f"{ANALYZE} is not installed", "only our own rules were asked")
        )
    return worst_first(findings)


def _verify(text: str, name: str) -> Iterator[Finding]:
    with tempfile.TemporaryDirectory(prefix="sfglab-unit-") as folder:
        path = Path(folder, name)
        path.write_text(text, encoding="utf-8")
        for unit in STAND_INS:
            if not any(Path(place, unit).exists() for place in UNIT_FOLDERS):
                Path(folder, unit).write_text("[Service]\nExecStart=/bin/true\n", encoding="utf-8")
                why = "a stand-in took its place in the check"
                yield _remark("stand-in", name, f"this machine has no {unit}", why)
        # The colon at the end adds systemd's own folders.
        settings = {"SYSTEMD_UNIT_PATH": f"{folder}:", "LC_ALL": "C", "SYSTEMD_COLORS": "0"}
        try:
            done = subprocess.run(
                [ANALYZE, "verify", "--man=no", str(path)],
                env=os.environ | settings,
                capture_output=True,
                text=True,
                timeout=_TIMEOUT_S,
                check=False,
            )
        except subprocess.TimeoutExpired as error:
            late = f"{ANALYZE} verify has not ended after {_TIMEOUT_S:g} s"
            raise DeployError(f"{name}: {late}, allowed: that it does") from error
    yield from _said(done.stderr, name)


def _said(output: str, name: str) -> Iterator[Finding]:
    """Yield what was said of this unit; verify also says what is wrong with others that it loads."""
    for match in filter(None, map(_SAYS.match, output.splitlines())):
        if Path(match["file"]).name != name:
            continue
        if missing := _MISSING.search(match["what"]):
            yield _remark(
                "program", name, f"{missing[1]} is not on this machine", "it must be on the agent's"
            )
        else:
            place = Place(file=name, line=int(match["line"] or 0))
            yield _finding("verify", place, match["what"], f"{ANALYZE} verify")


def _finding(code: str, place: Place, what: str, why: str) -> Finding:
    return Finding(severity=Severity.ERROR, code=code, place=place, what=what, why=why)


def _remark(code: str, name: str, what: str, why: str) -> Finding:
    return replace(_finding(code, Place(file=name), what, why), severity=Severity.INFO)

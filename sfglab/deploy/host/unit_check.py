"""What is wrong with a systemd unit: our own rules, and `systemd-analyze verify` where the machine has it.

Units that the unit asks for and that this machine does not have, such as Docker's where files are rendered but
not run, get a stand-in for the check; a program that is missing here is only worth knowing.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.deploy.errors import DeployError
from sfglab.deploy.host.unit_rules import check_lines
from sfglab.documents import Place
from sfglab.fleet.border import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Iterator


ANALYZE = "systemd-analyze"
STAND_INS = ("docker.service",)
UNIT_FOLDERS = ("/etc/systemd/system", "/run/systemd/system", "/usr/lib/systemd/system", "/lib/systemd/system")
_STAND_IN = "[Service]\nExecStart=/bin/true\n"
_TIMEOUT_S = 30.0
_NAME = re.compile(r"[\w:.@-]+\.service", re.ASCII)
_SAYS = re.compile(r"(?P<file>[^\s:]+\.service):(?:(?P<line>\d+):)? (?P<what>.+)")
_MISSING = re.compile(r"Command (\S+) is not executable")


def check_unit(text: str, name: str) -> tuple[Finding, ...]:
    """Return what is wrong with a service unit, the worst first.

    Args:
        text: The unit.
        name: Its file name, as in ``sfglab-go2.service``.

    Raises:
        DeployError: The name is no service's.
    """
    if not _NAME.fullmatch(name):
        raise DeployError(f"unit: given {name!r}, allowed: a file name that ends in .service")
    findings = list(check_lines(text, name))
    if shutil.which(ANALYZE):
        findings.extend(_verify(text, name))
    else:
        why = "only our own rules were asked"
        findings.append(_finding(Severity.INFO, "verify", Place(file=name), f"{ANALYZE} is not installed", why))
    order = list(Severity)
    return tuple(sorted(findings, key=lambda finding: order.index(finding.severity)))


def _verify(text: str, name: str) -> Iterator[Finding]:
    with tempfile.TemporaryDirectory(prefix="sfglab-unit-") as folder:
        path = Path(folder, name)
        path.write_text(text, encoding="utf-8")
        for unit in STAND_INS:
            if not any(Path(place, unit).exists() for place in UNIT_FOLDERS):
                Path(folder, unit).write_text(_STAND_IN, encoding="utf-8")
                why = "a stand-in took its place in the check"
                yield _finding(Severity.INFO, "stand-in", Place(file=name), f"this machine has no {unit}", why)
        yield from _said(_run(path), name)


def _run(path: Path) -> str:
    # The colon at the end adds systemd's own folders.
    environment = {**os.environ, "SYSTEMD_UNIT_PATH": f"{path.parent}:", "LC_ALL": "C", "SYSTEMD_COLORS": "0"}
    try:
        done = subprocess.run(
            [ANALYZE, "verify", "--man=no", str(path)],
            env=environment,
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_S,
            check=False,
        )
    except subprocess.TimeoutExpired as error:
        raise DeployError(
            f"{path.name}: {ANALYZE} verify has not ended after {_TIMEOUT_S:g} s, allowed: that it does"
        ) from error
    said: str = done.stderr
    return said


def _said(output: str, name: str) -> Iterator[Finding]:
    """Yield what was said of this unit; verify also says what is wrong with others that it loads."""
    for line in output.splitlines():
        match = _SAYS.match(line)
        if match is None or Path(match["file"]).name != name:
            continue
        if missing := _MISSING.search(match["what"]):
            what, why = f"{missing[1]} is not on this machine", "it must be on the agent's"
            yield _finding(Severity.INFO, "program", Place(file=name), what, why)
        else:
            place = Place(file=name, line=int(match["line"] or 0))
            yield _finding(Severity.ERROR, "verify", place, match["what"], f"{ANALYZE} verify")


def _finding(severity: Severity, code: str, place: Place, what: str, why: str) -> Finding:
    return Finding(severity=severity, code=code, place=place, what=what, why=why)

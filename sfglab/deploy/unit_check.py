"""Faults of a systemd unit: our own rules, and `systemd-analyze verify` where the machine has it."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from sfglab.deploy.errors import DeployError
from sfglab.documents import Place
from sfglab.fleet.border import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Iterator


_WORDS = {
    "Unit": """
        Description Documentation Wants Requires Requisite BindsTo PartOf Upholds Conflicts Before
        After OnFailure OnSuccess RequiresMountsFor StartLimitIntervalSec StartLimitBurst
        StartLimitAction ConditionPathExists ConditionFileNotEmpty AssertPathExists
        DefaultDependencies JobTimeoutSec StopWhenUnneeded RefuseManualStart RefuseManualStop
        CollectMode
    """,
    "Service": """
        Type ExecStart ExecStartPre ExecStartPost ExecCondition ExecReload ExecStop ExecStopPost
        Restart RestartSec RestartPreventExitStatus SuccessExitStatus TimeoutSec TimeoutStartSec
        TimeoutStopSec RemainAfterExit PIDFile NotifyAccess WatchdogSec KillMode KillSignal
        SendSIGKILL WorkingDirectory RootDirectory User Group SupplementaryGroups DynamicUser
        Environment EnvironmentFile PassEnvironment UnsetEnvironment StandardInput StandardOutput
        StandardError SyslogIdentifier RuntimeDirectory RuntimeDirectoryMode StateDirectory
        CacheDirectory LogsDirectory ConfigurationDirectory UMask Nice LimitNOFILE LimitMEMLOCK
        LimitRTPRIO OOMScoreAdjust CPUSchedulingPolicy CPUSchedulingPriority CPUAffinity MemoryMax
        MemoryHigh CPUQuota CPUWeight TasksMax IOWeight Delegate Slice DeviceAllow DevicePolicy
        CapabilityBoundingSet AmbientCapabilities NoNewPrivileges SecureBits LockPersonality
        MemoryDenyWriteExecute PrivateDevices PrivateTmp PrivateNetwork PrivateUsers PrivateMounts
        PrivateIPC ProtectClock ProtectControlGroups ProtectHome ProtectHostname ProtectKernelLogs
        ProtectKernelModules ProtectKernelTunables ProtectProc ProcSubset ProtectSystem
        ReadWritePaths ReadOnlyPaths InaccessiblePaths ExecPaths NoExecPaths BindPaths
        BindReadOnlyPaths TemporaryFileSystem RemoveIPC RestrictAddressFamilies RestrictFileSystems
        RestrictNamespaces RestrictRealtime RestrictSUIDSGID SystemCallArchitectures
        SystemCallFilter SystemCallErrorNumber IPAddressAllow IPAddressDeny LoadCredential
        LoadCredentialEncrypted KeyringMode
    """,
    "Install": """
        WantedBy RequiredBy UpheldBy Also Alias DefaultInstance
    """,
}
KEYS = {section: frozenset(words.split()) for section, words in _WORDS.items()}
_RESTARTING = frozenset({"always", "on-failure", "on-abnormal", "on-abort", "on-watchdog", "on-success"})
_SECRET = re.compile(
    r"\b\w*(?:password|passwd|secret|token|api_?key|private_?key)\w*\b[=\s\"']+(?=\S)", re.IGNORECASE
)
_PREFIXES = "@-:+!|"  # systemd.service(5), "Command lines"


class Entry(NamedTuple):
    """An assignment, with the section and the line at which it begins."""

    section: str
    key: str
    value: str
    line: int


def check_lines(text: str, name: str) -> Iterator[Finding]:
    """Yield what is wrong with a unit's text.

    Args:
        text: The unit.
        name: Its file name.
    """
    entries: list[Entry] = []
    for entry in _entries(text):
        if isinstance(entry, int):
            yield _error(
                name, entry, "neither a [Section] nor Key=value", code="syntax", why="systemd does not read it"
            )
        else:
            entries.append(entry)
            yield from _check_entry(entry, name)
    yield from _check_whole(entries, name)


def _entries(text: str) -> Iterator[Entry | int]:
    """Yield assignments, and the numbers of lines that are none; lines that end in a backslash go on."""
    section = ""
    lines = enumerate(text.splitlines(), 1)
    for number, first in lines:
        line = first.strip()
        while line.endswith("\\"):
            line = line[:-1] + " " + next(lines, (0, ""))[1].strip()
        if not line or line[0] in "#;":
            continue
        if line.startswith("[") and line.endswith("]"):
            section = line[1:-1]
            continue
        key, equals, value = line.partition("=")
        yield Entry(section, key.strip(), value.strip(), number) if equals and section else number


def _check_entry(entry: Entry, name: str) -> Iterator[Finding]:
    if entry.section.startswith("X-") or entry.key.startswith("X-"):
        return
    where = f"[{entry.section}] {entry.key}"
    known = KEYS.get(entry.section)
    if known is None:
        what = f"{where}: the section is not known, allowed: {', '.join(KEYS)}"
        yield _error(name, entry.line, what, code="section", why="systemd ignores it")
    elif entry.key not in known:
        yield _error(
            name, entry.line, f"{where}: the key is not known", code="key", why="systemd may ignore it"
        )
    elif entry.key.startswith("Exec") and entry.section == "Service" and entry.value:
        yield from _check_command(entry, name)
    if _SECRET.search(entry.value) and (entry.key == "Environment" or entry.key.startswith("Exec")):
        yield Finding(
            severity=Severity.ERROR,
            code="secret",
            place=Place(file=name, line=entry.line),
            what=f"{where}: holds what reads as a secret",
            why="everybody on the machine may read units (systemctl show)",
            remedy="LoadCredential=",
        )


def _check_command(entry: Entry, name: str) -> Iterator[Finding]:
    if entry.key.endswith("Paths"):
        return
    program = entry.value.split()[0].lstrip(_PREFIXES)
    if "/" in program and not program.startswith("/"):
        what = f"[Service] {entry.key}: given {program!r}, allowed: an absolute path, or a name without '/'"
        yield _error(name, entry.line, what, code="command", why="systemd refuses the unit")


def _check_whole(entries: list[Entry], name: str) -> Iterator[Finding]:
    values = {(entry.section, entry.key): entry.value for entry in entries}
    if not values.get(("Service", "ExecStart")):
        yield _error(
            name, 0, "[Service] ExecStart: nothing is given", code="command", why="there is nothing to run"
        )
    if not any(section == "Install" for section, _ in values):
        yield _warning(name, "[Install]: nothing is given", code="install", why="it cannot be enabled at boot")
    unlimited = ("Unit", "StartLimitBurst") not in values
    if values.get(("Service", "Restart"), "no") in _RESTARTING and unlimited:
        what = "[Unit] StartLimitBurst: nothing is given beside Restart"
        yield _warning(name, what, code="limit", why="how often it is tried is left to the machine")


def _error(name: str, line: int, what: str, *, code: str, why: str) -> Finding:
    place = Place(file=name, line=line)
    return Finding(severity=Severity.ERROR, code=code, place=place, what=what, why=why)


def _warning(name: str, what: str, *, code: str, why: str) -> Finding:
    return Finding(severity=Severity.WARNING, code=code, place=Place(file=name), what=what, why=why)


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

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
from sfglab.deploy.findings import Broken, Rules, worst_first
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

ANALYZE = "systemd-analyze"
STAND_INS = ("docker.service",)
UNIT_FOLDERS = ("/etc/systemd/system", "/run/systemd/system", "/usr/lib/systemd/system", "/lib/systemd/system")
_STAND_IN = "[Service]\nExecStart=/bin/true\n"
_TIMEOUT_S = 30.0
_NAME = re.compile(r"[\w:.@-]+\.service", re.ASCII)
_SAYS = re.compile(r"(?P<file>[^\s:]+\.service):(?:(?P<line>\d+):)? (?P<what>.+)")
_MISSING = re.compile(r"Command (\S+) is not executable")


class Entry(NamedTuple):
    """An assignment, with the section and the line at which it begins."""

    section: str
    key: str
    value: str
    line: int

    @property
    def where(self) -> str:
        """Section and key, for people."""
        return f"[{self.section}] {self.key}"

    @property
    def ours(self) -> bool:
        """Whether systemd is to read it."""
        return bool(self.key) and not (self.section.startswith("X-") or self.key.startswith("X-"))


Unit = list[Entry]
RULES: Rules[Unit, int] = Rules()
"""What a unit's text alone tells; a place is a line, 0 for the whole."""


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
    findings = list(RULES.broken(list(_entries(text)), lambda line: Place(file=name, line=line)))
    if shutil.which(ANALYZE):
        findings += _verify(text, name)
    else:
        findings.append(_remark("verify", name, f"{ANALYZE} is not installed", "only our own rules were asked"))
    return worst_first(findings)


def _entries(text: str) -> Iterator[Entry]:
    """Yield assignments, without key where a line is none; lines that end in a backslash go on."""
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
        yield Entry(section, key.strip() if equals and section else "", value.strip(), number)


@RULES.add("syntax", "systemd does not read it")
def _no_assignment(unit: Unit) -> Iterator[Broken[int]]:
    yield from (Broken(entry.line, "neither a [Section] nor Key=value") for entry in unit if not entry.key)


@RULES.add("section", "systemd ignores it")
def _unknown_section(unit: Unit) -> Iterator[Broken[int]]:
    for entry in unit:
        if entry.ours and entry.section not in KEYS:
            yield Broken(entry.line, f"{entry.where}: the section is not known, allowed: {', '.join(KEYS)}")


@RULES.add("key", "systemd may ignore it")
def _unknown_key(unit: Unit) -> Iterator[Broken[int]]:
    for entry in unit:
        if entry.ours and entry.section in KEYS and entry.key not in KEYS[entry.section]:
            yield Broken(entry.line, f"{entry.where}: the key is not known")


@RULES.add("secret", "everybody on the machine may read units (systemctl show)", "LoadCredential=")
def _secret(unit: Unit) -> Iterator[Broken[int]]:
    for entry in unit:
        holds = entry.key == "Environment" or entry.key.startswith("Exec")
        if entry.ours and holds and _SECRET.search(entry.value):
            yield Broken(entry.line, f"{entry.where}: holds what reads as a secret")


@RULES.add("command", "systemd refuses the unit")
def _relative_command(unit: Unit) -> Iterator[Broken[int]]:
    for entry in unit:
        runs = entry.section == "Service" and entry.key.startswith("Exec") and entry.key in KEYS["Service"]
        if not runs or not entry.value or entry.key.endswith("Paths"):
            continue
        program = entry.value.split()[0].lstrip(_PREFIXES)
        if "/" in program and not program.startswith("/"):
            what = f"{entry.where}: given {program!r}, allowed: an absolute path, or a name without '/'"
            yield Broken(entry.line, what)


def _values(unit: Unit) -> dict[tuple[str, str], str]:
    return {(entry.section, entry.key): entry.value for entry in unit if entry.key}


@RULES.add("command", "there is nothing to run")
def _nothing_to_run(unit: Unit) -> Iterator[Broken[int]]:
    if not _values(unit).get(("Service", "ExecStart")):
        yield Broken(0, "[Service] ExecStart: nothing is given")


@RULES.add("install", "it cannot be enabled at boot", severity=Severity.WARNING)
def _not_installed(unit: Unit) -> Iterator[Broken[int]]:
    if not any(section == "Install" for section, _ in _values(unit)):
        yield Broken(0, "[Install]: nothing is given")


@RULES.add("limit", "how often it is tried is left to the machine", severity=Severity.WARNING)
def _unlimited(unit: Unit) -> Iterator[Broken[int]]:
    values = _values(unit)
    if values.get(("Service", "Restart"), "no") in _RESTARTING and ("Unit", "StartLimitBurst") not in values:
        yield Broken(0, "[Unit] StartLimitBurst: nothing is given beside Restart")


def _verify(text: str, name: str) -> Iterator[Finding]:
    with tempfile.TemporaryDirectory(prefix="sfglab-unit-") as folder:
        path = Path(folder, name)
        path.write_text(text, encoding="utf-8")
        for unit in STAND_INS:
            if not any(Path(place, unit).exists() for place in UNIT_FOLDERS):
                Path(folder, unit).write_text(_STAND_IN, encoding="utf-8")
                why = "a stand-in took its place in the check"
                yield _remark("stand-in", name, f"this machine has no {unit}", why)
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
    for match in filter(None, map(_SAYS.match, output.splitlines())):
        if Path(match["file"]).name != name:
            continue
        if missing := _MISSING.search(match["what"]):
            yield _remark("program", name, f"{missing[1]} is not on this machine", "it must be on the agent's")
        else:
            place, why = Place(file=name, line=int(match["line"] or 0)), f"{ANALYZE} verify"
            yield Finding(severity=Severity.ERROR, code="verify", place=place, what=match["what"], why=why)


def _remark(code: str, name: str, what: str, why: str) -> Finding:
    return Finding(severity=Severity.INFO, code=code, place=Place(file=name), what=what, why=why)

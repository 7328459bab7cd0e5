"""What can be said of a service unit from its text alone: sections, keys, commands, secrets, limits.

Knows the keys that units of a deployment have a use for (systemd.unit(5), systemd.service(5), systemd.exec(5),
systemd 252), not all of systemd's; for those there is `systemd-analyze verify`, see `unit_check`.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, NamedTuple

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

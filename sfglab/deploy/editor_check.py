"""Faults of the files that VS Code reads: keys, and everything that one place says of another."""

from __future__ import annotations

import json
import posixpath
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.deploy.editor import DEBUGGERS
from sfglab.documents import Document, DocumentError, Place, suggestion
from sfglab.fleet.border import Finding, Severity

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from sfglab.deploy.files import BundleFile


_EXTENSION = re.compile(r"[A-Za-z0-9][A-Za-z0-9-]*\.[A-Za-z0-9][A-Za-z0-9._-]*")
"""``publisher.name``, as in the marketplace."""

_VARIABLE = re.compile(r"\$\{([^}]*)\}")
_VARIABLES = ("file", "fileDirname", "workspaceFolder", "localWorkspaceFolder", "containerWorkspaceFolder")
_PICKERS = ("pickMyProcess", "pickProcess")  # CodeLLDB's manual, "Pick Process Command"


def fault(file: str, key: str, what: str, why: str = "VS Code passes over it, or shows an error") -> Finding:
    """Return an error at a key of a file."""
    return Finding(severity=Severity.ERROR, code="editor", place=Place(file=file, key=key), what=what, why=why)


def bad_keys(
    value: Mapping[str, Any], file: str, key: str, *, known: Iterable[str], needed: Iterable[str] = ()
) -> Iterator[Finding]:
    """Find keys that nobody reads and those that are missing."""
    known = tuple(known)
    prefix = f"{key}." if key else ""
    for name in value:
        if name not in known:
            yield fault(file, f"{prefix}{name}", f"unknown key {name!r}{suggestion(name, known)}")
    for name in needed:
        if value.get(name) in (None, "", []):
            yield fault(file, f"{prefix}{name}", f"nothing is given, allowed: {name} of the reference")


def bad_variables(value: Any, file: str, key: str, inputs: Iterable[str]) -> Iterator[Finding]:
    """Find ``${...}`` that VS Code does not replace, and inputs that nobody defines."""
    inputs = tuple(inputs)
    for text in texts(value):
        for name in _VARIABLE.findall(text):
            kind, _, rest = name.partition(":")
            allowed = {"input": inputs, "command": _PICKERS, "env": (rest,)}.get(kind, _VARIABLES)
            if (rest or kind) not in allowed:
                near = suggestion(rest or kind, allowed)
                yield fault(file, key, f"given ${{{name}}}, allowed: {', '.join(allowed) or 'none'}{near}")


def bad_extensions(file: str, key: str, ids: Any) -> Iterator[Finding]:
    """Find what is no extension's id, or stands there twice."""
    if not isinstance(ids, list):
        yield fault(file, key, f"given {ids!r}, allowed: a list of extensions")
        return
    for position, name in enumerate(ids):
        if not isinstance(name, str) or not _EXTENSION.fullmatch(name):
            yield fault(file, f"{key}[{position}]", f"given {name!r}, allowed: publisher.name")
        elif name in ids[:position]:
            yield fault(file, f"{key}[{position}]", f"{name} stands there twice")


def texts(value: Any) -> Iterator[str]:
    """Yield every text inside a value of JSON."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, dict):
        for inner in value.values():
            yield from texts(inner)
    elif isinstance(value, list):
        for inner in value:
            yield from texts(inner)


def entries(value: Any) -> list[tuple[int, dict[str, Any]]]:
    """Return the objects of a list with their positions; nothing of what is no list."""
    listed = value if isinstance(value, list) else []
    return [(position, entry) for position, entry in enumerate(listed) if isinstance(entry, dict)]


def bad_entries(value: Any, file: str, key: str) -> Iterator[Finding]:
    """Find what is no list of objects."""
    if not isinstance(value, list):
        yield fault(file, key, f"given {value!r}, allowed: a list of objects")
    elif len(entries(value)) < len(value):
        yield fault(file, key, "an entry is no object, allowed: a list of objects")


def mapping_at(value: Any, *keys: str) -> dict[str, Any]:
    """Return the object below some keys, empty where there is none."""
    for key in keys:
        value = value.get(key) if isinstance(value, dict) else None
    return value if isinstance(value, dict) else {}


def listed(value: Any) -> list[Any]:
    """Return a list, of one value where only that is given."""
    return value if isinstance(value, list) else [] if value is None else [value]


_NEEDED = ("name", "dockerComposeFile", "service", "workspaceFolder", "remoteUser")
_LIFECYCLE = (
    "initializeCommand",
    "onCreateCommand",
    "updateContentCommand",
    "postCreateCommand",
    "postStartCommand",
    "postAttachCommand",
)
_CONTAINER_KEYS = (
    *(*_NEEDED, *_LIFECYCLE, "$schema", "runServices", "shutdownAction", "overrideCommand"),
    *("features", "overrideFeatureInstallOrder", "secrets", "forwardPorts", "portsAttributes"),
    *("otherPortsAttributes", "updateRemoteUserUID", "containerEnv", "containerUser", "mounts", "init"),
    *("privileged", "capAdd", "securityOpt", "remoteEnv", "waitFor", "userEnvProbe", "hostRequirements"),
    "customizations",
)
_SHUTDOWN = ("none", "stopCompose")
_HOME = "${localWorkspaceFolder}/"


def check_container(settings: dict[str, Any], file: str, files: Mapping[str, BundleFile]) -> Iterator[Finding]:
    """Find what is wrong with a development container's settings.

    Args:
        settings: What stands in the file.
        file: Its name in the folder.
        files: The whole folder.
    """
    yield from bad_keys(settings, file, "", known=_CONTAINER_KEYS, needed=_NEEDED)
    yield from bad_variables(settings, file, "", ())
    yield from _compose(settings, file, files)
    yield from _values(settings, file)
    for key in _LIFECYCLE:
        yield from _command(settings.get(key, []), file, key)
    yield from _initialize(settings.get("initializeCommand", []), file, files)
    vscode = mapping_at(settings, "customizations", "vscode")
    yield from bad_keys(vscode, file, "customizations.vscode", known=("extensions", "settings"))
    yield from bad_extensions(file, "customizations.vscode.extensions", vscode.get("extensions", []))


def _values(settings: dict[str, Any], file: str) -> Iterator[Finding]:
    shutdown = settings.get("shutdownAction", "stopCompose")
    if shutdown not in _SHUTDOWN:
        yield fault(file, "shutdownAction", f"given {shutdown!r}, allowed: {', '.join(_SHUTDOWN)}")
    if settings.get("remoteUser") in ("root", "0"):
        yield fault(file, "remoteUser", "given root, allowed: the image's user", "nodes need no root")
    if settings.get("privileged"):
        yield fault(file, "privileged", "given true, allowed: false", "it opens the whole machine")


def _command(command: Any, file: str, key: str) -> Iterator[Finding]:
    if not isinstance(command, list) or not all(isinstance(word, str) for word in command):
        yield fault(
            file, key, f"given {command!r}, allowed: a list of words", "a text would go through a shell"
        )


def _initialize(command: Any, file: str, files: Mapping[str, BundleFile]) -> Iterator[Finding]:
    """Find a hook that is not in the folder, or that nobody may run."""
    program = command[0] if isinstance(command, list) and command else ""
    if not isinstance(program, str) or not program.startswith(_HOME):
        return
    name = program.removeprefix(_HOME)
    if name not in files:
        yield fault(file, "initializeCommand", f"there is no file {name}", "the container does not start")
    elif not files[name].mode & 0o100:
        yield fault(file, "initializeCommand", f"{name} is no program", "the container does not start")


def _compose(settings: dict[str, Any], file: str, files: Mapping[str, BundleFile]) -> Iterator[Finding]:
    given = settings.get("dockerComposeFile", [])
    names = listed(given)
    paths = [posixpath.normpath(posixpath.join(posixpath.dirname(file), str(name))) for name in names]
    for name, path in zip(names, paths, strict=True):
        if path not in files:
            yield fault(file, "dockerComposeFile", f"there is no file {name}", "the container does not start")
    mounts = _mounts(files[path].text for path in paths if path in files)
    for name in (settings.get("service"), *listed(settings.get("runServices"))):
        if mounts and name not in tuple(mounts):
            yield fault(file, "service", f"given {name!r}, allowed: {', '.join(mounts)}")
    folder, targets = settings.get("workspaceFolder"), mounts.get(str(settings.get("service")), [])
    for target in (folder, f"{folder}/.vscode") if mounts else ():
        if target not in targets:
            yield fault(
                file, "workspaceFolder", f"nothing is mounted at {target}", "VS Code finds no files there"
            )


def _mounts(texts: Iterable[str]) -> dict[str, list[str]]:
    """Return where each service of Compose files has something mounted."""
    mounts: dict[str, list[str]] = {}
    for text in texts:
        try:
            project = Document(text, "compose").value
        except DocumentError:  # said by the check of Compose files
            continue
        services = project.get("services") if isinstance(project, dict) else None
        for name, service in (services or {}).items():
            volumes = service.get("volumes", []) if isinstance(service, dict) else []
            mounts.setdefault(name, []).extend(_target(volume) for volume in volumes)
    return mounts


def _target(volume: Any) -> str:
    """Return a volume's place in the container, from its long form or ``source:target[:mode]``."""
    if isinstance(volume, dict):
        return str(volume.get("target", ""))
    parts = re.sub(r"\$\{[^}]*\}", "", str(volume)).split(":")
    return parts[1] if len(parts) > 1 else parts[0]


_COMMON = (
    "name",
    "type",
    "request",
    "preLaunchTask",
    "postDebugTask",
    "presentation",
    "internalConsoleOptions",
)
_DEBUGPY = ("justMyCode", "subProcess", "pathMappings", "logToFile", "redirectOutput", "showReturnValue")
_LLDB = (
    *("initCommands", "preRunCommands", "postRunCommands", "preTerminateCommands", "exitCommands"),
    *("expressions", "sourceMap", "relativePathBase", "breakpointMode", "sourceLanguages", "stopOnEntry"),
)
_STARTED = ("program", "args", "cwd", "env", "envFile")
_PROFILE_KEYS: dict[tuple[str, str], tuple[str, ...]] = {
    ("debugpy", "launch"): (*_DEBUGPY, *_STARTED, "module", "python", "console", "stopOnEntry", "sudo"),
    ("debugpy", "attach"): (*_DEBUGPY, "connect", "listen", "processId"),
    ("lldb", "launch"): (*_LLDB, *_STARTED, "stdio", "terminal", "cargo"),
    ("lldb", "attach"): (*_LLDB, "program", "pid", "waitFor"),
}
"""What a profile may have beside the keys of all, by type of debugger and request."""

_ONE_OF = {
    ("debugpy", "launch"): ("program", "module"),
    ("debugpy", "attach"): ("connect", "listen", "processId"),
    ("lldb", "launch"): ("program", "cargo"),
    ("lldb", "attach"): ("program", "pid"),
}
_INPUTS = {
    "promptString": ("default", "password"),
    "pickString": ("default", "options"),
    "command": ("command",),
}
_TASK_KEYS = (
    *("label", "type", "command", "args", "options", "group", "problemMatcher", "presentation", "isBackground"),
    *("dependsOn", "dependsOrder", "detail", "runOptions", "icon", "hide"),
)
_MATCHERS = ("$gcc", "$tsc", "$eslint-stylish", "$msCompile", "$python", "$go")


def check_profiles(launch: dict[str, Any], file: str, tasks: tuple[str, ...]) -> Iterator[Finding]:
    """Find what is wrong with debugging profiles.

    Args:
        launch: What stands in the file.
        file: Its name in the folder.
        tasks: Labels of the tasks that there are.
    """
    known = ("version", "configurations", "inputs", "compounds")
    yield from bad_keys(launch, file, "", known=known, needed=("version", "configurations"))
    if launch.get("version") != "0.2.0":
        yield fault(file, "version", f"given {launch.get('version')!r}, allowed: '0.2.0'")
    for name in ("configurations", "inputs"):
        yield from bad_entries(launch.get(name, []), file, name)
    profiles, inputs = entries(launch.get("configurations")), entries(launch.get("inputs"))
    yield from _twice([profile.get("name") for _, profile in profiles], file, "configurations")
    names = tuple(str(entry.get("id")) for _, entry in inputs)
    for position, profile in profiles:
        key = f"configurations[{position}]"
        yield from _profile(profile, file, key)
        yield from bad_variables(profile, file, key, names)
        task = profile.get("preLaunchTask")
        if task is not None and task not in tasks:
            yield fault(file, f"{key}.preLaunchTask", f"there is no task {task!r}{suggestion(task, tasks)}")
    for position, entry in inputs:
        yield from _input(entry, file, f"inputs[{position}]")
    yield from _twice(list(names), file, "inputs")


def _profile(profile: dict[str, Any], file: str, key: str) -> Iterator[Finding]:
    kind = (str(profile.get("type")), str(profile.get("request")))
    if kind not in _PROFILE_KEYS:
        allowed = ", ".join(" ".join(pair) for pair in _PROFILE_KEYS)
        yield fault(file, f"{key}.type", f"given {' '.join(kind)!r}, allowed: {allowed}")
        return
    yield from bad_keys(profile, file, key, known=(*_COMMON, *_PROFILE_KEYS[kind]), needed=("name",))
    if not any(profile.get(one) for one in _ONE_OF[kind]):
        yield fault(file, key, f"nothing is given, allowed: {' or '.join(_ONE_OF[kind])}", "it starts nothing")
    yield from _arguments(profile, file, key)


def _arguments(profile: dict[str, Any], file: str, key: str) -> Iterator[Finding]:
    """Find command lines that do not arrive as the words that the user typed."""
    args = profile.get("args", "")
    if isinstance(args, list) and any("${input:" in str(word) for word in args):
        why = "all that the user types arrives as one argument"
        yield fault(file, f"{key}.args", "an input stands in a list, allowed: one text", why)
    if isinstance(args, str) and args and profile.get("type") == "debugpy":
        console = profile.get("console", "integratedTerminal")
        if console == "internalConsole":
            why = "debugpy splits a text by the terminal's shell"
            yield fault(file, f"{key}.console", "given internalConsole, allowed: integratedTerminal", why)


def _input(entry: dict[str, Any], file: str, key: str) -> Iterator[Finding]:
    kind = entry.get("type")
    if not isinstance(kind, str) or kind not in _INPUTS:
        yield fault(file, f"{key}.type", f"given {kind!r}, allowed: {', '.join(_INPUTS)}")
        return
    known = ("id", "type", "description", "args", *_INPUTS[kind])
    needed = ("id", "command") if kind == "command" else ("id", "description")
    yield from bad_keys(entry, file, key, known=known, needed=needed)


def check_tasks(tasks: dict[str, Any], file: str) -> Iterator[Finding]:
    """Find what is wrong with tasks.

    Args:
        tasks: What stands in the file.
        file: Its name in the folder.
    """
    known = ("version", "tasks", "inputs", "options", "presentation")
    yield from bad_keys(tasks, file, "", known=known, needed=("version", "tasks"))
    if tasks.get("version") != "2.0.0":
        yield fault(file, "version", f"given {tasks.get('version')!r}, allowed: '2.0.0'")
    yield from bad_entries(tasks.get("tasks", []), file, "tasks")
    listed = entries(tasks.get("tasks"))
    labels = [str(entry.get("label")) for _, entry in listed]
    yield from _twice(labels, file, "tasks")
    inputs = tuple(str(entry.get("id")) for _, entry in entries(tasks.get("inputs")))
    for position, entry in listed:
        key = f"tasks[{position}]"
        yield from _task(entry, file, key, labels)
        # Words of a Bash script are Bash's: what it does not know VS Code leaves alone.
        yield from bad_variables(entry.get("options", {}), file, key, inputs)


def _task(task: dict[str, Any], file: str, key: str, labels: list[str]) -> Iterator[Finding]:
    needed = ("label",) if "dependsOn" in task else ("label", "type", "command")
    yield from bad_keys(task, file, key, known=_TASK_KEYS, needed=needed)
    if task.get("type", "process") not in ("process", "shell"):
        yield fault(file, f"{key}.type", f"given {task['type']!r}, allowed: process, shell")
    depends = task.get("dependsOn", [])
    for other in listed(depends):
        if other not in labels:
            yield fault(file, f"{key}.dependsOn", f"there is no task {other!r}{suggestion(other, labels)}")
    matchers = task.get("problemMatcher", [])
    for matcher in listed(matchers):
        if isinstance(matcher, str) and matcher not in _MATCHERS:
            yield fault(file, f"{key}.problemMatcher", f"given {matcher!r}, allowed: {', '.join(_MATCHERS)}")


def _twice(names: list[Any], file: str, key: str) -> Iterator[Finding]:
    for position, name in enumerate(names):
        if name in names[:position]:
            yield fault(file, f"{key}[{position}]", f"{name!r} stands there twice")


CONTAINER = ".devcontainer/devcontainer.json"
EXTENSIONS = ".vscode/extensions.json"
LAUNCH = ".vscode/launch.json"
SETTINGS = ".vscode/settings.json"
TASKS = ".vscode/tasks.json"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Editor:
    """Its five files, read; what could not be read is empty."""

    container: dict[str, Any]
    extensions: dict[str, Any]
    launch: dict[str, Any]
    settings: dict[str, Any]
    tasks: dict[str, Any]


def check_editor(files: Mapping[str, BundleFile]) -> tuple[Finding, ...]:
    """Return what is wrong with the development container and the settings of VS Code.

    Args:
        files: The agent's whole folder, because the editor's files speak of others in it.
    """
    findings: list[Finding] = []
    read = {name: _read(files, name, findings) for name in (CONTAINER, EXTENSIONS, LAUNCH, SETTINGS, TASKS)}
    if findings:  # what files say of each other is asked once all can be read
        return tuple(findings)
    editor = _Editor(
        container=read[CONTAINER],
        extensions=read[EXTENSIONS],
        launch=read[LAUNCH],
        settings=read[SETTINGS],
        tasks=read[TASKS],
    )
    findings += check_container(editor.container, CONTAINER, files)
    findings += check_profiles(editor.launch, LAUNCH, _labels(editor.tasks))
    findings += check_tasks(editor.tasks, TASKS)
    findings += _extensions(editor)
    return tuple(findings)


def _read(files: Mapping[str, BundleFile], name: str, findings: list[Finding]) -> dict[str, Any]:
    if name not in files:
        findings.append(fault(name, "", "there is no such file", "VS Code reads it by this name"))
        return {}
    try:
        value = json.loads(files[name].text)
    except ValueError as error:
        findings.append(fault(name, "", f"given what is no JSON ({error}), allowed: JSON without comments"))
        return {}
    if not isinstance(value, dict):
        findings.append(fault(name, "", f"given {type(value).__name__}, allowed: an object"))
        return {}
    return value


def _labels(tasks: dict[str, Any]) -> tuple[str, ...]:
    return tuple(str(task.get("label")) for _, task in entries(tasks.get("tasks")))


def _extensions(editor: _Editor) -> Iterator[Finding]:
    """Find ids that are none, and needed extensions that nobody installs."""
    recommended = editor.extensions.get("recommendations", [])
    yield from bad_extensions(EXTENSIONS, "recommendations", recommended)
    known = recommended if isinstance(recommended, list) else []
    for place, extension in (*_formatters(editor.settings), *_debuggers(editor.launch)):
        if extension not in known:
            yield fault(*place, f"needs the extension {extension}, which is not among those recommended")


def _formatters(settings: dict[str, Any]) -> Iterator[tuple[tuple[str, str], str]]:
    for key, value in settings.items():
        if isinstance(value, dict) and "editor.defaultFormatter" in value:
            yield (SETTINGS, f"{key}.editor.defaultFormatter"), str(value["editor.defaultFormatter"])


def _debuggers(launch: dict[str, Any]) -> Iterator[tuple[tuple[str, str], str]]:
    for position, profile in entries(launch.get("configurations")):
        kind = str(profile.get("type"))
        if kind in DEBUGGERS:
            yield (LAUNCH, f"configurations[{position}].type"), DEBUGGERS[kind]

"""What is wrong with ``launch.json`` and ``tasks.json``: keys, types of debuggers, inputs and tasks named.

Sources: VS Code, "Debug configuration" and tasks.json's schema; manuals of debugpy (package.json of its
extension) and CodeLLDB.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.deploy.editor.findings import bad_entries, bad_keys, bad_variables, entries, fault, listed
from sfglab.documents import suggestion

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.fleet.border import Finding


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
_KEYS: dict[tuple[str, str], tuple[str, ...]] = {
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
    if kind not in _KEYS:
        allowed = ", ".join(" ".join(pair) for pair in _KEYS)
        yield fault(file, f"{key}.type", f"given {' '.join(kind)!r}, allowed: {allowed}")
        return
    yield from bad_keys(profile, file, key, known=(*_COMMON, *_KEYS[kind]), needed=("name",))
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

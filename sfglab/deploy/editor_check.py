"""Faults of the files that VS Code reads (as of 2026): their shapes, and what one place says of another."""

from __future__ import annotations

import json
import posixpath
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.deploy.compose_values import mounts
from sfglab.deploy.editor import DEBUGGERS
from sfglab.deploy.shapes import check_shape, read_json5
from sfglab.deploy.verdicts import Broken, Rules
from sfglab.documents import Document, DocumentError, Place
from sfglab.fleet.lint import Finding, Severity
from sfglab.validation import suggestion

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from sfglab.deploy.files import BundleFile
    from sfglab.errors import KeyPath

CONTAINER, LAUNCH, TASKS = (
    ".devcontainer/devcontainer.json",
    ".vscode/launch.json",
    ".vscode/tasks.json",
)
EXTENSIONS, SETTINGS = ".vscode/extensions.json", ".vscode/settings.json"
SHAPES = {
    CONTAINER: "devcontainer",
    EXTENSIONS: "vscode-extensions",
    LAUNCH: "vscode-launch",
    SETTINGS: "vscode-settings",
    TASKS: "vscode-tasks",
}
"""The shape of each file."""

_WHY = "VS Code passes over it, or shows an error"
_NO_START = "the container does not start"
_VARIABLE = re.compile(r"\$\{([^}]*)\}")
_VARIABLES = (
    "file",
    "fileDirname",
    "workspaceFolder",
    "localWorkspaceFolder",
    "containerWorkspaceFolder",
)
_PICKERS = ("pickMyProcess", "pickProcess")  # CodeLLDB's manual, "Pick Process Command"
_HOME = "${localWorkspaceFolder}/"


@dataclass(frozen=True, slots=True, kw_only=True)
class Editor:
    """The editor's files, each of the right shape, and the folder that they speak of."""

    container: dict[str, Any]
    recommended: list[str]
    profiles: list[dict[str, Any]]
    inputs: list[str]  #: Names of what the user is asked for.
    settings: dict[str, Any]
    tasks: list[dict[str, Any]]
    task_inputs: list[str]
    files: Mapping[str, BundleFile]

    @property
    def labels(self) -> list[str]:
        """What the tasks are called."""
        return [task["label"] for task in self.tasks]


#: What the files may say of each other; a place begins with its file.
RULES: Rules[Editor, KeyPath] = Rules()


def check_editor(files: Mapping[str, BundleFile]) -> tuple[Finding, ...]:
    """Return what is wrong with the development container and the settings of VS Code in an agent's folder.

    Raises:
        MissingProgramError: The library that reads JSON Schema is not installed.
    """
    documents = {name: _read(files, name) for name in SHAPES}
    findings = [found for found in documents.values() if isinstance(found, Finding)]
    read = {name: found for name, found in documents.items() if isinstance(found, Document)}
    findings += [
        finding
        for name, document in read.items()
        for finding in check_shape(document, SHAPES[name])
    ]
    if findings:  # what files say of each other is asked once all can be read
        return tuple(findings)
    values: dict[str, Any] = {name: document.value for name, document in read.items()}
    launch, tasks = values[LAUNCH], values[TASKS]
    editor = Editor(
        container=values[CONTAINER],
        recommended=values[EXTENSIONS].get("recommendations", []),
        profiles=launch["configurations"],
        inputs=[entry["id"] for entry in launch.get("inputs", ())],
        settings=values[SETTINGS],
        tasks=tasks["tasks"],
        task_inputs=[str(entry.get("id")) for entry in tasks.get("inputs", ())],
        files=files,
    )
    return tuple(RULES.broken(editor, lambda path: read[str(path[0])].place(path[1:])))


def _read(files: Mapping[str, BundleFile], name: str) -> Document | Finding:
    what = "there is no such file"
    try:
        if name in files:
            json.loads(files[name].text)  # stricter than what reads it with lines
            return read_json5(files[name].text, name)
    except (ValueError, DocumentError) as error:
        what = f"given what is no JSON ({error}), allowed: JSON without comments"
    return Finding(
        severity=Severity.ERROR, code="schema", place=Place(file=name), what=what, why=_WHY
    )


def _listed(value: Any) -> list[Any]:
    return value if isinstance(value, list) else [] if value is None else [value]


def _compose_files(editor: Editor) -> Iterator[tuple[str, str]]:
    """Yield Compose files as the container names them, and by their paths in the folder."""
    for name in _listed(editor.container["dockerComposeFile"]):
        yield name, posixpath.normpath(posixpath.join(posixpath.dirname(CONTAINER), name))


@RULES.add("missing-file", _NO_START)
def _missing_compose(editor: Editor) -> Iterator[Broken[KeyPath]]:
    for name, path in _compose_files(editor):
        if path not in editor.files:
            yield Broken((CONTAINER, "dockerComposeFile"), f"there is no file {name}")


@RULES.add("missing-service", _NO_START)
def _missing_service(editor: Editor) -> Iterator[Broken[KeyPath]]:
    targets = _targets(editor)
    for name in (editor.container["service"], *_listed(editor.container.get("runServices"))):
        if targets and name not in targets:
            yield Broken((CONTAINER, "service"), f"given {name!r}, allowed: {', '.join(targets)}")


@RULES.add("missing-mount", "VS Code finds no files there")
def _missing_mount(editor: Editor) -> Iterator[Broken[KeyPath]]:
    targets, folder = _targets(editor), editor.container["workspaceFolder"]
    for target in (folder, f"{folder}/.vscode") if targets else ():
        if target not in targets.get(editor.container["service"], ()):
            yield Broken((CONTAINER, "workspaceFolder"), f"nothing is mounted at {target}")


def _targets(editor: Editor) -> dict[str, list[str]]:
    """Return where each service of the Compose files has something mounted."""
    targets: dict[str, list[str]] = {}
    for _, path in _compose_files(editor):
        try:
            project = (
                Document(editor.files[path].text, path).value if path in editor.files else None
            )
        except DocumentError:  # said by the check of Compose files
            continue
        services = project.get("services") if isinstance(project, dict) else None
        for name, service in (services or {}).items():
            volumes = mounts(service) if isinstance(service, dict) else ()
            targets.setdefault(name, []).extend(volume.target for volume in volumes)
    return targets


@RULES.add("hook", _NO_START)
def _hook(editor: Editor) -> Iterator[Broken[KeyPath]]:
    """Find a hook that is not in the folder, or that nobody may run."""
    program = next(iter(editor.container.get("initializeCommand", ())), "")
    name = program.removeprefix(_HOME)
    if program.startswith(_HOME) and name not in editor.files:
        yield Broken((CONTAINER, "initializeCommand"), f"there is no file {name}")
    elif program.startswith(_HOME) and not editor.files[name].mode & 0o100:
        yield Broken((CONTAINER, "initializeCommand"), f"{name} is no program")


@RULES.add("variable", _WHY)
def _variables(editor: Editor) -> Iterator[Broken[KeyPath]]:
    """Find ``${...}`` that VS Code does not replace, and inputs that nobody defines."""
    yield from _unknown_variables((CONTAINER,), editor.container, [])
    for position, profile in enumerate(editor.profiles):
        yield from _unknown_variables((LAUNCH, "configurations", position), profile, editor.inputs)
    for position, task in enumerate(editor.tasks):
        # Words of a Bash script are Bash's: what it does not know VS Code leaves alone.
        yield from _unknown_variables(
            (TASKS, "tasks", position), task.get("options"), editor.task_inputs
        )


def _unknown_variables(path: KeyPath, value: Any, inputs: list[str]) -> Iterator[Broken[KeyPath]]:
    if isinstance(value, dict | list):
        for inner in value.values() if isinstance(value, dict) else value:
            yield from _unknown_variables(path, inner, inputs)
    for name in _VARIABLE.findall(value) if isinstance(value, str) else ():
        kind, _, rest = name.partition(":")
        allowed = {"input": inputs, "command": _PICKERS, "env": (rest,)}.get(kind, _VARIABLES)
        if (rest or kind) not in allowed:
            near = suggestion(rest or kind, allowed)
            yield Broken(path, f"given ${{{name}}}, allowed: {', '.join(allowed) or 'none'}{near}")


@RULES.add("twice", "VS Code takes one of them")
def _twice(editor: Editor) -> Iterator[Broken[KeyPath]]:
    profiles = [profile["name"] for profile in editor.profiles]
    names = {(LAUNCH, "configurations"): profiles, (LAUNCH, "inputs"): editor.inputs}
    names[TASKS, "tasks"] = editor.labels
    for path, listed in names.items():
        for position, name in enumerate(listed):
            if name in listed[:position]:
                yield Broken((*path, position), f"{name!r} stands there twice")


@RULES.add("missing-task", _WHY)
def _missing_task(editor: Editor) -> Iterator[Broken[KeyPath]]:
    for position, profile in enumerate(editor.profiles):
        yield from _no_task((LAUNCH, "configurations", position, "preLaunchTask"), profile, editor)
    for position, task in enumerate(editor.tasks):
        yield from _no_task((TASKS, "tasks", position, "dependsOn"), task, editor)


def _no_task(path: KeyPath, holder: dict[str, Any], editor: Editor) -> Iterator[Broken[KeyPath]]:
    for name in _listed(holder.get(str(path[-1]))):
        if name not in editor.labels:
            yield Broken(path, f"there is no task {name!r}{suggestion(name, editor.labels)}")


@RULES.add("missing-extension", _WHY)
def _missing_extension(editor: Editor) -> Iterator[Broken[KeyPath]]:
    needed: list[tuple[KeyPath, str]] = [
        ((SETTINGS, key, "editor.defaultFormatter"), str(value["editor.defaultFormatter"]))
        for key, value in editor.settings.items()
        if isinstance(value, dict) and "editor.defaultFormatter" in value
    ]
    for position, profile in enumerate(editor.profiles):
        needed.append(((LAUNCH, "configurations", position, "type"), DEBUGGERS[profile["type"]]))
    for path, extension in needed:
        if extension not in editor.recommended:
            yield Broken(
                path, f"needs the extension {extension}, which is not among those recommended"
            )

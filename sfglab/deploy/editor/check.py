"""What is wrong with the files that VS Code reads: keys, and everything that one place says of another.

Knows the formats as of 2026 (Dev Container specification; launch.json and tasks.json of VS Code; manuals of
debugpy and CodeLLDB); refuses to know settings of extensions, of which there are thousands.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.deploy.editor.check_container import check_container
from sfglab.deploy.editor.check_profiles import check_profiles, check_tasks
from sfglab.deploy.editor.findings import bad_extensions, entries, fault
from sfglab.deploy.editor.settings import DEBUGGERS

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from sfglab.deploy.files import BundleFile
    from sfglab.fleet.border import Finding


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

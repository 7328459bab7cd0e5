"""What is wrong with ``devcontainer.json``, alone and against the folder it stands in.

Source: devContainer.base.schema.json of the Dev Container specification (August 2026), Compose part.
"""

from __future__ import annotations

import posixpath
import re
from typing import TYPE_CHECKING, Any

from sfglab.deploy.editor.findings import bad_extensions, bad_keys, bad_variables, fault, listed, mapping_at
from sfglab.documents import Document, DocumentError

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator, Mapping

    from sfglab.deploy.files import BundleFile
    from sfglab.fleet.border import Finding


_NEEDED = ("name", "dockerComposeFile", "service", "workspaceFolder", "remoteUser")
_COMMANDS = (
    "initializeCommand",
    "onCreateCommand",
    "updateContentCommand",
    "postCreateCommand",
    "postStartCommand",
    "postAttachCommand",
)
_KEYS = (
    *(*_NEEDED, *_COMMANDS, "$schema", "runServices", "shutdownAction", "overrideCommand"),
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
    yield from bad_keys(settings, file, "", known=_KEYS, needed=_NEEDED)
    yield from bad_variables(settings, file, "", ())
    yield from _compose(settings, file, files)
    yield from _values(settings, file)
    for key in _COMMANDS:
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

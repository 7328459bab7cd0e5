"""Bundle of all files of one agent for its target host, and the release, whose name is derived from the files."""

from __future__ import annotations

import hashlib
import io
import json
import struct
import tarfile
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

from sfglab.deploy.compose import compose_files
from sfglab.deploy.dds_router import ROUTER_FILE, render_dds_router
from sfglab.deploy.deployment import Deployment, Release, deployment_of
from sfglab.deploy.dockerfile import image_files
from sfglab.deploy.editor import editor_files
from sfglab.deploy.errors import DeployError
from sfglab.deploy.files import PLAIN, PROGRAM, BundleFile, text_file
from sfglab.deploy.host import host_files
from sfglab.files import read_text, write_files
from sfglab.fleet.fleet_file import (
    Accelerator,
    Fleet,
    HostSpec,
    RouterSoftware,
    read_fleet,
)

#: Digests of a bundle's files; the last file of an archive.
MANIFEST = "manifest.json"

ENVIRONMENT = "release.env"  #: The release that Compose starts; the hooks make ``.env`` of it.


@dataclass(frozen=True, slots=True, kw_only=True)
class Bundle:
    """All files of one agent's release, to be installed on the agent's host."""

    agent: str  #: Name of the agent.
    tag: str  #: Name of the release, and tag of its image.
    image: str  #: The image that the release runs.
    members: dict[str, BundleFile]  #: Files by path within the agent's folder, the manifest last.


def render_bundle(deployment: Deployment) -> dict[str, BundleFile]:
    """Return the files of one agent that are made from a fleet file, without those that contain the release's name.

    Raises:
        DeployError: The agent cannot be deployed as it is described.
    """
    files = {**image_files(deployment), **compose_files(deployment)}
    if deployment.common.router is RouterSoftware.DDS_ROUTER:
        # The router reaches the agent at its own interface, which is not that of the agent's nodes.
        inside = deployment.router_interface
        name = deployment.agent.name
        text = render_dds_router(deployment.fleet, name, local_interface=inside)
        files[ROUTER_FILE] = text_file(text)
    return {**files, **host_files(deployment), **editor_files(deployment)}


def bundle_of(
    deployment: Deployment, wheel: bytes, workspace: Mapping[str, BundleFile] = MappingProxyType({})
) -> Bundle:
    """Return an agent's files on its machine, named as a release.

    Args:
        deployment: The agent on its machine.
        wheel: Content of sfglab's wheel.
        workspace: The user's sources, from `workspace_members`.

    Raises:
        DeployError: The agent cannot be deployed as it is described.
    """
    release = deployment.release
    members = render_bundle(deployment)
    members[f"image/{release.wheel}"] = BundleFile(data=wheel)
    members |= workspace
    digest = _sha256(json.dumps(_entries(members), sort_keys=True).encode())
    # A tag has no plus sign (OCI Distribution Specification 1.1).
    tag = f"{release.version.replace('+', '-')}-{digest[:12]}"
    image = f"{deployment.repository}:{tag}"
    members[ENVIRONMENT] = text_file(
        f"# The release that runs; its image has this tag.\nSFGLAB_TAG={tag}\n"
    )
    manifest = {
        "agent": deployment.agent.name,
        "fleet": deployment.fleet.name,
        "tag": tag,
        "image": image,
        "accelerator": deployment.accelerator.value,
        "version": release.version,
        "revision": release.revision,
        "files": _entries(members),
    }
    members[MANIFEST] = text_file(f"{json.dumps(manifest, indent=2)}\n")
    return Bundle(agent=deployment.agent.name, tag=tag, image=image, members=members)


def workspace_members(workspace: Path) -> dict[str, BundleFile]:
    """Return the sources below ``src`` of a colcon workspace, by path within an agent's folder.

    Hidden files and the results of colcon builds are left out.

    Raises:
        DeployError: There is no such folder.
    """
    sources = workspace / "src"
    if not sources.is_dir():
        raise DeployError(f"{workspace}: there is no folder src in it; give a colcon workspace")
    members = {}
    for path in sorted(path for path in sources.rglob("*") if path.is_file()):
        inside = path.relative_to(workspace)
        if any(part.startswith(".") for part in inside.parts):
            continue
        mode = PROGRAM if path.stat().st_mode & 0o100 else PLAIN
        members[f"workspace/{inside.as_posix()}"] = BundleFile(data=path.read_bytes(), mode=mode)
    return members


def write_bundle(bundle: Bundle, folder: Path) -> None:
    """Write all files of a bundle into a new or existing folder, or none.

    Raises:
        InvalidValueError: A file cannot be written; the folder is unchanged.
    """
    contents = {Path(path): member.data for path, member in bundle.members.items()}
    modes = {Path(path): member.mode for path, member in bundle.members.items()}
    write_files(contents, folder=folder, modes=modes)


def pack(bundle: Bundle) -> bytes:
    """Return a bundle as a tar archive; equal bundles give equal bytes."""
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w") as tar:
        for path, member in bundle.members.items():
            info = tarfile.TarInfo(path)
            info.size, info.mode = len(member.data), member.mode
            tar.addfile(info, io.BytesIO(member.data))
    return archive.getvalue()


_DAMAGED = (ValueError, LookupError, OSError, EOFError, OverflowError)


def unpack(archive: bytes) -> dict[str, BundleFile]:
    """Return a tar archive's files by path.

    Raises:
        DeployError: The archive is damaged, or a file leads out of its folder or claims more bytes than there are.
    """
    try:
        with tarfile.open(fileobj=io.BytesIO(archive), mode="r:") as tar:
            infos = {info.name.removeprefix("./"): info for info in tar if info.isfile()}
            _check(infos, len(archive))
            return {path: _read(tar, info) for path, info in infos.items()}
    except (*_DAMAGED, tarfile.TarError, struct.error) as error:
        raise DeployError(
            f"archive: it cannot be read ({error}); apply the fleet file again"
        ) from error


def _check(infos: Mapping[str, tarfile.TarInfo], size_bytes: int) -> None:
    for path, info in infos.items():
        size_bytes -= max(info.size, 0)
        if size_bytes < 0 or path.startswith("/") or ".." in path.split("/"):
            raise DeployError(
                f"entry {path!r} of {info.size} bytes is larger than the archive or outside its folder"
            )


def _read(tar: tarfile.TarFile, info: tarfile.TarInfo) -> BundleFile:
    file = tar.extractfile(info)
    return BundleFile(data=file.read() if file else b"", mode=info.mode & 0o777)


Choose = Callable[[HostSpec], "Accelerator | None"]
"""Function that returns the accelerator of a machine; None if it is not known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSource:
    """A fleet with the file that it was read from."""

    fleet: Fleet  #: The fleet.
    path: Path  #: Path of the fleet file; workspaces are relative to its folder.
    text: str  #: Text of the fleet file.


def load_source(path: Path) -> FleetSource:
    """Read a fleet file, and keep its text.

    Raises:
        InvalidValueError: The file cannot be read, or has a mistake.
    """
    text = read_text(path, "a fleet file in UTF-8")
    return FleetSource(fleet=read_fleet(text, str(path)), path=path, text=text)


def prepare(
    source: FleetSource,
    release: Release,
    wheel: bytes,
    *,
    agents: Sequence[str] = (),
    choose: Choose = lambda host: host.accelerator,
) -> tuple[tuple[Deployment, Bundle], ...]:
    """Return the deployment and the bundle of each agent.

    Args:
        source: The fleet and its file.
        release: Release that is deployed.
        wheel: Content of the release's wheel.
        agents: Names of the agents; empty for all agents.
        choose: Function that returns the accelerator of a host.

    Raises:
        DeployError: An agent cannot be deployed as it is described, or its machine cannot be reached.
        InvalidValueError: The fleet has no such agent.
    """
    pairs = []
    for name in agents or [agent.name for agent in source.fleet.agents]:
        host = source.fleet.agent(name).host
        accelerator = choose(host) if host is not None else None
        deployment = deployment_of(source.fleet, name, release, accelerator)
        folder = deployment.host.workspace
        workspace = workspace_members(source.path.parent / folder) if folder else {}
        pairs.append((deployment, bundle_of(deployment, wheel, workspace)))
    return tuple(pairs)


def _entries(members: Mapping[str, BundleFile]) -> dict[str, dict[str, str]]:
    entries = {}
    for path, member in sorted(members.items()):
        entries[path] = {"sha256": _sha256(member.data), "mode": f"{member.mode:o}"}
    return entries


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()

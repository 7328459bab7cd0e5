"""Bundle of all files of one agent's machine, a release named after them, and its making from a fleet file."""

from __future__ import annotations

import hashlib
import io
import json
import struct
import tarfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from sfglab.deploy.compose import compose_files
from sfglab.deploy.dds_router import ROUTER_FILE, render_dds_router
from sfglab.deploy.deployment import Deployment, Release, deployment_of
from sfglab.deploy.dockerfile import image_files
from sfglab.deploy.editor import editor_files
from sfglab.deploy.errors import DeployError
from sfglab.deploy.files import PLAIN, PROGRAM, BundleFile
from sfglab.deploy.host import host_files
from sfglab.files import read_text, write_files
from sfglab.fleet.fleet_file import (
    AUTO,
    Accelerator,
    AgentSpec,
    Fleet,
    HostSpec,
    RouterSoftware,
    read_fleet,
)
from sfglab.validation import suggestion

#: Digests of a bundle's files; the last file of an archive.
MANIFEST = "manifest.json"

ENVIRONMENT = "release.env"  #: The release that Compose starts; the hooks make ``.env`` of it.


@dataclass(frozen=True, slots=True, kw_only=True)
class Member:
    """A file as a machine has it."""

    data: bytes  #: Its bytes.
    mode: int  #: Its permissions.


@dataclass(frozen=True, slots=True, kw_only=True)
class Bundle:
    """An agent's files."""

    agent: str  #: The agent.
    tag: str  #: The release's name, and the tag of its image.
    image: str  #: The image that the release runs.
    members: dict[str, Member]  #: Files by path within the agent's folder, the manifest last.


def render_bundle(deployment: Deployment) -> dict[str, BundleFile]:
    """Return what is made from a fleet file for one agent, but for what names the release; or `DeployError`."""
    return {
        **image_files(deployment),
        **compose_files(deployment),
        **_router_files(deployment),
        **host_files(deployment),
        **editor_files(deployment),
    }


def bundle_of(
    deployment: Deployment, wheel: bytes, workspace: Mapping[str, Member] = MappingProxyType({})
) -> Bundle:
    """Return an agent's files on its machine, named as a release, with the bytes of sfglab's wheel.

    `workspace` has the user's sources, from `workspace_members`.

    Raises:
        DeployError: As `render_bundle` does.
    """
    release = deployment.release
    files = render_bundle(deployment)
    members = {
        path: Member(data=file.text.encode(), mode=file.mode) for path, file in files.items()
    }
    members |= {f"image/{release.wheel}": Member(data=wheel, mode=PLAIN), **workspace}
    digest = _sha256(json.dumps(_entries(members), sort_keys=True).encode())
    # A tag has no plus sign (OCI Distribution Specification 1.1).
    tag = f"{release.version.replace('+', '-')}-{digest[:12]}"
    image = f"{deployment.repository}:{tag}"
    text = f"# The release that runs; its image has this tag.\nSFGLAB_TAG={tag}\n"
    members[ENVIRONMENT] = Member(data=text.encode(), mode=PLAIN)
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
    members[MANIFEST] = Member(data=f"{json.dumps(manifest, indent=2)}\n".encode(), mode=PLAIN)
    return Bundle(agent=deployment.agent.name, tag=tag, image=image, members=members)


def workspace_members(workspace: Path) -> dict[str, Member]:
    """Return the sources below ``src`` of a colcon workspace, by path within an agent's folder.

    Hidden files and what colcon has built stay out.

    Raises:
        DeployError: There is no such folder.
    """
    sources = workspace / "src"
    if not sources.is_dir():
        raise DeployError(f"{workspace}: given no folder src, allowed: a colcon workspace")
    files = sorted(path for path in sources.rglob("*") if path.is_file())
    return {
        f"workspace/{path.relative_to(workspace).as_posix()}": Member(
            data=path.read_bytes(), mode=PROGRAM if path.stat().st_mode & 0o100 else PLAIN
        )
        for path in files
        if not any(part.startswith(".") for part in path.relative_to(sources).parts)
    }


def write_bundle(bundle: Bundle, folder: Path) -> None:
    """Write a bundle into a folder, new or old: all of it, or nothing and an `InvalidValueError`."""
    members = {Path(path): member for path, member in bundle.members.items()}
    write_files(
        {path: member.data for path, member in members.items()},
        folder=folder,
        modes={path: member.mode for path, member in members.items()},
    )


def pack(bundle: Bundle) -> bytes:
    """Return a bundle as a tar archive; equal bundles give equal bytes."""
    archive = io.BytesIO()
    with tarfile.open(fileobj=archive, mode="w") as tar:
        for path, member in bundle.members.items():
            info = tarfile.TarInfo(path)
            info.size, info.mode = len(member.data), member.mode
            tar.addfile(info, io.BytesIO(member.data))
    return archive.getvalue()


def unpack(archive: bytes) -> dict[str, Member]:
    """Return a tar archive's files by path; `DeployError` if one leads out of its folder or claims too much."""
    try:
        with tarfile.open(fileobj=io.BytesIO(archive), mode="r:") as tar:
            return dict(_members_of(tar, len(archive)))
    except DeployError:
        raise
    except (
        tarfile.TarError,
        ValueError,
        LookupError,
        OSError,
        EOFError,
        OverflowError,
        struct.error,
    ) as error:
        raise DeployError(f"not a whole tar archive: {error}") from error


def _members_of(tar: tarfile.TarFile, left: int) -> Iterator[tuple[str, Member]]:
    for info in filter(tarfile.TarInfo.isfile, tar):
        path, left = info.name.removeprefix("./"), left - max(info.size, 0)
        if left < 0 or path.startswith("/") or ".." in path.split("/"):
            raise DeployError(
                f"archive: given {path!r} of {info.size} bytes, allowed: no more than the archive holds, below its folder"
            )
        file = tar.extractfile(info)
        yield path, Member(data=file.read() if file else b"", mode=info.mode & 0o777)


Detect = Callable[["HostSpec"], "Accelerator | None"]
"""Asked for the accelerator of a machine whose fleet file leaves it to detection."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetSource:
    """A fleet and where it was read."""

    fleet: Fleet  #: The fleet.
    path: Path  #: Its file.
    text: str  #: Text of the file.

    @property
    def folder(self) -> Path:
        """Where the file stands; workspaces are named relative to it."""
        return self.path.parent


def load_source(path: Path) -> FleetSource:
    """Read a fleet file; an `InvalidValueError` says why it cannot be read, or is not a fleet."""
    text = read_text(path, "a fleet file in UTF-8")
    return FleetSource(fleet=read_fleet(text, str(path)), path=path, text=text)


def with_accelerator(source: FleetSource, agents: Sequence[str], name: str) -> FleetSource:
    """Return a fleet whose agents, none: all, have an accelerator, or ``auto``; or raise `DeployError`."""
    known = (AUTO, *(member.value for member in Accelerator))
    if name not in known:
        raise DeployError(
            f"accelerator: given {name!r}, allowed: {', '.join(known)}{suggestion(name, known)}"
        )
    accelerator = None if name == AUTO else Accelerator(name)

    def changed(agent: AgentSpec) -> AgentSpec:
        if agent.host is None or (agents and agent.name not in agents):
            return agent
        return replace(agent, host=replace(agent.host, accelerator=accelerator))

    return replace(
        source, fleet=replace(source.fleet, agents=tuple(map(changed, source.fleet.agents)))
    )


def prepare(
    source: FleetSource,
    release: Release,
    wheel: bytes,
    *,
    agents: Sequence[str] = (),
    detect: Detect = lambda _: None,
) -> tuple[tuple[Deployment, Bundle], ...]:
    """Return deployment and bundle of agents by their names, none: of all.

    The release is what is deployed, with the bytes of its wheel.

    Raises:
        DeployError: An agent cannot be deployed as it is described.
        InvalidValueError: The fleet has no such agent.
    """
    names = agents or [agent.name for agent in source.fleet.agents]
    pairs = []
    for deployment in (describe(source, name, release, detect) for name in names):
        folder = deployment.host.workspace
        workspace = workspace_members(source.folder / folder) if folder else {}
        pairs.append((deployment, bundle_of(deployment, wheel, workspace)))
    return tuple(pairs)


def describe(source: FleetSource, agent: str, release: Release, detect: Detect) -> Deployment:
    """Return one agent's deployment, with what detection says where the fleet file leaves it open.

    Raises:
        DeployError: It cannot be deployed as it is described, or its machine cannot be reached.
        InvalidValueError: The fleet has no such agent.
    """
    host = source.fleet.agent(agent).host
    detected = detect(host) if host is not None and host.accelerator is None else None
    return deployment_of(source.fleet, agent, release, detected=detected)


def _router_files(deployment: Deployment) -> dict[str, BundleFile]:
    """Return a DDS Router's file; our own router reads the fleet file."""
    if deployment.common.router is not RouterSoftware.DDS_ROUTER:
        return {}
    # The router meets the agent at its own interface, which is not that of the agent's nodes.
    agent = replace(deployment.agent, local_interface=deployment.network.router_interface)
    agents = tuple(agent if one.name == agent.name else one for one in deployment.fleet.agents)
    fleet = replace(deployment.fleet, agents=agents)
    return {ROUTER_FILE: BundleFile(text=render_dds_router(fleet, agent.name))}


def _entries(members: Mapping[str, Member]) -> dict[str, dict[str, str]]:
    return {
        path: {"sha256": _sha256(member.data), "mode": f"{member.mode:o}"}
        for path, member in sorted(members.items())
    }


def _sha256(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()

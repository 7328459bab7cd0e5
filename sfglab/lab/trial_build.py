"""A real build of an agent's images from a base image made here, and questions to what comes out.

What no machine can be relied on to reach is left out and said: ROS 2's packages and the makers' base images.
So a trial builds the agent without ROS 2 and accelerator, for this machine's processor, on a Debian made by
debootstrap, with Python packages from wheels fetched beforehand. All that it makes lies in one folder.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab import __version__
from sfglab.deploy.bases import base_of
from sfglab.deploy.bundle import bundle_of
from sfglab.deploy.deployment import USER_ID, Deployment
from sfglab.deploy.dockerfile import VENV, image_files
from sfglab.deploy.errors import DeployError
from sfglab.deploy.programs import run_heard
from sfglab.deploy.release import MACHINES
from sfglab.fleet.fleet_file import Accelerator, Architecture, RosDistribution
from sfglab.lab.checks.machines import Unasked, held

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from sfglab.lab.checks import CheckRow

_GLIBC_MINORS = (17, 24, 26, 27, 28, 31, 34, 35)
"""Wheels for these versions of glibc 2 and older run on all our bases: the oldest, Ubuntu 22.04, has 2.35."""


def wheelhouse(
    lock: str, folder: Path, python: str, architecture: Architecture
) -> tuple[Path, ...]:
    """Fetch a lock file's wheels for another machine, each by its digest, or raise `DeployError`."""
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="sfglab-lock-") as scratch:
        file = Path(scratch) / "requirements.lock"
        file.write_text(lock, encoding="utf-8")
        machine = MACHINES[architecture]
        platforms = [f"manylinux_2_{minor}_{machine}" for minor in _GLIBC_MINORS]
        command = [
            *(sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check"),
            *("--no-deps", "--require-hashes", "--only-binary=:all:", f"--python-version={python}"),
            "--implementation=cp",
            *(f"--platform={platform}" for platform in (*platforms, f"manylinux2014_{machine}")),
            *(f"--dest={folder}", f"--requirement={file}"),
        ]
        fetched = subprocess.run(command, capture_output=True, text=True, check=False)
    if fetched.returncode != 0:
        said = [line for line in fetched.stderr.splitlines() if line.startswith("ERROR")] or [
            "nothing"
        ]
        raise DeployError(
            f"wheels for Python {python} on {architecture.value}: pip said {said[0]!r}"
        )
    return tuple(sorted(folder.glob("*.whl")))


_NAME = "sfglab"


def with_version(wheel: Path, folder: Path, version: str) -> Path:
    """Write a copy of sfglab's wheel that says another version of itself, and return where it is.

    Digests in its RECORD are left out, as the format allows for none but those that are known (PEP 427).

    Raises:
        DeployError: It is no wheel of this sfglab.
    """
    was, new = f"{_NAME}-{__version__}", f"{_NAME}-{version}"
    if not wheel.name.startswith(f"{was}-"):
        raise DeployError(f"{wheel}: given a wheel of another release, allowed: {was}")
    folder.mkdir(parents=True, exist_ok=True)
    target = folder / wheel.name.replace(was, new, 1)
    with (
        zipfile.ZipFile(wheel) as source,
        zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as copy,
    ):
        for info in source.infolist():
            data = source.read(info)
            path = info.filename.replace(f"{was}.dist-info", f"{new}.dist-info")
            if path == f"{_NAME}/__init__.py":
                data = data.replace(f'"{__version__}"'.encode(), f'"{version}"'.encode())
            elif path.endswith(".dist-info/METADATA"):
                old, other = (f"\nVersion: {one}\n".encode() for one in (__version__, version))
                data = data.replace(old, other, 1)
            elif path.endswith(".dist-info/RECORD"):
                data = _record(data.decode(), was, new).encode()
            copy.writestr(zipfile.ZipInfo(path, date_time=info.date_time), data)
    return target


def _record(text: str, was: str, new: str) -> str:
    paths = (line.split(",", 1)[0] for line in text.splitlines())
    return "".join(f"{path.replace(f'{was}.dist-info', f'{new}.dist-info')},,\n" for path in paths)


TOOLS = ("buildah", "debootstrap")
BASE = "localhost/sfglab-trial-base:bookworm"
_ARCHIVE = "root.tar"
_DEBS = "./var/cache/apt/archives/*.deb"
_ENTRYPOINT = "/usr/local/bin/sfglab-entrypoint"
_CACHED = "--> Using cache"


@dataclass(frozen=True, slots=True, kw_only=True)
class _Workshop:
    """A builder with its own store, apart from the machine's."""

    folder: Path  #: Where everything lies.
    say: Callable[[str], None]  #: Told what the builder says.
    driver: str = "overlay"  #: How the store keeps layers.

    def command(self, *arguments: str) -> list[str]:
        """Return a buildah command on the store."""
        store = ("--root", str(self.folder / "store"), "--runroot", str(self.folder / "run"))
        return ["buildah", "--storage-driver", self.driver, *store, *arguments]

    def build(self, command: list[str]) -> list[str]:
        """Run a command of `build_command` on the store; return what it said."""
        said: list[str] = []

        def hear(line: str) -> None:
            said.append(line)
            self.say(line)

        _, verb, *arguments = command
        run_heard(self.command(verb, "--isolation=chroot", *arguments), hear)
        return said

    def ask(self, *arguments: str) -> subprocess.CompletedProcess[str]:
        """Run a buildah command on the store."""
        return subprocess.run(self.command(*arguments), capture_output=True, text=True, check=False)

    def close(self) -> None:
        """Take away all that was made: containers, images, mounts of a build that was cut off, files."""
        self.ask("rm", "--all")
        self.ask("rmi", "--all", "--force")
        mounted = [line.split()[1] for line in Path("/proc/self/mounts").read_text().splitlines()]
        for point in reversed(mounted):
            if Path(point).is_relative_to(self.folder.resolve()):
                subprocess.run(["umount", "--lazy", point], capture_output=True, check=False)
        shutil.rmtree(self.folder, ignore_errors=True)

    def run(self, image: str, *program: str, user: str = "") -> tuple[int, str]:
        """Run a program in a new container of an image, as its own user or another; return status and words."""
        container = self.ask("from", "--pull-never", image).stdout.strip()
        who = (f"--user={user}",) if user else ()
        try:
            done = self.ask("run", "--isolation=chroot", *who, container, "--", *program)
        finally:
            self.ask("rm", container)
        return done.returncode, (done.stdout + done.stderr).strip()


def why_not() -> str:
    """Return why no trial can run on this machine; empty if one can."""
    missing = [tool for tool in TOOLS if shutil.which(tool) is None]
    if missing:
        return f"{', '.join(missing)} not installed (apt install {' '.join(TOOLS)})"
    return "" if os.geteuid() == 0 else "needs root, for debootstrap and chroot"


def trial_build(
    deployment: Deployment,
    wheel: Path,
    folder: Path,
    say: Callable[[str], None],
    *,
    cache: Path | None = None,
) -> tuple[CheckRow | Unasked, ...]:
    """Build an agent's images twice, ask them what a robot would, and take all of it away again.

    The wheel is that of its release; base and wheels stay in the cache for the next trial, if there is one.
    Raises `DeployError` if a tool failed where nothing but the machine can be the cause.
    """
    reason = why_not()
    if reason:
        return (Unasked(check="the images build", why=reason),)
    shop = _open_workshop(folder / "trial", say)
    kept = cache or shop.folder / "kept"
    first = _reachable(deployment)
    try:
        _make_base(shop, kept, first)
        return tuple(_checks(shop, kept, first, wheel))
    finally:
        shop.close()


def _open_workshop(folder: Path, say: Callable[[str], None]) -> _Workshop:
    """Return a workshop; layers are copies (vfs) only where the folder's file system cannot be laid over."""
    shop = _Workshop(folder=folder, say=say)
    if shop.ask("info").returncode == 0:
        return shop
    shutil.rmtree(folder, ignore_errors=True)
    return replace(shop, driver="vfs")


def _reachable(deployment: Deployment) -> Deployment:
    """Return the deployment without what a trial leaves out."""
    machine = platform.machine()
    architecture = next((known for known, name in MACHINES.items() if name == machine), None)
    if architecture is None:
        raise DeployError(
            f"trial: given a {machine!r} processor, allowed: {', '.join(MACHINES.values())}"
        )
    return replace(
        deployment,
        fleet=replace(
            deployment.fleet, deployment=replace(deployment.common, ros=RosDistribution.NONE)
        ),
        host=replace(deployment.host, architecture=architecture, workspace="", packages=()),
        accelerator=Accelerator.NONE,
    )


def _make_base(shop: _Workshop, kept: Path, deployment: Deployment) -> None:
    """Make the base image, from the root file system of an earlier trial if there is one."""
    context = shop.folder / "base"
    context.mkdir(parents=True, exist_ok=True)
    kept.mkdir(parents=True, exist_ok=True)
    archive = kept / _ARCHIVE
    if not archive.is_file():
        base = base_of(deployment)
        packages = (
            "ca-certificates",
            "ffmpeg",
            *base.python_packages,
        )  # so that the adapter needs no apt
        root = shop.folder / "root"
        wanted = f"--include={','.join(packages)}"
        run_heard(
            ["debootstrap", "--variant=minbase", wanted, base.distribution.value, str(root)],
            shop.say,
        )
        partial = kept / f"{_ARCHIVE}.part"
        run_heard(
            ["tar", "-C", str(root), f"--exclude={_DEBS}", "-cf", str(partial), "."], shop.say
        )
        partial.replace(archive)
        shutil.rmtree(root)
    shutil.copy(archive, context / _ARCHIVE)
    (context / "Dockerfile").write_text(f"FROM scratch\nADD {_ARCHIVE} /\n", encoding="utf-8")
    shop.build(["buildah", "build", f"--tag={BASE}", str(context)])
    shutil.rmtree(context)


def _checks(shop: _Workshop, kept: Path, first: Deployment, wheel: Path) -> Iterator[CheckRow]:
    folder = _write(shop.folder / "first", first, wheel, kept)
    image, said = _built(shop, folder, first)
    yield _check("the images build without a package index", True, f"{len(said)} lines said")
    yield from _ask_image(shop, image, first)
    same, said = _built(shop, folder, first)
    fresh = _fresh_steps(said)
    yield _check("a second build makes no layer", same == image and not fresh, ", ".join(fresh))

    second, newer = _next_release(first, wheel, shop.folder / "newer")
    other, said = _built(shop, _write(shop.folder / "second", second, newer, kept), second)
    fresh = [step for step in _fresh_steps(said) if step.startswith(("COPY", "RUN"))]
    yield _check(
        "a new wheel makes one new layer", len(fresh) == 1, "; ".join(step[:60] for step in fresh)
    )
    for name, deployment in ((other, second), (image, first)):
        _, words = shop.run(name, _ENTRYPOINT, "--version")
        version = deployment.release.version
        yield _check(
            "of two versions side by side, each says its own", words == version, f"{name}: {words}"
        )


def _next_release(deployment: Deployment, wheel: Path, folder: Path) -> tuple[Deployment, Path]:
    """Return the same agent with a later version of the same wheel, and that wheel."""
    version = f"{deployment.release.version}.post1"
    newer = with_version(wheel, folder, version)
    digest = hashlib.sha256(newer.read_bytes()).hexdigest()
    release = replace(deployment.release, version=version, wheel=newer.name, wheel_sha256=digest)
    return replace(deployment, release=release), newer


def _ask_image(shop: _Workshop, image: str, deployment: Deployment) -> Iterator[CheckRow]:
    inspected = json.loads(shop.ask("inspect", "--type", "image", image).stdout)
    labels = inspected["OCIv1"]["config"].get("Labels") or {}
    mine = {
        "io.sfglab.agent": deployment.agent.name,
        "io.sfglab.wheel.sha256": deployment.release.wheel_sha256,
        "org.opencontainers.image.version": deployment.release.version,
    }
    yield _check(
        "it says what it is made of", mine.items() <= labels.items(), f"{len(labels)} labels"
    )
    status, words = shop.run(image, "id", "-u")
    yield _check("it runs as nobody special", (status, words) == (0, str(USER_ID)), words)
    for arguments in (("--version",), ("agent", "up", "--help"), ("router", "--help")):
        status, words = shop.run(image, _ENTRYPOINT, *arguments)
        yield _check(
            f"`sfglab {' '.join(arguments)}` answers", status == 0, words.partition("\n")[0]
        )
    status, words = shop.run(image, "touch", f"{VENV}/written")
    denied = status != 0 and "denied" in words
    yield _check("its user cannot change what it runs", denied, words.partition("\n")[0])
    search = ("find", "/root", "/home", "/var/cache", "-name", "*.whl", "-o", "-path", "*/pip/*")
    status, words = shop.run(image, *search, user="0:0")
    yield _check("no downloads are left in it", (status, words) == (0, ""), words)


def build_command(folder: Path, deployment: Deployment, image: str) -> list[str]:
    """Return the command that builds an agent's application image on the trial's base, without an index."""
    return [
        *("buildah", "build", "--layers", f"--platform=linux/{deployment.host.architecture.value}"),
        *(
            "--target=application",
            f"--tag={image}",
            f"--build-arg=BASE_IMAGE={BASE}",
            "--build-arg=OFFLINE=1",
        ),
        *(f"--file={folder / 'Dockerfile'}", str(folder)),
    ]


def _built(shop: _Workshop, folder: Path, deployment: Deployment) -> tuple[str, list[str]]:
    """Build an agent's application image; return its name with its identity, and what the builder said."""
    image = bundle_of(deployment, (folder / "image" / deployment.release.wheel).read_bytes()).image
    return image, shop.build(build_command(folder, deployment, image))


def _write(folder: Path, deployment: Deployment, wheel: Path, kept: Path) -> Path:
    """Write what an agent's images are built from, with the wheels that they need."""
    for path, file in image_files(deployment).items():
        target = folder / path
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_text(file.text, encoding="utf-8")
        target.chmod(file.mode)
    shutil.copy(wheel, folder / "image" / deployment.release.wheel)
    lock = (folder / "image" / "requirements.lock").read_text(encoding="utf-8")
    for fetched in wheelhouse(
        lock, kept / "wheels", base_of(deployment).python, deployment.host.architecture
    ):
        shutil.copy(fetched, folder / "image" / "wheels")
    return folder


def _fresh_steps(said: list[str]) -> list[str]:
    """Return the steps that were carried out, not taken from the cache."""
    fresh: list[str] = []
    for line in said:
        _, found, step = line.partition(": ")
        if "STEP " in line and found and step.split()[0] != "FROM":
            fresh.append(step)
        elif _CACHED in line and fresh:
            fresh.pop()
    return fresh


def _check(check: str, holds: bool, seen: str) -> CheckRow:  # noqa: FBT001 - it is the answer
    return held(check, [(seen, holds)])

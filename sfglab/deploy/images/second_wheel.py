"""The same wheel under another version, to have two releases side by side."""

from __future__ import annotations

import zipfile
from typing import TYPE_CHECKING

from sfglab import __version__
from sfglab.deploy.errors import DeployError

if TYPE_CHECKING:
    from pathlib import Path


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
    with zipfile.ZipFile(wheel) as source, zipfile.ZipFile(target, "w", zipfile.ZIP_DEFLATED) as copy:
        for info in source.infolist():
            data = source.read(info)
            path = info.filename.replace(f"{was}.dist-info", f"{new}.dist-info")
            if path == f"{_NAME}/__init__.py":
                data = data.replace(f'"{__version__}"'.encode(), f'"{version}"'.encode())
            elif path.endswith(".dist-info/METADATA"):
                data = data.replace(
                    f"\nVersion: {__version__}\n".encode(), f"\nVersion: {version}\n".encode(), 1
                )
            elif path.endswith(".dist-info/RECORD"):
                data = _record(data.decode(), was, new).encode()
            copy.writestr(zipfile.ZipInfo(path, date_time=info.date_time), data)
    return target


def _record(text: str, was: str, new: str) -> str:
    paths = [
        line.split(",", 1)[0].replace(f"{was}.dist-info", f"{new}.dist-info") for line in text.splitlines()
    ]
    return "".join(f"{path},,\n" for path in paths)

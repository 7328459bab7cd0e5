"""Reading and writing of whole files; errors of the file system become an `InvalidValueError`."""

from __future__ import annotations

import os
import secrets
from contextlib import ExitStack, suppress
from errno import EISDIR
from pathlib import Path
from tempfile import gettempdir
from typing import TYPE_CHECKING

from sfglab.errors import InvalidValueError

if TYPE_CHECKING:
    from collections.abc import Mapping

_MOST_BYTES = 1 << 26  # of a text; a device may have no end


def read_text(path: Path, allowed: str = "a readable text file") -> str:
    """Return the text of a UTF-8 file.

    Args:
        path: Path of the file.
        allowed: Description of the expected file in errors.

    Raises:
        InvalidValueError: The file cannot be read, is larger than 64 MiB, or is not UTF-8.
    """
    try:
        with path.open("rb") as file:
            data = file.read(_MOST_BYTES + 1)
        if len(data) > _MOST_BYTES:
            raise InvalidValueError(path, f"more than {_MOST_BYTES} bytes", allowed)
        return data.decode("utf-8").replace("\r\n", "\n").replace("\r", "\n")
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidValueError(path, error, allowed) from error


def write_files(
    files: Mapping[Path, str | bytes],
    *,
    folder: Path | None = None,
    modes: Mapping[Path, int] | None = None,
) -> None:
    """Write all files or none. At any moment each path has its old or its new file.

    The contents are first written to temporary files beside the paths. These then get the names and permissions of the
    old files. Symbolic links stay links. A path that is no file, such as ``/dev/stdout``, is written directly.

    Args:
        files: Contents by path.
        folder: Folder of the files, to which paths are relative. Missing folders are made.
        modes: Permissions, by path.

    Raises:
        InvalidValueError: A file cannot be written; no file has changed.
    """
    staged: list[tuple[Path, Path]] = []
    with ExitStack() as undo:
        target = Path()
        try:
            for path, content in files.items():
                target = path if folder is None else folder / path
                data = content.encode() if isinstance(content, str) else content
                if folder is not None:
                    _make_folder(target.parent, undo)
                if target.exists() and not target.is_file() and not target.is_dir():
                    target.write_bytes(data)
                    continue
                staged.append(_stage(target, data, (modes or {}).get(path), undo))
            for part, target in staged:
                part.replace(target)
        except (OSError, ValueError) as error:
            raise InvalidValueError(target, error, "a file that can be written") from error
        undo.pop_all()
    for parent in {target.parent for _, target in staged}:
        _sync_folder(parent)


def _make_folder(folder: Path, undo: ExitStack) -> None:
    for parent in (*reversed(folder.parents), folder):
        if not parent.exists():
            undo.callback(_remove, parent)
    folder.mkdir(parents=True, exist_ok=True)


def _remove(folder: Path) -> None:
    with suppress(OSError):  # not made, or no longer empty
        folder.rmdir()


def _stage(path: Path, data: bytes, mode: int | None, undo: ExitStack) -> tuple[Path, Path]:
    """Write a temporary file beside its target; return both paths."""
    target = Path(os.path.realpath(path))
    if target.is_dir():
        raise IsADirectoryError(EISDIR, os.strerror(EISDIR))
    part = target.with_name(f".{target.name[:100]}.{secrets.token_hex(4)}.part")
    if mode is None and target.exists():
        mode = target.stat().st_mode & 0o7777
    with part.open("xb") as file:
        undo.callback(part.unlink, missing_ok=True)
        if mode is not None:
            part.chmod(mode)  # before it has content, because others must not read keys
        file.write(data)
        file.flush()
        os.fsync(file.fileno())
    return part, target


def _sync_folder(folder: Path) -> None:
    """Write new names to the disk; file systems that cannot sync folders do this by themselves."""
    with suppress(OSError):
        handle = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(handle)
        finally:
            os.close(handle)


def own_folder() -> Path:
    """Return a folder that belongs to this user only: in the home folder, or else in the folder of temporary files.

    Raises:
        InvalidValueError: There is no home folder, and other users have access to the folder that replaces it.
    """
    with suppress(OSError, RuntimeError):
        folder = Path.home() / ".cache" / "sfglab"
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        if os.access(folder, os.W_OK):
            return folder
    folder = Path(gettempdir()) / f"sfglab-{os.getuid()}"
    folder.mkdir(mode=0o700, exist_ok=True)
    if folder.lstat().st_uid != os.getuid() or folder.lstat().st_mode & 0o77:
        given = f"{folder}, which other users can open"
        raise InvalidValueError("folder for locks", given, "a folder that only this user can open")
    return folder

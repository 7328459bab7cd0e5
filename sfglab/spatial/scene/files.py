"""Scene files: loaded whole, saved whole or not at all."""

from __future__ import annotations

import os
import secrets
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.spatial.scene.errors import SceneError
from sfglab.spatial.scene.reading import read_scene
from sfglab.spatial.scene.writing import scene_text

if TYPE_CHECKING:
    from sfglab.spatial.scene.tree import Scene


def load_scene(path: Path) -> Scene:
    """Read a scene from a file.

    Args:
        path: A YAML file, such as ``data/scenes/hall.yaml``.

    Raises:
        SceneError: It cannot be read, or does not say what it must; says where.
    """
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SceneError(path.name, str(error), "a readable text file") from error
    return read_scene(text, file=path.name)


def save_scene(scene: Scene, path: Path) -> None:
    """Write a scene into a file; at any moment the file holds either the old scene or the new one.

    The text goes into a file beside it, onto the disk, and only then takes the old one's name and permissions.

    Args:
        scene: What to write.
        path: Where; through a symbolic link, into the file that it leads to.

    Raises:
        SceneError: The file cannot be written; what was there is still there.
    """
    text = scene_text(scene)
    target = Path(os.path.realpath(path))
    try:
        _replace(target, text.encode("utf-8"))
    except OSError as error:
        raise SceneError(path.name, str(error), "a file that can be written") from error


def _replace(target: Path, content: bytes) -> None:
    part = target.with_name(f".{target.name}.{secrets.token_hex(4)}.part")
    try:
        with part.open("xb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        if target.exists():
            part.chmod(target.stat().st_mode & 0o7777)
        part.replace(target)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    _sync_folder(target.parent)


def _sync_folder(folder: Path) -> None:
    """Bring the new name onto the disk; file systems that cannot sync folders do so by themselves."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    except OSError:
        return
    finally:
        os.close(handle)

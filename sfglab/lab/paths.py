"""Folders of the project; no other module determines them.

The root is the folder with ``notebooks/`` and ``data/claims.yaml``. It is the folder in ``SFGLAB_ROOT``,
otherwise the nearest such folder above the working directory, otherwise the folder from which this package
was installed.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from sfglab.errors import InvalidValueError, SfglabError

_MARK = Path("data") / "claims.yaml"


@dataclass(frozen=True, slots=True, kw_only=True)
class Project:
    """Folders of a checkout."""

    root: Path  #: The top folder.

    @property
    def data(self) -> Path:
        """Folder of small inputs: the claims, fleets, reference logs."""
        return self.root / "data"

    @property
    def claims(self) -> Path:
        """Path of the file with the papers' claims."""
        return self.root / _MARK

    @property
    def reference_logs(self) -> Path:
        """Folder of the committed logs, from which figures can be drawn in a fresh clone."""
        return self.data / "reference"

    @property
    def notebooks(self) -> Path:
        """Folder of the executed notebooks."""
        return self.root / "notebooks"

    @property
    def figures(self) -> Path:
        """Folder of the generated figures and their sidecars."""
        return self.root / "figures"

    @property
    def runs(self) -> Path:
        """Folder of the output of runs: logs and executed notebooks; it is not under version control."""
        return self.root / "runs"

    @property
    def tries(self) -> Path:
        """Folder of the runs of ``sfglab try``, with one folder for each run."""
        return self.runs / "try"

    def relative(self, path: Path) -> str:
        """Return a path relative to the root, or only its name if it is outside."""
        for root, file in (
            (self.root.absolute(), path.absolute()),
            (self.root.resolve(), path.resolve()),
        ):
            if file.is_relative_to(root):
                return file.relative_to(root).as_posix()
        return path.name


def find_project() -> Project:
    """Return the checkout: the folder in ``SFGLAB_ROOT``, or the nearest one above the working directory.

    If there is none, it is the folder from which this package was installed.

    Raises:
        InvalidValueError: ``SFGLAB_ROOT`` is no checkout.
        SfglabError: There is no checkout.
    """
    named = os.environ.get("SFGLAB_ROOT")
    if named:
        if not (Path(named) / _MARK).is_file():
            raise InvalidValueError("SFGLAB_ROOT", named, f"a folder that holds {_MARK.as_posix()}")
        return Project(root=Path(named))
    here = Path.cwd().resolve()
    for folder in (here, *here.parents, Path(__file__).resolve().parents[2]):
        if (folder / _MARK).is_file():
            return Project(root=folder)
    raise SfglabError(
        f"no folder with {_MARK.as_posix()} here or above: change into a clone of sfglab, "
        "or set SFGLAB_ROOT to one"
    )

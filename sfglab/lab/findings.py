"""Findings kept from one call to the next: what a log gave, under the hash of all that it hangs on.

That is the log, the claims file and the other small inputs, every file of the package, and the versions of
Python and of the libraries that compute. A change of any of them is another hash, so that nothing goes stale;
verdicts are judged anew each time. Files lie in ``runs/cache``, which is not committed; a broken one, or one of
another hash, is as none.
"""

from __future__ import annotations

import hashlib
import json
import sys
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.errors import SfglabError
from sfglab.fields import from_json, to_json
from sfglab.lab.claims import Measured  # noqa: TC001 - fields are typed at run time
from sfglab.lab.sweep.journal import code_digest
from sfglab.record.metadata import library_versions

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from sfglab.lab.paths import Project


@dataclass(frozen=True, slots=True, kw_only=True)
class Findings:
    """What one log gives."""

    measured: dict[str, Measured]  #: Our figures, by claim.
    origin: str  #: Machine, load while measured, versions and commit, as far as the log has them.


@dataclass(frozen=True, slots=True)
class Kept:
    """The findings of a project's logs that are kept."""

    project: Project  #: Whose logs.
    basis: bytes  #: Hash of everything but the log.

    def of(self, log: Path, make: Callable[[], Findings]) -> Findings:
        """Return the findings from a log: those that are kept, else `make`'s, kept from then on."""
        file = self.project.runs / "cache" / f"{log.stem}.json"
        key = hashlib.sha256(self.basis + log.read_bytes()).hexdigest()
        with suppress(OSError, ValueError, LookupError, TypeError, AttributeError, SfglabError):
            kept = json.loads(file.read_text())
            if kept["key"] == key and kept["sum"] == _sum(kept["findings"]):
                found: Findings = from_json(Findings, json.loads(kept["findings"]))
                return found
        found = make()
        with suppress(OSError):  # a folder that cannot be written costs time only
            file.parent.mkdir(parents=True, exist_ok=True)
            part = file.with_suffix(".part")
            text = json.dumps(to_json(found))
            part.write_text(json.dumps({"key": key, "sum": _sum(text), "findings": text}))
            part.replace(file)
        return found


def _sum(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def kept_findings(project: Project) -> Kept:
    """Return the findings that a project keeps, for the code and the inputs as they are now."""
    digest = hashlib.sha256(f"{sys.version}\n{code_digest()}\n{library_versions()}\n".encode())
    for file in sorted(project.data.rglob("*")):
        if file.is_file() and project.reference_logs not in file.parents:
            digest.update(f"{file.relative_to(project.data)}\n".encode())
            digest.update(hashlib.sha256(file.read_bytes()).digest())
    return Kept(project, digest.digest())

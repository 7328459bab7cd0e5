"""A quicker import of jsonschema, on which nbformat, papermill and altair depend.

jsonschema imports rfc3987-syntax where it is installed, and JupyterLab installs it. That package compiles 38
grammars when it is imported, which takes 2.5 s of CPU time in each process. They check whether a text is an IRI
(RFC 3987), which the schemas of notebooks and charts do not ask for.
"""

from __future__ import annotations

import sys
from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator

_PACKAGE = "rfc3987_syntax"


@contextmanager
def without_iri_grammars() -> Iterator[None]:
    """Prevent the import of rfc3987-syntax within a context, as if the package were not installed."""
    if _PACKAGE in sys.modules:
        yield
        return
    # If `sys.modules` has None for a module, its import fails (Python reference, section 5.3.1).
    sys.modules[_PACKAGE] = None  # type: ignore[assignment]
    try:
        yield
    finally:
        del sys.modules[_PACKAGE]

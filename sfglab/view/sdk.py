"""The one place that imports Rerun, so that everything else can be imported without it."""

from __future__ import annotations

from typing import Any

from sfglab.errors import MissingExtraError


def rerun() -> Any:
    """Return the Rerun SDK.

    Raises:
        MissingExtraError: It is not installed.
    """
    try:
        import rerun
    except ImportError as error:
        raise MissingExtraError("rerun", extra="view", purpose="the view") from error
    return rerun

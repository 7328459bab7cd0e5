"""The error of everything that writes router configurations."""

from __future__ import annotations

from sfglab.errors import SfglabError


class RouterFileError(SfglabError, ValueError):
    """A policy that a router's configuration cannot express, or a target that there is not."""

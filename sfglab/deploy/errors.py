"""Error of a deployment."""

from __future__ import annotations

from sfglab.errors import SfglabError


class DeployError(SfglabError, ValueError):
    """A fleet that cannot be deployed as it is described, or a machine that does not take it."""

"""Errors of a deployment."""

from __future__ import annotations

from sfglab.errors import SfglabError

#: Command that installs those programs of `sfglab deploy check` that are Python packages.
EXTRA = "pip install '.[deploy]'"


class DeployError(SfglabError, ValueError):
    """A fleet that cannot be deployed as it is described, or a host on which the deployment fails."""


class MissingProgramError(DeployError):
    """A check could not be run, because its program is not installed; `install` is the command that installs it."""

    def __init__(self, program: str, install: str = EXTRA) -> None:
        super().__init__(f"{program} is not installed; to mend this: {install}")

"""Errors of a deployment."""

from __future__ import annotations

from sfglab.errors import SfglabError

EXTRA = "pip install '.[deploy]'"  #: Command that installs the programs of `sfglab deploy check` that a package index has.


class DeployError(SfglabError, ValueError):
    """A fleet that cannot be deployed as it is described, or a machine that does not take it."""


class MissingProgramError(DeployError):
    """A check could not be asked: its checker is not installed, and `install` is the command that does."""

    def __init__(self, program: str, install: str = EXTRA) -> None:
        super().__init__(f"{program} is not installed: {install}")

"""What the log of the deployment experiment holds."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.lab.checks import CheckRow

__all__ = ["BundleFileRow", "DeployCheckRow", "DetectedRow", "LayerRow", "RefusedFleetRow", "UncheckedRow"]


@dataclass(frozen=True, slots=True, kw_only=True)
class DeployCheckRow(CheckRow):
    """A property that was checked.

    Attributes:
        group: Which part of the deployment it is of.
    """

    group: str


@dataclass(frozen=True, slots=True, kw_only=True)
class UncheckedRow:
    """A property that nobody could check here.

    Attributes:
        group: Which part of the deployment it is of.
        check: The property.
        why: What is missing.
    """

    group: str
    check: str
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectedRow:
    """What detection says of a machine.

    Attributes:
        machine: Its name among the examples, or ``this machine``.
        accelerator: What its images are made for.
        why: The reason for it.
        instead: Accelerators that are there and were not taken, and those that could be thought to be there.
    """

    machine: str
    accelerator: str
    why: str
    instead: str


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleFileRow:
    """A file that a machine is given.

    Attributes:
        agent: Whose machine.
        path: Within the agent's folder.
        meaning: What it is for.
        size_bytes: Its size.
        lines: Its lines; 0 for what is no text.
        sha256: Its digest.
    """

    agent: str
    path: str
    meaning: str
    size_bytes: int
    lines: int
    sha256: str


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerRow:
    """One layer of an agent's image.

    Attributes:
        agent: Whose.
        layer: ``base``, ``adapter`` or ``application``.
        says: What makes it differ from other agents' layers.
        digest: Of its instructions and all below; equal digests are one layer.
    """

    agent: str
    layer: str
    says: str
    digest: str


@dataclass(frozen=True, slots=True, kw_only=True)
class RefusedFleetRow:
    """A broken fleet and what `sfglab deploy check` says of it.

    Attributes:
        fault: What is wrong with it.
        refused: Whether it was refused in the words that name it.
        said: The words.
    """

    fault: str
    refused: bool
    said: str

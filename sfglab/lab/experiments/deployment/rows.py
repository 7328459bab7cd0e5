"""What the log of the deployment experiment holds."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.lab.checks import CheckRow


@dataclass(frozen=True, slots=True, kw_only=True)
class DeployCheckRow(CheckRow):
    """A property that was checked."""

    group: str  #: Which part of the deployment it is of.


@dataclass(frozen=True, slots=True, kw_only=True)
class UncheckedRow:
    """A property that nobody could check here."""

    group: str  #: Which part of the deployment it is of.
    check: str  #: The property.
    why: str  #: What is missing.


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectedRow:
    """What detection says of a machine."""

    machine: str  #: Its name among the examples, or ``this machine``.
    accelerator: str  #: What its images are made for.
    why: str  #: The reason for it.
    #: Accelerators that are there and were not taken, and those that could be thought to be there.
    instead: str


@dataclass(frozen=True, slots=True, kw_only=True)
class BundleFileRow:
    """A file that a machine is given."""

    agent: str  #: Whose machine.
    path: str  #: Within the agent's folder.
    meaning: str  #: What it is for.
    size_bytes: int  #: Its size.
    lines: int  #: Its lines; 0 for what is no text.
    sha256: str  #: Its digest.


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerRow:
    """One layer of an agent's image."""

    agent: str  #: Whose.
    layer: str  #: ``base``, ``adapter`` or ``application``.
    says: str  #: What makes it differ from other agents' layers.
    digest: str  #: Of its instructions and all below; equal digests are one layer.


@dataclass(frozen=True, slots=True, kw_only=True)
class RefusedFleetRow:
    """A broken fleet and what `sfglab deploy check` says of it."""

    fault: str  #: What is wrong with it.
    refused: bool  #: Whether it was refused in the words that name it.
    said: str  #: The words.

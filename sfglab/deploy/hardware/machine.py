"""What was found out about a machine, as frozen values.

Refuses to know how it was found (`sfglab.deploy.hardware.detection`) and how it looks in a terminal.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sfglab.fleet.fleet_file import Accelerator, Architecture

__all__ = ["CodecRole", "DeviceGroup", "Evidence", "ExpectedCodec", "Machine", "Preference", "Source"]


class CodecRole(Enum):
    """What a codec does."""

    ENCODER = "encoder"
    DECODER = "decoder"


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedCodec:
    """An H.264 codec that the hardware lets one expect, were FFmpeg built for it.

    Attributes:
        name: FFmpeg's name.
        role: Encoder or decoder.
        why: What it runs on, and what it needs.
    """

    name: str
    role: CodecRole
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Where something is known from.

    Attributes:
        path: Absolute, as the machine itself sees it.
        says: What its contents mean; empty where it is enough that it is there.
    """

    path: str
    says: str = ""

    def __str__(self) -> str:
        """Return the path, and what it says."""
        return f"{self.path} ({self.says})" if self.says else self.path


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What is known of one accelerator.

    Attributes:
        accelerator: Which.
        found: Whether it is there and can be used.
        reason: Why it counts as found or not.
        sources: What is there of it, which may be something though it is not found; none for what has no file.
        devices: Device nodes that a container needs to use it.
        codecs: What it lets one expect of FFmpeg.
        chosen: Whether images are made for it.
        verdict: Why it was chosen or not.
    """

    accelerator: Accelerator
    found: bool
    reason: str
    sources: tuple[Source, ...] = ()
    devices: tuple[str, ...] = ()
    codecs: tuple[ExpectedCodec, ...] = ()
    chosen: bool = False
    verdict: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Preference:
    """One row of the order in which accelerators are chosen.

    Attributes:
        accelerator: Which.
        why: Why it comes before those below it.
    """

    accelerator: Accelerator
    why: str


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceGroup:
    """A group that a container's user must be in to open the devices.

    Attributes:
        name: As udev's rules give it.
        gid: Its number on the machine, which a container needs because its own numbers differ; None if the
            machine's ``/etc/group`` does not have it.
    """

    name: str
    gid: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """A machine, as its files describe it.

    Attributes:
        root: Folder that stands for its ``/``.
        architecture: Of its programs; None if there are no images for it, or it is not known.
        architecture_reason: How it is known, or why not.
        model: What its maker calls it.
        operating_system: What its distribution calls itself.
        jetpack: Major version of JetPack; None where there is none, or none that is known.
        accelerator: What its images are made for.
        evidence: For every accelerator, in order of preference, whether it is there.
        devices: Device nodes that a container needs for the accelerator.
        groups: Groups that may open them.
    """

    root: str
    architecture: Architecture | None
    architecture_reason: str
    model: str
    operating_system: str
    jetpack: int | None
    accelerator: Accelerator
    evidence: tuple[Evidence, ...]
    devices: tuple[str, ...]
    groups: tuple[DeviceGroup, ...]

    def evidence_of(self, accelerator: Accelerator) -> Evidence:
        """Return what is known of one accelerator."""
        return next(item for item in self.evidence if item.accelerator is accelerator)

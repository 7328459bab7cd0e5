"""What was found out about a machine, as frozen values.

Refuses to know how it was found (`sfglab.deploy.hardware.detection`) and how it looks in a terminal.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sfglab.fleet.fleet_file import Accelerator, Architecture


class CodecRole(Enum):
    """What a codec does."""

    ENCODER = "encoder"
    DECODER = "decoder"


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedCodec:
    """An H.264 codec that the hardware lets one expect, were FFmpeg built for it."""

    name: str  #: FFmpeg's name.
    role: CodecRole  #: Encoder or decoder.
    why: str  #: What it runs on, and what it needs.


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Where something is known from."""

    path: str  #: Absolute, as the machine itself sees it.
    says: str = ""  #: What its contents mean; empty where it is enough that it is there.

    def __str__(self) -> str:
        """Return the path, and what it says."""
        return f"{self.path} ({self.says})" if self.says else self.path


@dataclass(frozen=True, slots=True, kw_only=True)
class Evidence:
    """What is known of one accelerator."""

    accelerator: Accelerator  #: Which.
    found: bool  #: Whether it is there and can be used.
    reason: str  #: Why it counts as found or not.
    #: What is there of it, which may be something though it is not found; none for what has no file.
    sources: tuple[Source, ...] = ()
    devices: tuple[str, ...] = ()  #: Device nodes that a container needs to use it.
    codecs: tuple[ExpectedCodec, ...] = ()  #: What it lets one expect of FFmpeg.
    chosen: bool = False  #: Whether images are made for it.
    verdict: str = ""  #: Why it was chosen or not.


@dataclass(frozen=True, slots=True, kw_only=True)
class Preference:
    """One row of the order in which accelerators are chosen."""

    accelerator: Accelerator  #: Which.
    why: str  #: Why it comes before those below it.


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceGroup:
    """A group that a container's user must be in to open the devices."""

    name: str  #: As udev's rules give it.
    #: Its number on the machine, which a container needs because its own numbers differ; None if the machine's
    #: ``/etc/group`` does not have it.
    gid: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """A machine, as its files describe it."""

    root: str  #: Folder that stands for its ``/``.
    #: Of its programs; None if there are no images for it, or it is not known.
    architecture: Architecture | None
    architecture_reason: str  #: How it is known, or why not.
    model: str  #: What its maker calls it.
    operating_system: str  #: What its distribution calls itself.
    jetpack: int | None  #: Major version of JetPack; None where there is none, or none that is known.
    accelerator: Accelerator  #: What its images are made for.
    evidence: tuple[Evidence, ...]  #: For every accelerator, in order of preference, whether it is there.
    devices: tuple[str, ...]  #: Device nodes that a container needs for the accelerator.
    groups: tuple[DeviceGroup, ...]  #: Groups that may open them.

    def evidence_of(self, accelerator: Accelerator) -> Evidence:
        """Return what is known of one accelerator."""
        return next(item for item in self.evidence if item.accelerator is accelerator)

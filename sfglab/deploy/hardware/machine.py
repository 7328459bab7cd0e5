"""A machine as values and as text for a terminal: its hardware, from what it is known, and why."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

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
    sources: tuple[Source, ...] = ()  #: What is there of it, found or not.
    devices: tuple[str, ...] = ()  #: Device nodes that a container needs to use it.
    codecs: tuple[ExpectedCodec, ...] = ()  #: What it lets one expect of FFmpeg.
    chosen: bool = False  #: Whether images are made for it.
    verdict: str = ""  #: Why it was chosen or not.


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceGroup:
    """A group that a container's user must be in to open the devices."""

    name: str  #: As udev's rules give it.
    #: Its number on the machine; None if the machine's ``/etc/group`` does not have it.
    gid: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class CodecFound(ExpectedCodec):
    """One codec, as expected (or why not) and as tried."""

    expected: bool  #: Whether the machine lets one expect it.
    works: bool  #: Whether it encoded or decoded in this process.
    tried: str  #: What was seen when it was tried.


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """A machine, as its files describe it."""

    root: str  #: Folder that stands for its ``/``.
    architecture: Architecture | None  #: Of its programs; None if not known, or without images.
    architecture_reason: str  #: How it is known, or why not.
    model: str  #: What its maker calls it.
    operating_system: str  #: What its distribution calls itself.
    #: Major version of JetPack; None where there is none, or none that is known.
    jetpack: int | None
    accelerator: Accelerator  #: What its images are made for.
    #: For every accelerator, in order of preference, whether it is there.
    evidence: tuple[Evidence, ...]
    devices: tuple[str, ...]  #: Device nodes that a container needs for the accelerator.
    groups: tuple[DeviceGroup, ...]  #: Groups that may open them.

    def evidence_of(self, accelerator: Accelerator) -> Evidence:
        """Return what is known of one accelerator."""
        return next(item for item in self.evidence if item.accelerator is accelerator)


def render_machine(machine: Machine, codecs: Sequence[CodecFound] | None = None) -> str:
    """Return a report of a machine, with what `codecs_found` found unless it is None."""
    lines = [*_head(machine), "", "Accelerators, in order of preference:"]
    for item in machine.evidence:
        lines += _evidence(item)
    if codecs is not None:
        lines += ["", *_codecs(codecs)]
    return "\n".join(lines) + "\n"


def _head(machine: Machine) -> Iterator[str]:
    architecture = f"{machine.architecture.value}, " if machine.architecture else ""
    groups = [
        f"{g.name} ({'not in /etc/group' if g.gid is None else g.gid})" for g in machine.groups
    ]
    rows = {
        "Model": machine.model,
        "Operating system": machine.operating_system,
        "Architecture": f"{architecture}{machine.architecture_reason}",
        "JetPack": str(machine.jetpack) if machine.jetpack else "",
        "Accelerator": machine.accelerator.value,
        "Devices": ", ".join(machine.devices) or "none needed",
        "Groups": ", ".join(groups) or "none needed",
    }
    yield from (f"{title + ':':18}{text}" for title, text in rows.items() if text)


def _evidence(item: Evidence) -> Iterator[str]:
    found = "found" if item.found else "not found"
    yield f"{'*' if item.chosen else ' '} {item.accelerator.value:7} {found}: {item.reason}"
    if item.found:
        yield f"{'':10}{item.verdict}"
    for source in item.sources:
        yield f"{'':10}- {source}"


def _codecs(codecs: Sequence[CodecFound]) -> Iterator[str]:
    yield "H.264 codecs, as PyAV opens them in this process:"
    yield f"  {'name':14} {'role':8} {'expected':8} {'opens':6} tried; why"
    for codec in codecs:
        expected, works = ("yes" if flag else "no" for flag in (codec.expected, codec.works))
        yield f"  {codec.name:14} {codec.role.value:8} {expected:8} {works:6} {codec.tried}; {codec.why}"

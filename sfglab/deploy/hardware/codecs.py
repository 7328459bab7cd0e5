"""Which H.264 codecs a machine lets one expect, and which of them PyAV really opens in this process.

Expectation comes from the machine's files, which may be another machine's; what opens is found out here and
now, by `sfglab.codecs.probe`, in whatever image or machine this process runs in.
"""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.deploy.hardware.detection import detect
from sfglab.deploy.hardware.machine import CodecRole, ExpectedCodec, Machine
from sfglab.fleet.fleet_file import Accelerator

_SOFTWARE = (
    ExpectedCodec(name="libx264", role=CodecRole.ENCODER, why="the processor; the wheels of PyAV have it"),
    ExpectedCodec(name="h264", role=CodecRole.DECODER, why="the processor; part of FFmpeg"),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class CodecFound:
    """One codec, as expected and as tried."""

    name: str  #: FFmpeg's name.
    role: CodecRole  #: Encoder or decoder.
    expected: bool  #: Whether the machine lets one expect it.
    works: bool  #: Whether it encoded or decoded in this process.
    tried: str  #: What was seen when it was tried.
    why: str  #: Why it is expected or not.


def expected_codecs(machine: Machine) -> tuple[ExpectedCodec, ...]:
    """Return the H.264 codecs that a machine's chosen accelerator lets one expect, then the processor's."""
    return (*machine.evidence_of(machine.accelerator).codecs, *_SOFTWARE)


def codecs_found(machine: Machine | None = None) -> tuple[CodecFound, ...]:
    """Try all of FFmpeg's H.264 codecs in this process and return them beside what the machine lets one expect.

    Args:
        machine: Whose codecs are expected; None for the machine that this process runs on.
    """
    from sfglab.codecs.probe import available_decoders, available_encoders

    machine = machine or detect()
    expected = {(item.name, item.role): item for item in expected_codecs(machine)}
    probes = [(probe, CodecRole.ENCODER) for probe in available_encoders()]
    probes += [(probe, CodecRole.DECODER) for probe in available_decoders()]
    rows = []
    for probe, role in probes:
        item = expected.get((probe.name, role))
        why = item.why if item else _why_not(probe.name, machine.accelerator)
        found = CodecFound(
            name=probe.name,
            role=role,
            expected=item is not None,
            works=probe.works,
            tried=probe.reason,
            why=why,
        )
        rows.append(found)
    return tuple(rows)


def _why_not(name: str, accelerator: Accelerator) -> str:
    from sfglab.codecs.probe import SOFTWARE

    if name in SOFTWARE:
        return "the processor's as well, but not needed beside libx264"
    if accelerator is Accelerator.NONE:
        return "needs an accelerator, and none was found"
    return f"not what this machine's {accelerator.value} is used through"

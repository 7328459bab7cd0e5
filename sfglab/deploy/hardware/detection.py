"""Detection: which accelerator a machine's images are made for, and which H.264 codecs to expect and to find.

It reads files below a root and nothing else, so that it says the same of a copy of them as on the machine.
Which codecs really open is tried here and now by `sfglab.codecs.probe`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.deploy.hardware import accelerators, board
from sfglab.deploy.hardware.board import MachineFiles
from sfglab.deploy.hardware.machine import CodecFound, CodecRole, Evidence, ExpectedCodec, Machine
from sfglab.fleet.fleet_file import Accelerator

if TYPE_CHECKING:
    from collections.abc import Callable

PREFERENCE = {
    Accelerator.JETSON: "its libraries fit one L4T release, no other base runs there",
    Accelerator.CUDA: "computes, encodes and decodes, apart from the processor's graphics",
    Accelerator.ROCM: "computes, and its base also has VAAPI",
    Accelerator.VAAPI: "encodes and decodes H.264",
    Accelerator.V4L2: "a single codec of the board, on some without H.264",
    Accelerator.NONE: "nothing else is there, so the processor does it all",
}
"""The order of choice, the first that is found; and why each comes before those below it."""

_RULES: dict[Accelerator, Callable[[MachineFiles], Evidence]] = {
    Accelerator.JETSON: accelerators.find_jetson,
    Accelerator.CUDA: accelerators.find_cuda,
    Accelerator.ROCM: accelerators.find_rocm,
    Accelerator.VAAPI: accelerators.find_vaapi,
    Accelerator.V4L2: accelerators.find_v4l2,
}


def detect(root: Path = Path("/")) -> Machine:
    """Return what a machine has, and what its images are made for (paper A, section 4.4).

    The root is the folder that stands for the machine's ``/``; a `DeployError` says that there is none.
    """
    files = MachineFiles(root)
    evidence = _judged([_evidence(files, accelerator) for accelerator in PREFERENCE])
    chosen = next(item for item in evidence if item.chosen)
    architecture, reason = board.find_architecture(files)
    return Machine(
        root=str(root),
        architecture=architecture,
        architecture_reason=reason,
        model=board.find_model(files),
        operating_system=board.find_operating_system(files),
        jetpack=accelerators.find_jetpack(files),
        accelerator=chosen.accelerator,
        evidence=evidence,
        devices=chosen.devices,
        groups=board.find_groups(files, chosen.devices),
    )


def _evidence(files: MachineFiles, accelerator: Accelerator) -> Evidence:
    rule = _RULES.get(accelerator)
    if rule is not None:
        return rule(files)
    reason = "the processor is always there"
    if board.in_container(files):
        reason += (
            "; this is a container's root, which has only the devices that the container was given"
        )
    return Evidence(accelerator=accelerator, found=True, reason=reason)


def _judged(evidence: list[Evidence]) -> tuple[Evidence, ...]:
    """Return the evidence with the choice: the first that is found, and why each is or is not the one."""
    chosen = next(item for item in evidence if item.found)

    def verdict(item: Evidence) -> str:
        if item is chosen:
            return f"chosen: {PREFERENCE[item.accelerator]}"
        return (
            f"not chosen: {chosen.accelerator.value} comes before it"
            if item.found
            else "not chosen: not found"
        )

    return tuple(replace(item, chosen=item is chosen, verdict=verdict(item)) for item in evidence)


_SOFTWARE = (
    ExpectedCodec(
        name="libx264", role=CodecRole.ENCODER, why="the processor; the wheels of PyAV have it"
    ),
    ExpectedCodec(name="h264", role=CodecRole.DECODER, why="the processor; part of FFmpeg"),
)


def expected_codecs(machine: Machine) -> tuple[ExpectedCodec, ...]:
    """Return the H.264 codecs that a machine's chosen accelerator lets one expect, then the processor's."""
    return (*machine.evidence_of(machine.accelerator).codecs, *_SOFTWARE)


def codecs_found(machine: Machine) -> tuple[CodecFound, ...]:
    """Try all of FFmpeg's H.264 codecs here, and return them beside those expected of a machine."""
    from sfglab.codecs.probe import available_decoders, available_encoders

    expected = {(item.name, item.role): item.why for item in expected_codecs(machine)}
    probes = [(probe, CodecRole.ENCODER) for probe in available_encoders()]
    probes += [(probe, CodecRole.DECODER) for probe in available_decoders()]
    return tuple(
        CodecFound(
            name=probe.name,
            role=role,
            expected=(probe.name, role) in expected,
            works=probe.works,
            tried=probe.reason,
            why=expected.get((probe.name, role), "") or _why_not(probe.name, machine.accelerator),
        )
        for probe, role in probes
    )


def _why_not(name: str, accelerator: Accelerator) -> str:
    from sfglab.codecs.probe import SOFTWARE

    if name in SOFTWARE:
        return "the processor's as well, but not needed beside libx264"
    if accelerator is Accelerator.NONE:
        return "needs an accelerator, and none was found"
    return f"not what this machine's {accelerator.value} is used through"

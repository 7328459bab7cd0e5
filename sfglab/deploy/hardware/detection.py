"""Which accelerator a machine has, and which of several its images are made for.

Reads files and looks for device nodes below a root, and nothing else: it opens no device and starts no program,
so that it says the same of a copy of a machine's files as on the machine.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.deploy.hardware.architecture import find_architecture
from sfglab.deploy.hardware.board import find_groups, find_model, find_operating_system, in_container
from sfglab.deploy.hardware.files import MachineFiles
from sfglab.deploy.hardware.machine import Evidence, Machine, Preference
from sfglab.deploy.hardware.nvidia import find_cuda, find_jetpack, find_jetson
from sfglab.deploy.hardware.render_nodes import find_rocm, find_vaapi
from sfglab.deploy.hardware.video_nodes import find_v4l2
from sfglab.fleet.fleet_file import Accelerator

if TYPE_CHECKING:
    from collections.abc import Callable


PREFERENCE = (
    Preference(
        accelerator=Accelerator.JETSON, why="its libraries fit one L4T release, no other base runs there"
    ),
    Preference(
        accelerator=Accelerator.CUDA, why="computes, encodes and decodes, apart from the processor's graphics"
    ),
    Preference(accelerator=Accelerator.ROCM, why="computes, and its base also has VAAPI"),
    Preference(accelerator=Accelerator.VAAPI, why="encodes and decodes H.264"),
    Preference(accelerator=Accelerator.V4L2, why="a single codec of the board, on some without H.264"),
    Preference(accelerator=Accelerator.NONE, why="nothing else is there, so the processor does it all"),
)
"""The order of choice: the first that is found."""

_RULES: dict[Accelerator, Callable[[MachineFiles], Evidence]] = {
    Accelerator.JETSON: find_jetson,
    Accelerator.CUDA: find_cuda,
    Accelerator.ROCM: find_rocm,
    Accelerator.VAAPI: find_vaapi,
    Accelerator.V4L2: find_v4l2,
}


def detect(root: Path = Path("/")) -> Machine:
    """Return what a machine has, and what its images are made for.

    Paper A, section 4.4, 'dynamic base image selection process that detects the host's hardware accelerators'.

    Args:
        root: Folder that stands for the machine's ``/``; links below it do not lead out of it.

    Raises:
        DeployError: There is no such folder.
    """
    files = MachineFiles(root)
    evidence = _judged([_evidence(files, row.accelerator) for row in PREFERENCE])
    chosen = next(item for item in evidence if item.chosen)
    architecture, reason = find_architecture(files)
    return Machine(
        root=str(root),
        architecture=architecture,
        architecture_reason=reason,
        model=find_model(files),
        operating_system=find_operating_system(files),
        jetpack=find_jetpack(files),
        accelerator=chosen.accelerator,
        evidence=evidence,
        devices=chosen.devices,
        groups=find_groups(files, chosen.devices),
    )


def _evidence(files: MachineFiles, accelerator: Accelerator) -> Evidence:
    rule = _RULES.get(accelerator)
    if rule is not None:
        return rule(files)
    reason = "the processor is always there"
    if in_container(files):
        reason += "; this is a container's root, which has only the devices that the container was given"
    return Evidence(accelerator=accelerator, found=True, reason=reason)


def _judged(evidence: list[Evidence]) -> tuple[Evidence, ...]:
    """Return the evidence with the choice: the first that is found, and why each is or is not the one."""
    chosen = next(item for item in evidence if item.found)
    judged = []
    for item, row in zip(evidence, PREFERENCE, strict=True):
        if item is chosen:
            verdict = f"chosen: {row.why}"
        elif item.found:
            verdict = f"not chosen: {chosen.accelerator.value} comes before it"
        else:
            verdict = "not chosen: not found"
        judged.append(replace(item, chosen=item is chosen, verdict=verdict))
    return tuple(judged)

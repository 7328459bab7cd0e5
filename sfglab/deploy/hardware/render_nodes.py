"""AMD's and Intel's graphics: ROCm for computing, VAAPI for video, both through DRM's render nodes."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from sfglab.deploy.hardware.machine import CodecRole, Evidence, ExpectedCodec, Source
from sfglab.deploy.hardware.pci import VENDORS, read_id
from sfglab.fleet.fleet_file import Accelerator

if TYPE_CHECKING:
    from sfglab.deploy.hardware.files import MachineFiles


AMD, INTEL = "0x1002", "0x8086"

ROCM_TARGETS = frozenset({"gfx908", "gfx90a", "gfx942", "gfx1030", "gfx1100", "gfx1101", "gfx1200", "gfx1201"})
"""Chips on AMD's list of supported GPUs, for ROCm 6.4 ('System requirements (Linux)', column LLVM target).

Read from the list of an earlier 6.x and the release notes of 6.4.1; gfx1101 is from memory: compare before use.
The Dockerfile's base must be of this release or a later one. Others may compute with HSA_OVERRIDE_GFX_VERSION,
which AMD calls unofficial; we do not count them.
"""

_TOPOLOGY = "/sys/class/kfd/kfd/topology/nodes"
_WHY_VAAPI = "video engine of the graphics; needs Mesa's or Intel's VA driver in the image"


def gfx_name(gfx_target_version: int) -> str:
    """Return LLVM's name of a chip.

    The kernel writes ``major * 10000 + minor * 100 + stepping``; LLVM's name has minor and stepping as one
    hexadecimal digit each, as in 90010 for gfx90a (Linux, drivers/gpu/drm/amd/amdkfd/kfd_device.c; LLVM, User
    Guide for AMDGPU Backend).

    Args:
        gfx_target_version: As in a node's properties; 0 for a processor.
    """
    major, rest = divmod(gfx_target_version, 10000)
    minor, stepping = divmod(rest, 100)
    return f"gfx{major}{minor:x}{stepping:x}"


def find_rocm(files: MachineFiles) -> Evidence:
    """Return whether there is an AMD chip that ROCm supports.

    ``/dev/kfd`` alone says too little: the kernel offers it for chips that AMD's libraries have no code for, as
    the Steam Deck's gfx1033. A container needs it and the chip's render node (AMD, 'Running ROCm Docker
    containers').
    """
    chips = _chips(files)
    node = files.has("/dev/kfd")
    sources = (*([Source(path="/dev/kfd")] if node else []), *(source for source, _, _ in chips))
    good = [(name, render) for _, name, render in chips if name in ROCM_TARGETS]
    renders = tuple(render for _, render in good if render and files.has(render))
    names = ", ".join(name for name, _ in good)
    if node and renders:
        return Evidence(
            accelerator=Accelerator.ROCM,
            found=True,
            reason=f"{names} is on AMD's list of supported chips",
            sources=(*sources, *(Source(path=path) for path in renders)),
            devices=("/dev/kfd", *renders),
            codecs=_vaapi_codecs(frozenset({AMD})),
        )
    reason = _why_no_rocm(node=node, chips=[name for _, name, _ in chips], good=names)
    return Evidence(accelerator=Accelerator.ROCM, found=False, reason=reason, sources=sources)


def find_vaapi(files: MachineFiles) -> Evidence:
    """Return whether there is graphics of Intel or AMD with a render node, whose video engine VAAPI drives.

    The maker is ``/sys/class/drm/renderD*/device/vendor``; what is no PCI device, as a Raspberry Pi's v3d, has
    no such file. Others' nodes, as virtio's in a virtual machine or nouveau's, do not count: what they offer
    depends on the host, or is too little.
    """
    nodes = [(path, _vendor(files, path)) for path in files.paths("/dev/dri", r"renderD[0-9]+")]
    sources = tuple(
        Source(path=path, says=VENDORS.get(vendor, vendor or "no PCI device")) for path, vendor in nodes
    )
    good = [(path, vendor) for path, vendor in nodes if vendor in {AMD, INTEL}]
    if good:
        makers = " and ".join(sorted({VENDORS[vendor] for _, vendor in good}))
        return Evidence(
            accelerator=Accelerator.VAAPI,
            found=True,
            reason=f"graphics of {makers} with a video engine",
            sources=sources,
            devices=tuple(path for path, _ in good),
            codecs=_vaapi_codecs(frozenset(vendor for _, vendor in good)),
        )
    if sources:
        reason = "render nodes, but none of Intel or AMD"
    elif files.paths("/dev/dri", r"card[0-9]+"):
        reason = "a display without render node, /dev/dri/renderD*"
    else:
        reason = "no render node, /dev/dri/renderD*"
    return Evidence(accelerator=Accelerator.VAAPI, found=False, reason=reason, sources=sources)


def _vendor(files: MachineFiles, path: str) -> str:
    return read_id(files, f"/sys/class/drm/{path.rpartition('/')[2]}/device/vendor")


def _chips(files: MachineFiles) -> list[tuple[Source, str, str]]:
    """Return each chip's source, name and render node; processors, which are nodes as well, have version 0."""
    chips = []
    for name in files.names(_TOPOLOGY, r"[0-9]+"):
        path = f"{_TOPOLOGY}/{name}/properties"
        text = files.text(path) or ""
        version = _property(text, "gfx_target_version")
        if version:
            minor = _property(text, "drm_render_minor")
            chip = gfx_name(version)
            render = f"/dev/dri/renderD{minor}" if minor else ""
            chips.append(
                (Source(path=path, says=f"gfx_target_version {version}, that is {chip}"), chip, render)
            )
    return chips


def _property(text: str, name: str) -> int:
    found = re.search(rf"^{name} ([0-9]{{1,7}})$", text, re.MULTILINE)
    return int(found[1]) if found else 0


def _why_no_rocm(*, node: bool, chips: list[str], good: str) -> str:
    if good:
        missing = "its render node" if node else "/dev/kfd"
        return f"{good} is on AMD's list of supported chips, but {missing} is missing: a container without it?"
    if chips:
        return f"{', '.join(chips)} is not on AMD's list of supported chips ({', '.join(sorted(ROCM_TARGETS))})"
    return f"/dev/kfd, but no chip in {_TOPOLOGY}" if node else "no /dev/kfd and no chip of AMD that computes"


def _vaapi_codecs(vendors: frozenset[str]) -> tuple[ExpectedCodec, ...]:
    """Return VAAPI's encoder, and for Intel those of Quick Sync.

    VAAPI decodes inside FFmpeg's ``h264``, as an acceleration: there is no decoder of its own name.
    """
    both = [ExpectedCodec(name="h264_vaapi", role=CodecRole.ENCODER, why=_WHY_VAAPI)]
    if INTEL in vendors:
        why = "Intel's Quick Sync; needs oneVPL's or Media SDK's runtime in the image"
        both += [ExpectedCodec(name="h264_qsv", role=role, why=why) for role in CodecRole]
    return tuple(both)

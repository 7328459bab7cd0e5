"""Graphics of AMD and Intel behind DRM's render nodes, and codecs behind V4L2's, as on a Raspberry Pi."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from sfglab.deploy.hardware.board import VENDORS, read_id
from sfglab.deploy.hardware.files import plain
from sfglab.deploy.hardware.machine import CodecRole, Evidence, ExpectedCodec, Source
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


_H264 = {"bcm2835-codec-decode": CodecRole.DECODER, "bcm2835-codec-encode": CodecRole.ENCODER}
"""H.264 codecs of Raspberry Pi 4 and before (Raspberry Pi's kernel, bcm2835-v4l2-codec.c)."""

_HEVC = frozenset({"rpivid", "rpi-hevc-dec"})
"""The HEVC decoder of Raspberry Pi 4 and 5, by its old and its new driver."""

_CODEC = re.compile(r"(?:.*[-_ ])?(?:enc|encode|encoder|dec|decode|decoder)", re.IGNORECASE)


def find_v4l2(files: MachineFiles) -> Evidence:
    """Return whether a V4L2 device node is a codec, by its driver's name in /sys/class/video4linux.

    A codec of any format makes the machine one for V4L2, because base images differ by driver, not by format;
    the reason says what it does for H.264, which may be nothing: a Raspberry Pi 5 has an HEVC decoder and
    neither encodes nor decodes H.264 in hardware (Raspberry Pi 5 Product Brief: '4Kp60 HEVC decoder'). Cameras
    and image processors, as pispbe and bcm2835-isp, are no codecs. Which formats an unknown codec has could
    only be asked by opening it.
    """
    codecs = [
        (path, name) for path, name in _nodes(files) if name in _H264 or name in _HEVC or _CODEC.fullmatch(name)
    ]
    sources = tuple(Source(path=path, says=name) for path, name in codecs)
    if not codecs:
        cameras = len(_nodes(files))
        seen = f"{cameras} video device(s), but none is a codec" if cameras else "no video device"
        return Evidence(accelerator=Accelerator.V4L2, found=False, reason=seen)
    roles = [_H264[name] for _, name in codecs if name in _H264]
    return Evidence(
        accelerator=Accelerator.V4L2,
        found=True,
        reason=_what(frozenset(roles), frozenset(name for _, name in codecs)),
        sources=sources,
        devices=tuple(path for path, _ in codecs),
        codecs=tuple(
            ExpectedCodec(name="h264_v4l2m2m", role=role, why="stateful V4L2 codec of the board")
            for role in CodecRole
            if role in roles
        ),
    )


def _nodes(files: MachineFiles) -> list[tuple[str, str]]:
    """Return device nodes and their drivers' names; a node without a name is of no use."""
    nodes = []
    for path in files.paths("/dev", r"video[0-9]+"):
        name = plain(files.text(f"/sys/class/video4linux/{path.removeprefix('/dev/')}/name") or "")
        if name:
            nodes.append((path, name))
    return nodes


def _what(roles: frozenset[CodecRole], names: frozenset[str]) -> str:
    if roles:
        does = " and ".join(role.value for role in CodecRole if role in roles)
        return f"H.264 {does} in hardware"
    if names <= _HEVC:
        return "an HEVC decoder only: H.264 is encoded and decoded by the processor"
    return f"codecs whose formats are not known without opening them ({', '.join(sorted(names))})"

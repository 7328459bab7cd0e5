"""Detection of a machine's accelerator, from which paper A, section 4.4, derives the base image.

Detection only reads files below a root, so that it gives the same result for a copy of the files as on the
machine. `codecs_found` tries which codecs work in this process.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.deploy.machine_files import MachineFiles, plain
from sfglab.fleet.fleet_file import Accelerator
from sfglab.tables import columns

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


class CodecRole(Enum):
    """Role of a codec: encoder or decoder."""

    ENCODER = "encoder"
    DECODER = "decoder"


@dataclass(frozen=True, slots=True)
class Codec:
    """An H.264 codec that the hardware has, if FFmpeg was built for it."""

    name: str  #: FFmpeg's name.
    role: CodecRole  #: Encoder or decoder.
    why: str  #: Hardware that it runs on, and what it needs.


@dataclass(frozen=True, slots=True, kw_only=True)
class CodecFound(Codec):
    """A codec with the result of its trial."""

    expected: bool  #: Whether the hardware has it.
    works: bool  #: Whether it encoded or decoded in this process.
    tried: str  #: Result of the trial.


@dataclass(frozen=True, slots=True)
class Evidence:
    """Result of the search for one accelerator on a machine."""

    reason: str  #: Reason why the accelerator counts as found or not.
    found: bool = False  #: Whether the accelerator is present and usable.
    devices: tuple[str, ...] = ()  #: Device nodes that a container needs for the accelerator.
    codecs: tuple[Codec, ...] = ()  #: H.264 codecs of the accelerator.


@dataclass(frozen=True, slots=True, kw_only=True)
class Machine:
    """Hardware and operating system of a machine."""

    root: str  #: Folder that was examined as the machine's ``/``.
    model: str  #: Model name of the manufacturer.
    operating_system: str  #: Name of the distribution.
    jetpack: int | None  #: Major version of JetPack; None if there is none or it is not known.
    accelerator: Accelerator  #: Accelerator that images for the machine are made for.
    #: Evidence for each accelerator, in the order of choice.
    evidence: dict[Accelerator, Evidence]
    devices: tuple[str, ...]  #: Device nodes that a container needs for the accelerator.


def detect(root: Path = Path("/")) -> Machine:
    """Return the hardware of a machine, and the accelerator that its images are made for.

    Args:
        root: Folder that stands for the machine's ``/``.

    Raises:
        DeployError: There is no such folder.
    """
    files = MachineFiles(root)
    evidence = {accelerator: look_for(files) for accelerator, look_for in TABLE.items()}
    accelerator = next(name for name, item in evidence.items() if item.found)
    devices = evidence[accelerator].devices
    release = _l4t_release(files)
    return Machine(
        root=str(root),
        model=_model(files),
        operating_system=_operating_system(files),
        jetpack=JETPACKS.get(release[0]) if release else None,
        accelerator=accelerator,
        evidence=evidence,
        devices=devices,
    )


# NVIDIA Jetson.

JETPACKS = {28: 3, 31: 4, 32: 4, 34: 5, 35: 5, 36: 6, 38: 7, 39: 7}
"""Major version of JetPack by that of Jetson Linux (L4T): docs.nvidia.com/jetson/archives."""

_RELEASE_FILE = "/etc/nv_tegra_release"
_RELEASE = re.compile(r"#\s*R([0-9]{1,3})\s*\(release\),\s*REVISION:\s*([0-9][0-9.]{0,15})")


def look_for_jetson(files: MachineFiles) -> Evidence:
    """Search for a Jetson with usable video engines.

    The device tree (``nvidia,tegra*``) or the release file of L4T names the board. Its engines are reached
    through ``/dev/nvmap`` and ``/dev/nvhost-*`` (L4T, /etc/nvidia-container-runtime/host-files-for-container.d).
    """
    is_jetson = _is_tegra(files) or files.text(_RELEASE_FILE) is not None
    engines = files.paths("/dev", r"nvhost-[A-Za-z0-9_-]+|nvmap")
    if not is_jetson:
        return Evidence("no Tegra board and no L4T release")
    if not engines:
        reason = (
            "a Jetson, but no /dev/nvmap or /dev/nvhost-*: a container without NVIDIA's runtime?"
        )
        return Evidence(reason)
    nodes = [*engines]
    for folder in files.paths("/dev/nvgpu", r"[\w-]+"):
        nodes += files.paths(folder, r"[\w-]+")
    nodes += files.paths("/dev", r"nvidia[0-9]+|nvidiactl|nvidia-modeset|v4l2-nv(dec|enc)")
    nodes += files.paths("/dev/dri", r"renderD[0-9]+")
    release = _l4t_release(files)
    version = "an unknown release of L4T"
    if release:
        version = f"L4T {release[1]}, JetPack {JETPACKS.get(release[0], 'unknown')}"
    return Evidence(
        f"a Jetson with {version}",
        found=True,
        devices=tuple(nodes),
        codecs=_jetson_codecs(files),
    )


def _is_tegra(files: MachineFiles) -> bool:
    """Return whether a board is compatible with a Tegra (Devicetree Specification, 2.3.1)."""
    texts = [files.text(f"{tree}/compatible") or "" for tree in _TREES]
    names = [plain(name) for text in texts for name in text.split("\0")]
    return any(name.startswith("nvidia,tegra") for name in names)


def _l4t_release(files: MachineFiles) -> tuple[int, str] | None:
    """Return major version and version of L4T."""
    found = _RELEASE.search(files.text(_RELEASE_FILE) or "")
    return (int(found[1]), f"{found[1]}.{found[2].rstrip('.')}") if found else None


def _jetson_codecs(files: MachineFiles) -> tuple[Codec, ...]:
    """Return NVENC and NVDEC; Orin Nano has no NVENC (NVIDIA, Jetson Orin Nano Series Data Sheet)."""
    why = "engine on the chip; in FFmpeg of jetson-ffmpeg, not in the wheels of PyAV"
    has_encoder = "Orin Nano" not in _model(files)
    roles = CodecRole if has_encoder else [CodecRole.DECODER]
    return tuple(Codec("h264_nvmpi", role, why) for role in roles)


# NVIDIA cards.

_DRIVER_FILE = "/proc/driver/nvidia/version"
_DRIVER = re.compile(r"Kernel Module(?: for \w+)?\s+([0-9]+(?:\.[0-9]+)+)")
_NVENC = "NVENC on the card; needs the driver's library from the host; an A100 has no encoder"
_CUDA_CODECS = (
    Codec("h264_nvenc", CodecRole.ENCODER, _NVENC),
    Codec("h264_cuvid", CodecRole.DECODER, "NVDEC on the card"),
)


def look_for_cuda(files: MachineFiles) -> Evidence:
    """Search for a graphics card with NVIDIA's driver.

    The driver has ``/proc/driver/nvidia/version``, and a card ``/dev/nvidia0``; both are used through
    ``/dev/nvidiactl`` (NVIDIA Accelerated Linux Graphics Driver README). WSL 2 has ``/dev/dxg`` for all cards,
    and the libcuda of NVIDIA's driver below /usr/lib/wsl/lib (CUDA on WSL User Guide). A Jetson has the same
    nodes for its display.
    """
    if files.has("/dev/dxg"):
        if not files.paths("/usr/lib/wsl/lib", r"libcuda\.so[0-9.]*"):
            return Evidence("WSL 2 with a graphics card that is not NVIDIA's")
        reason = "NVIDIA's driver for Windows, in WSL 2"
        return Evidence(reason, found=True, devices=("/dev/dxg",), codecs=_CUDA_CODECS)
    if _is_tegra(files):
        return Evidence("a Tegra: its /dev/nvidia* belong to the display")
    driver = files.text(_DRIVER_FILE)
    cards = files.paths("/dev", r"nvidia[0-9]+")
    control = files.paths("/dev", "nvidiactl")
    needed = {_DRIVER_FILE: driver, "/dev/nvidiactl": control, "/dev/nvidia0": cards}
    missing = [name for name, there in needed.items() if not there]
    if len(missing) == len(needed):
        return Evidence("no driver of NVIDIA")
    if missing:
        return Evidence(f"NVIDIA's driver is not complete: without {', '.join(missing)}")
    version = _DRIVER.search(driver or "")
    name = version[1] if version else "of unknown version"
    extra = files.paths("/dev", r"nvidia-(uvm|uvm-tools|modeset)")
    reason = f"NVIDIA's driver {name} with {len(cards)} card(s)"
    return Evidence(reason, found=True, devices=(*cards, *control, *extra), codecs=_CUDA_CODECS)


# AMD and Intel.

ROCM_TARGETS = frozenset(
    {"gfx908", "gfx90a", "gfx942", "gfx1030", "gfx1100", "gfx1101", "gfx1200", "gfx1201"}
)
"""Chips on AMD's list of supported GPUs for ROCm 6.4 ('System requirements (Linux)', column LLVM target).

Read from the list of an earlier 6.x and the release notes of 6.4.1; gfx1101 is from memory: compare before use.
The base image must be of this release or a later one. Other chips may compute with HSA_OVERRIDE_GFX_VERSION,
which AMD calls unofficial, and do not count.
"""

_TOPOLOGY = "/sys/class/kfd/kfd/topology/nodes"
_AMD, _INTEL = "0x1002", "0x8086"  # PCI vendors
_VENDORS = {_AMD: "AMD", _INTEL: "Intel"}
_QUICK_SYNC = "Intel's Quick Sync; needs the runtime of oneVPL or Media SDK in the image"
_VAAPI_CODEC = Codec(
    "h264_vaapi",
    CodecRole.ENCODER,
    "video engine of the graphics; needs the VA driver of Mesa or Intel in the image",
)
"""VAAPI decodes inside FFmpeg's ``h264``, without a name of its own."""


def look_for_rocm(files: MachineFiles) -> Evidence:
    """Search for an AMD chip that ROCm supports.

    The kernel has ``/dev/kfd`` also for chips that AMD's libraries do not support, such as the gfx1033 of
    the Steam Deck. A container needs ``/dev/kfd`` and the chip's render node (AMD, 'Running ROCm Docker containers').
    """
    chips = _chips(files)
    good = [name for name in chips if name in ROCM_TARGETS]
    nodes = [node for name in good for node in chips[name]]
    if good and nodes and files.has("/dev/kfd"):
        return Evidence(
            f"{', '.join(good)} is on AMD's list of supported chips",
            found=True,
            devices=("/dev/kfd", *nodes),
            codecs=(_VAAPI_CODEC,),
        )
    if good:
        missing = "/dev/kfd or its render node is missing: a container?"
        return Evidence(f"{', '.join(good)}, but {missing}")
    if chips:
        return Evidence(f"{', '.join(chips)} is not on AMD's list of supported chips")
    return Evidence("no chip of AMD that computes")


def _chips(files: MachineFiles) -> dict[str, list[str]]:
    """Return the existing render nodes by LLVM's name of the chip, without processors, whose version is 0."""
    chips: dict[str, list[str]] = {}
    for name in files.names(_TOPOLOGY, r"[0-9]+"):
        text = files.text(f"{_TOPOLOGY}/{name}/properties") or ""
        version = _property(text, "gfx_target_version")
        if version:
            nodes = chips.setdefault(gfx_name(version), [])
            minor = _property(text, "drm_render_minor")
            nodes += files.paths("/dev/dri", f"renderD{minor}")
    return chips


def _property(text: str, name: str) -> int:
    found = re.search(rf"^{name} ([0-9]{{1,7}})$", text, re.MULTILINE)
    return int(found[1]) if found else 0


def gfx_name(gfx_target_version: int) -> str:
    """Return LLVM's name of an AMD chip, given the number ``gfx_target_version`` in a node's properties.

    The kernel writes ``major * 10000 + minor * 100 + stepping``; LLVM's name has minor and stepping as one
    hexadecimal digit each, as in 90010 for gfx90a (Linux, drivers/gpu/drm/amd/amdkfd/kfd_device.c; LLVM, User
    Guide for AMDGPU Backend).
    """
    major, rest = divmod(gfx_target_version, 10000)
    minor, stepping = divmod(rest, 100)
    return f"gfx{major}{minor:x}{stepping:x}"


def look_for_vaapi(files: MachineFiles) -> Evidence:
    """Search for graphics of Intel or AMD with a render node; VAAPI uses their video engine.

    The vendor is in ``/sys/class/drm/renderD*/device/vendor``. Nodes of other vendors, such as virtio or nouveau, do
    not count, because their codecs depend on the host or are insufficient.
    """
    nodes = {}
    for path in files.paths("/dev/dri", r"renderD[0-9]+"):
        vendor = files.text(f"/sys/class/drm/{path.rpartition('/')[2]}/device/vendor")
        nodes[path] = plain(vendor or "").lower()
    good = {path: vendor for path, vendor in nodes.items() if vendor in _VENDORS}
    if not good:
        none = "render nodes, but none of Intel or AMD" if nodes else "no /dev/dri/renderD*"
        return Evidence(none)
    codecs = [_VAAPI_CODEC]
    if _INTEL in good.values():
        codecs += [Codec("h264_qsv", role, _QUICK_SYNC) for role in CodecRole]
    makers = sorted({_VENDORS[vendor] for vendor in good.values()})
    reason = f"graphics of {' and '.join(makers)} with a video engine"
    return Evidence(reason, found=True, devices=tuple(good), codecs=tuple(codecs))


# Codecs of boards.

_H264 = {"bcm2835-codec-encode": CodecRole.ENCODER, "bcm2835-codec-decode": CodecRole.DECODER}
"""H.264 codecs of Raspberry Pi 4 and before (Raspberry Pi's kernel, bcm2835-v4l2-codec.c)."""
_HEVC = frozenset({"rpivid", "rpi-hevc-dec"})  # of Raspberry Pi 4 and 5
_CODEC = re.compile(r"(?:.*[-_ ])?(?:enc|encode|encoder|dec|decode|decoder)", re.IGNORECASE)


def look_for_v4l2(files: MachineFiles) -> Evidence:
    """Search for a V4L2 device node of a codec, by its driver's name in /sys/class/video4linux.

    A codec of any format counts, because base images differ by driver. It may not support H.264: a Raspberry
    Pi 5 has only an HEVC decoder (Raspberry Pi 5 Product Brief). Cameras and image processors are no codecs.
    """
    names = {}
    for path in files.paths("/dev", r"video[0-9]+"):
        text = files.text(f"/sys/class/video4linux/{path.removeprefix('/dev/')}/name")
        names[path] = plain(text or "")
    codecs = {n: name for n, name in names.items() if _CODEC.fullmatch(name) or name in _HEVC}
    if not codecs:
        return Evidence("no video device that is a codec")
    drivers = set(codecs.values())
    roles = [role for driver, role in _H264.items() if driver in drivers]
    if roles:
        reason = f"H.264 {' and '.join(role.value for role in roles)} in hardware"
    elif drivers <= _HEVC:
        reason = "an HEVC decoder only: the processor encodes and decodes H.264"
    else:
        reason = f"codecs of unknown formats ({', '.join(sorted(drivers))})"
    h264 = [Codec("h264_v4l2m2m", role, "stateful V4L2 codec of the board") for role in roles]
    return Evidence(reason, found=True, devices=tuple(codecs), codecs=tuple(h264))


def look_for_none(files: MachineFiles) -> Evidence:
    """Return the evidence for the processor, which is always present."""
    reason = "the processor is always there"
    if files.has("/.dockerenv") or files.has("/run/.containerenv"):
        reason += "; this is the root of a container, which has only the devices that it was given"
    return Evidence(reason, found=True)


TABLE: dict[Accelerator, Callable[[MachineFiles], Evidence]] = {
    Accelerator.JETSON: look_for_jetson,  # its libraries fit one L4T release and no other base
    Accelerator.CUDA: look_for_cuda,  # computes, encodes and decodes, beside other graphics
    Accelerator.ROCM: look_for_rocm,  # computes, and its base also has VAAPI
    Accelerator.VAAPI: look_for_vaapi,  # encodes and decodes H.264
    Accelerator.V4L2: look_for_v4l2,  # a single codec of the board, on some boards without H.264
    Accelerator.NONE: look_for_none,
}
"""The order of choice: the first accelerator that is found is taken."""


# Model and operating system.

_TREES = ("/proc/device-tree", "/sys/firmware/devicetree/base")  # the first is a link to the second


def _model(files: MachineFiles) -> str:
    """Return the device tree's model, otherwise 'unknown'."""
    for tree in _TREES:
        model = plain(files.text(f"{tree}/model") or "")
        if model:
            return model
    return "unknown"


def _operating_system(files: MachineFiles) -> str:
    """Return PRETTY_NAME of os-release(5), otherwise 'unknown'."""
    for path in ("/etc/os-release", "/usr/lib/os-release"):
        found = re.search(r"^PRETTY_NAME=(.*)$", files.text(path) or "", re.MULTILINE)
        name = plain(found[1]).strip("\"'") if found else ""
        if name:
            return name
    return "unknown"


# Codecs that open, and the report.

_SOFTWARE = (
    Codec("libx264", CodecRole.ENCODER, "the processor; in the wheels of PyAV"),
    Codec("h264", CodecRole.DECODER, "the processor; part of FFmpeg"),
)


def expected_codecs(machine: Machine) -> tuple[Codec, ...]:
    """Return the H.264 codecs of a machine's accelerator, then those of the processor."""
    return (*machine.evidence[machine.accelerator].codecs, *_SOFTWARE)


def codecs_found(machine: Machine) -> tuple[CodecFound, ...]:
    """Try all H.264 codecs of FFmpeg here, and return them beside those expected of a machine."""
    from sfglab.codecs.probe import available_decoders, available_encoders

    expected = {(codec.name, codec.role): codec.why for codec in expected_codecs(machine)}
    probes = [(probe, CodecRole.ENCODER) for probe in available_encoders()]
    probes += [(probe, CodecRole.DECODER) for probe in available_decoders()]
    found = []
    for probe, role in probes:
        why = expected.get((probe.name, role))
        codec = CodecFound(
            name=probe.name,
            role=role,
            expected=why is not None,
            works=probe.works,
            tried=probe.reason,
            why=why or "not expected on this machine",
        )
        found.append(codec)
    return tuple(found)


def render_machine(machine: Machine, codecs: Sequence[CodecFound] | None = None) -> str:
    """Return a report of a machine, with the result of `codecs_found` unless it is None."""
    rows = {
        "Model": machine.model,
        "Operating system": machine.operating_system,
        "JetPack": str(machine.jetpack or ""),
        "Accelerator": machine.accelerator.value,
        "Devices": ", ".join(machine.devices) or "none needed",
    }
    lines = [f"{title + ':':18}{text}" for title, text in rows.items() if text]
    lines += ["", "Accelerators, in order of preference:"]
    for accelerator, item in machine.evidence.items():
        mark = "*" if accelerator is machine.accelerator else " "
        found = "found" if item.found else "not found"
        lines.append(f"{mark} {accelerator.value:7} {found}: {item.reason}")
    if codecs is not None:
        lines += ["", "H.264 codecs, as PyAV opens them in this process:"]
        table = [("name", "role", "expected", "opens", "tried; why"), *map(_codec_row, codecs)]
        lines += [f"  {line}" for line in columns(table)]
    return "\n".join(lines) + "\n"


def _codec_row(codec: CodecFound) -> tuple[str, ...]:
    expected = "yes" if codec.expected else "no"
    works = "yes" if codec.works else "no"
    return codec.name, codec.role.value, expected, works, f"{codec.tried}; {codec.why}"

"""Accelerators of a machine: NVIDIA's Jetsons and cards, graphics of AMD and Intel, codecs behind V4L2."""

from __future__ import annotations

import re

from sfglab.deploy.hardware import board
from sfglab.deploy.hardware.board import MachineFiles, plain
from sfglab.deploy.hardware.machine import CodecRole, Evidence, ExpectedCodec, Source
from sfglab.fleet.fleet_file import Accelerator

JETPACKS = {28: 3, 31: 4, 32: 4, 34: 5, 35: 5, 36: 6, 38: 7, 39: 7}
"""Major version of JetPack by that of Jetson Linux, or L4T.

Source: docs.nvidia.com/jetson/archives, developer.nvidia.com/embedded/jetpack.
"""

_RELEASE_FILE = "/etc/nv_tegra_release"
_RELEASE = re.compile(r"#\s*R([0-9]{1,3})\s*\(release\),\s*REVISION:\s*([0-9][0-9.]{0,15})")
_DRIVER_FILE = "/proc/driver/nvidia/version"
_DRIVER = re.compile(r"Kernel Module(?: for \w+)?\s+([0-9]+(?:\.[0-9]+)+)")


def find_jetson(files: MachineFiles) -> Evidence:
    """Return whether this is a Jetson whose engines can be reached.

    The board says so by its device tree (``nvidia,tegra*``) or L4T by its release file; engines are reached
    through ``/dev/nvmap`` and ``/dev/nvhost-*`` (L4T's list of what a container is given,
    /etc/nvidia-container-runtime/host-files-for-container.d).
    """
    nodes = files.paths("/dev", r"nvhost-[A-Za-z0-9_-]+|nvmap")
    signs = [sign for sign in (_tegra(files), _release(files)) if sign]
    sources = (*signs, *(Source(path=path) for path in nodes[:3]))
    if not signs:
        return Evidence(
            accelerator=Accelerator.JETSON, found=False, reason="no Tegra board and no L4T release"
        )
    if not nodes:
        reason = "a Jetson by its files, but no /dev/nvmap or /dev/nvhost-*: a container without NVIDIA's runtime?"
        return Evidence(accelerator=Accelerator.JETSON, found=False, reason=reason, sources=sources)
    return Evidence(
        accelerator=Accelerator.JETSON,
        found=True,
        reason=_jetpack_text(files),
        sources=sources,
        devices=_jetson_devices(files, nodes),
        codecs=_jetson_codecs(files),
    )


def find_jetpack(files: MachineFiles) -> int | None:
    """Return JetPack's major version, which the base image must fit; None where it is not known."""
    release = _l4t(files)
    return JETPACKS.get(release[0]) if release else None


def find_cuda(files: MachineFiles) -> Evidence:
    """Return whether there is a card with NVIDIA's driver.

    The driver is there when ``/proc/driver/nvidia/version`` is, a card when ``/dev/nvidia0`` is, and both are
    used through ``/dev/nvidiactl`` (NVIDIA Accelerated Linux Graphics Driver README, 'Additional Information').
    Under WSL 2 there is ``/dev/dxg`` instead, for cards of all makers, and NVIDIA's is told by the libcuda that
    Windows' driver puts below /usr/lib/wsl/lib (CUDA on WSL User Guide). A card without driver is found on the
    PCI bus by its maker. Jetsons have the same nodes for their display, so there they do not count.
    """
    windows = _wsl(files)
    if windows is not None:
        return windows
    driver, control = files.text(_DRIVER_FILE), files.has("/dev/nvidiactl")
    cards = files.paths("/dev", r"nvidia[0-9]+")
    known = (
        [] if driver is None else [Source(path=_DRIVER_FILE, says=plain(driver.partition("\n")[0]))]
    )
    nodes = [Source(path=path) for path in ["/dev/nvidiactl"] * control + cards]
    sources = (*known, *nodes, *board.display_controllers(files, board.NVIDIA))
    if _tegra(files):
        reason = (
            "a Tegra: its /dev/nvidia* belong to the display"
            if sources
            else "a Tegra has no card's driver"
        )
        return Evidence(accelerator=Accelerator.CUDA, found=False, reason=reason, sources=sources)
    if driver is not None and control and cards:
        version = _DRIVER.search(driver)
        text = f"NVIDIA's driver {version[1] if version else 'of unknown version'} with {len(cards)} card(s)"
        extra = files.paths("/dev", r"nvidia-(uvm|uvm-tools|modeset)")
        return _cuda(text, sources, (*cards, "/dev/nvidiactl", *extra))
    reason = _why_no_cuda(
        driver=driver is not None, control=control, cards=bool(cards), sources=sources
    )
    return Evidence(accelerator=Accelerator.CUDA, found=False, reason=reason, sources=sources)


def _cuda(reason: str, sources: tuple[Source, ...], devices: tuple[str, ...]) -> Evidence:
    needs = "needs the driver's library from the host; cards for computing only, as A100, have no encoder"
    return Evidence(
        accelerator=Accelerator.CUDA,
        found=True,
        reason=reason,
        sources=sources,
        devices=devices,
        codecs=(
            ExpectedCodec(
                name="h264_nvenc", role=CodecRole.ENCODER, why=f"NVENC on the card; {needs}"
            ),
            ExpectedCodec(name="h264_cuvid", role=CodecRole.DECODER, why="NVDEC on the card"),
        ),
    )


def _wsl(files: MachineFiles) -> Evidence | None:
    """Return what WSL 2 has; None where this is not WSL 2."""
    if not files.has("/dev/dxg"):
        return None
    libraries = files.paths("/usr/lib/wsl/lib", r"libcuda\.so[0-9.]*")
    sources = (
        Source(path="/dev/dxg", says="WSL 2"),
        *(Source(path=path) for path in libraries[:1]),
    )
    if libraries:
        return _cuda("Windows' NVIDIA driver, through WSL 2", sources, ("/dev/dxg",))
    reason = "WSL 2 with a graphics card, but no libcuda below /usr/lib/wsl/lib: the card is not NVIDIA's"
    return Evidence(accelerator=Accelerator.CUDA, found=False, reason=reason, sources=sources)


def _why_no_cuda(*, driver: bool, control: bool, cards: bool, sources: tuple[Source, ...]) -> str:
    if not sources:
        return "no driver of NVIDIA and no card of NVIDIA on the PCI bus"
    missing = {_DRIVER_FILE: driver, "/dev/nvidiactl": control, "/dev/nvidia0": cards}
    absent = ", ".join(path for path, there in missing.items() if not there)
    if driver:
        return f"NVIDIA's driver runs, but without {absent}: a container without the card, or no nvidia-modprobe"
    return f"a card is there but not usable: without {absent}, NVIDIA's driver does not run; install it"


def _tegra(files: MachineFiles) -> Source | None:
    return board.find_compatible(files, "nvidia,tegra")


def _l4t(files: MachineFiles) -> tuple[int, str] | None:
    found = _RELEASE.search(files.text(_RELEASE_FILE) or "")
    return (int(found[1]), f"{found[1]}.{found[2].rstrip('.')}") if found else None


def _release(files: MachineFiles) -> Source | None:
    if files.text(_RELEASE_FILE) is None:
        return None
    found = _l4t(files)
    return Source(
        path=_RELEASE_FILE, says=f"L4T {found[1]}" if found else "its text is not understood"
    )


def _jetpack_text(files: MachineFiles) -> str:
    found = _l4t(files)
    if found is None:
        return "a Jetson; which JetPack is not known, because /etc/nv_tegra_release says no release"
    jetpack = JETPACKS.get(found[0])
    if jetpack is None:
        return f"a Jetson with L4T {found[1]}, whose JetPack is not known here"
    return f"a Jetson with L4T {found[1]}, that is JetPack {jetpack}"


def _jetson_devices(files: MachineFiles, nodes: list[str]) -> tuple[str, ...]:
    """Return the nodes of engines, memory, graphics and V4L2 codecs; cameras are the fleet file's business."""
    gpus = [
        path for gpu in files.paths("/dev/nvgpu", r"[\w-]+") for path in files.paths(gpu, r"[\w-]+")
    ]
    others = files.paths("/dev", r"nvidia[0-9]+|nvidiactl|nvidia-modeset|v4l2-nv(dec|enc)")
    return (*nodes, *gpus, *others, *files.paths("/dev/dri", r"renderD[0-9]+"))


def _jetson_codecs(files: MachineFiles) -> tuple[ExpectedCodec, ...]:
    """Return what NVENC and NVDEC do; Orin Nano has no NVENC (NVIDIA, Jetson Orin Nano Series Data Sheet)."""
    engines = {CodecRole.ENCODER: "NVENC", CodecRole.DECODER: "NVDEC"}
    if "Orin Nano" in board.find_model(files):
        del engines[CodecRole.ENCODER]
    source = "of the jetson-ffmpeg project's FFmpeg; the wheels of PyAV on PyPI lack it"
    return tuple(
        ExpectedCodec(name="h264_nvmpi", role=role, why=f"{engine} on the chip; {source}")
        for role, engine in engines.items()
    )


ROCM_TARGETS = frozenset(
    {"gfx908", "gfx90a", "gfx942", "gfx1030", "gfx1100", "gfx1101", "gfx1200", "gfx1201"}
)
"""Chips on AMD's list of supported GPUs, for ROCm 6.4 ('System requirements (Linux)', column LLVM target).

Read from the list of an earlier 6.x and the release notes of 6.4.1; gfx1101 is from memory: compare before use.
The Dockerfile's base must be of this release or a later one. Others may compute with HSA_OVERRIDE_GFX_VERSION,
which AMD calls unofficial; we do not count them.
"""

_TOPOLOGY = "/sys/class/kfd/kfd/topology/nodes"


def gfx_name(gfx_target_version: int) -> str:
    """Return LLVM's name of a chip by the number in a node's properties.

    The kernel writes ``major * 10000 + minor * 100 + stepping``; LLVM's name has minor and stepping as one
    hexadecimal digit each, as in 90010 for gfx90a (Linux, drivers/gpu/drm/amd/amdkfd/kfd_device.c; LLVM, User
    Guide for AMDGPU Backend).
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
            codecs=_vaapi_codecs(frozenset({board.AMD})),
        )
    reason = _why_no_rocm(node=node, chips=[name for _, name, _ in chips], good=names)
    return Evidence(accelerator=Accelerator.ROCM, found=False, reason=reason, sources=sources)


def find_vaapi(files: MachineFiles) -> Evidence:
    """Return whether there is graphics of Intel or AMD with a render node, whose video engine VAAPI drives.

    The maker is ``/sys/class/drm/renderD*/device/vendor``, which a Raspberry Pi's v3d lacks. Others' nodes, as
    virtio's or nouveau's, do not count: what they offer depends on the host, or is too little.
    """
    nodes = [
        (path, board.read_id(files, f"/sys/class/drm/{path.rpartition('/')[2]}/device/vendor"))
        for path in files.paths("/dev/dri", r"renderD[0-9]+")
    ]
    sources = tuple(
        Source(path=path, says=board.VENDORS.get(vendor, vendor or "no PCI device"))
        for path, vendor in nodes
    )
    good = [(path, vendor) for path, vendor in nodes if vendor in {board.AMD, board.INTEL}]
    if good:
        makers = " and ".join(sorted({board.VENDORS[vendor] for _, vendor in good}))
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
            source = Source(path=path, says=f"gfx_target_version {version}, that is {chip}")
            chips.append((source, chip, f"/dev/dri/renderD{minor}" if minor else ""))
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
    return (
        f"/dev/kfd, but no chip in {_TOPOLOGY}"
        if node
        else "no /dev/kfd and no chip of AMD that computes"
    )


def _vaapi_codecs(vendors: frozenset[str]) -> tuple[ExpectedCodec, ...]:
    """Return VAAPI's encoder and Intel's Quick Sync; VAAPI decodes inside FFmpeg's ``h264``, without a name."""
    why = "video engine of the graphics; needs Mesa's or Intel's VA driver in the image"
    both = [ExpectedCodec(name="h264_vaapi", role=CodecRole.ENCODER, why=why)]
    if board.INTEL in vendors:
        why = "Intel's Quick Sync; needs oneVPL's or Media SDK's runtime in the image"
        both += [ExpectedCodec(name="h264_qsv", role=role, why=why) for role in CodecRole]
    return tuple(both)


_H264 = {"bcm2835-codec-decode": CodecRole.DECODER, "bcm2835-codec-encode": CodecRole.ENCODER}
"""H.264 codecs of Raspberry Pi 4 and before (Raspberry Pi's kernel, bcm2835-v4l2-codec.c)."""

#: The HEVC decoder of Raspberry Pi 4 and 5, by driver.
_HEVC = frozenset({"rpivid", "rpi-hevc-dec"})

_CODEC = re.compile(r"(?:.*[-_ ])?(?:enc|encode|encoder|dec|decode|decoder)", re.IGNORECASE)


def find_v4l2(files: MachineFiles) -> Evidence:
    """Return whether a V4L2 device node is a codec, by its driver's name in /sys/class/video4linux.

    A codec of any format makes the machine one for V4L2, because base images differ by driver; the reason says
    what it does for H.264, which may be nothing: a Raspberry Pi 5 has an HEVC decoder alone (Raspberry Pi 5
    Product Brief: '4Kp60 HEVC decoder'). Cameras and image processors, as pispbe and bcm2835-isp, are no
    codecs.
    """
    nodes = _video_nodes(files)
    codecs = {
        path: n for path, n in nodes.items() if n in _H264 or n in _HEVC or _CODEC.fullmatch(n)
    }
    if not codecs:
        seen = f"{len(nodes)} video device(s), but none is a codec" if nodes else "no video device"
        return Evidence(accelerator=Accelerator.V4L2, found=False, reason=seen)
    names = set(codecs.values())
    roles = [role for role in CodecRole if role in {_H264.get(name) for name in names}]
    why = "stateful V4L2 codec of the board"
    return Evidence(
        accelerator=Accelerator.V4L2,
        found=True,
        reason=_h264_text(roles, names),
        sources=tuple(Source(path=path, says=name) for path, name in codecs.items()),
        devices=tuple(codecs),
        codecs=tuple(ExpectedCodec(name="h264_v4l2m2m", role=role, why=why) for role in roles),
    )


def _video_nodes(files: MachineFiles) -> dict[str, str]:
    """Return drivers' names by device node; a node without a name is of no use."""
    named = "/sys/class/video4linux/{}/name"
    paths = files.paths("/dev", r"video[0-9]+")
    names = {
        path: plain(files.text(named.format(path.removeprefix("/dev/"))) or "") for path in paths
    }
    return {path: name for path, name in names.items() if name}


def _h264_text(roles: list[CodecRole], names: set[str]) -> str:
    if roles:
        return f"H.264 {' and '.join(role.value for role in roles)} in hardware"
    if names <= _HEVC:
        return "an HEVC decoder only: H.264 is encoded and decoded by the processor"
    return f"codecs whose formats are not known without opening them ({', '.join(sorted(names))})"

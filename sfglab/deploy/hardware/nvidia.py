"""NVIDIA's two kinds of accelerator: a Jetson's, which is part of its chip, and a card's.

Refuses to know what an image needs beside the device nodes: on both kinds the user-space libraries come from
the host through NVIDIA's container runtime.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from sfglab.deploy.hardware.board import display_controllers, find_compatible, find_model
from sfglab.deploy.hardware.files import plain
from sfglab.deploy.hardware.machine import CodecRole, Evidence, ExpectedCodec, Source
from sfglab.fleet.fleet_file import Accelerator

if TYPE_CHECKING:
    from sfglab.deploy.hardware.files import MachineFiles


JETPACKS = {28: 3, 31: 4, 32: 4, 34: 5, 35: 5, 36: 6, 38: 7, 39: 7}
"""Major version of JetPack by that of Jetson Linux, or L4T.

Source: docs.nvidia.com/jetson/archives, developer.nvidia.com/embedded/jetpack.
"""

NVIDIA = "0x10de"

_RELEASE_FILE = "/etc/nv_tegra_release"
_RELEASE = re.compile(r"#\s*R([0-9]{1,3})\s*\(release\),\s*REVISION:\s*([0-9][0-9.]{0,15})")
_DRIVER_FILE = "/proc/driver/nvidia/version"
_DRIVER = re.compile(r"Kernel Module(?: for \w+)?\s+([0-9]+(?:\.[0-9]+)+)")
_TEGRA_NODES = r"nvhost-[A-Za-z0-9_-]+|nvmap"
_NOT_PYPI = "of the jetson-ffmpeg project's FFmpeg; the wheels of PyAV on PyPI lack it"


def find_jetson(files: MachineFiles) -> Evidence:
    """Return whether this is a Jetson whose engines can be reached.

    The board says so by its device tree (``nvidia,tegra*``) or L4T by its release file; engines are reached
    through ``/dev/nvmap`` and ``/dev/nvhost-*`` (L4T's list of what a container is given,
    /etc/nvidia-container-runtime/host-files-for-container.d).
    """
    nodes = files.paths("/dev", _TEGRA_NODES)
    signs = [sign for sign in (_tegra(files), _release(files)) if sign]
    sources = (*signs, *(Source(path=path) for path in nodes[:3]))
    if not signs:
        return Evidence(accelerator=Accelerator.JETSON, found=False, reason="no Tegra board and no L4T release")
    if not nodes:
        reason = (
            "a Jetson by its files, but no /dev/nvmap or /dev/nvhost-*: a container without NVIDIA's runtime?"
        )
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
    sources = _cuda_sources(files, driver, ["/dev/nvidiactl"] * control + cards)
    if _tegra(files):
        reason = (
            "a Tegra: its /dev/nvidia* belong to the display" if sources else "a Tegra has no card's driver"
        )
        return Evidence(accelerator=Accelerator.CUDA, found=False, reason=reason, sources=sources)
    if driver is not None and control and cards:
        version = _DRIVER.search(driver)
        text = f"NVIDIA's driver {version[1] if version else 'of unknown version'} with {len(cards)} card(s)"
        extra = files.paths("/dev", r"nvidia-(uvm|uvm-tools|modeset)")
        nodes = (*cards, "/dev/nvidiactl", *extra)
        return _cuda(text, sources, nodes)
    reason = _why_no_cuda(driver=driver is not None, control=control, cards=bool(cards), sources=sources)
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
            ExpectedCodec(name="h264_nvenc", role=CodecRole.ENCODER, why=f"NVENC on the card; {needs}"),
            ExpectedCodec(name="h264_cuvid", role=CodecRole.DECODER, why="NVDEC on the card"),
        ),
    )


def _wsl(files: MachineFiles) -> Evidence | None:
    """Return what WSL 2 has; None where this is not WSL 2."""
    if not files.has("/dev/dxg"):
        return None
    libraries = files.paths("/usr/lib/wsl/lib", r"libcuda\.so[0-9.]*")
    sources = (Source(path="/dev/dxg", says="WSL 2"), *(Source(path=path) for path in libraries[:1]))
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
        return (
            f"NVIDIA's driver runs, but without {absent}: a container without the card, or no nvidia-modprobe"
        )
    return f"a card is there but not usable: without {absent}, NVIDIA's driver does not run; install it"


def _cuda_sources(files: MachineFiles, driver: str | None, nodes: list[str]) -> tuple[Source, ...]:
    known = [] if driver is None else [Source(path=_DRIVER_FILE, says=plain(driver.partition("\n")[0]))]
    cards = display_controllers(files, NVIDIA)
    return (*known, *(Source(path=path) for path in nodes), *cards)


def _tegra(files: MachineFiles) -> Source | None:
    return find_compatible(files, "nvidia,tegra")


def _l4t(files: MachineFiles) -> tuple[int, str] | None:
    found = _RELEASE.search(files.text(_RELEASE_FILE) or "")
    return (int(found[1]), f"{found[1]}.{found[2].rstrip('.')}") if found else None


def _release(files: MachineFiles) -> Source | None:
    if files.text(_RELEASE_FILE) is None:
        return None
    found = _l4t(files)
    return Source(path=_RELEASE_FILE, says=f"L4T {found[1]}" if found else "its text is not understood")


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
    gpus = [path for gpu in files.paths("/dev/nvgpu", r"[\w-]+") for path in files.paths(gpu, r"[\w-]+")]
    others = files.paths("/dev", r"nvidia[0-9]+|nvidiactl|nvidia-modeset|v4l2-nv(dec|enc)")
    return (*nodes, *gpus, *others, *files.paths("/dev/dri", r"renderD[0-9]+"))


def _jetson_codecs(files: MachineFiles) -> tuple[ExpectedCodec, ...]:
    """Return what NVDEC and NVENC do; Orin Nano has no NVENC (NVIDIA, Jetson Orin Nano Series Data Sheet)."""
    decoder = ExpectedCodec(name="h264_nvmpi", role=CodecRole.DECODER, why=f"NVDEC on the chip; {_NOT_PYPI}")
    encoder = ExpectedCodec(name="h264_nvmpi", role=CodecRole.ENCODER, why=f"NVENC on the chip; {_NOT_PYPI}")
    return (decoder,) if "Orin Nano" in find_model(files) else (encoder, decoder)

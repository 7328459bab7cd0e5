"""Machines to try detection on, none a copy of a real one: the few files that it looks at, and their source."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.fleet.fleet_file import Accelerator

if TYPE_CHECKING:
    from collections.abc import Mapping
    from pathlib import Path


@dataclass(frozen=True, slots=True, kw_only=True)
class ExampleMachine:
    """A machine made up from documentation."""

    files: Mapping[str, str]  #: Contents by path below its root; empty for device nodes.
    links: Mapping[str, str]  #: Targets of symbolic links by path below its root.
    expected: Accelerator  #: The accelerator that its images must be made for.


def write_example(example: ExampleMachine, folder: Path) -> Path:
    """Write an example's files into a folder, its root for `detect`."""
    contents = {path: text.encode() for path, text in example.files.items()}
    for path in (*contents, *example.links):
        place = folder / path
        place.parent.mkdir(parents=True, exist_ok=True)
        if path in example.links:
            place.symlink_to(example.links[path])
        else:
            place.write_bytes(contents[path])
    return folder


def _made(
    expected: Accelerator,
    system: str,
    *parts: Mapping[str, str],
    links: Mapping[str, str] | None = None,
) -> ExampleMachine:
    """Return a machine; links are those of its device tree, unless they are given."""
    files = {"etc/os-release": f'NAME="Linux"\nPRETTY_NAME="{system}"\n'}
    for part in parts:
        files |= part
    is_board = f"{_TREE}/model" in files
    return ExampleMachine(
        files=files,
        links=links or (_TREE_LINK if is_board else {}),
        expected=expected,
    )


_TREE = "sys/firmware/devicetree/base"
_TREE_LINK = {"proc/device-tree": "/sys/firmware/devicetree/base"}
_KFD = "sys/class/kfd/kfd/topology/nodes"


def _board(model: str, *compatible: str) -> dict[str, str]:
    names = "".join(f"{name}\0" for name in compatible)
    return {f"{_TREE}/model": f"{model}\0", f"{_TREE}/compatible": names}


def _nodes(*names: str) -> dict[str, str]:
    return {f"dev/{name}": "" for name in names}


def _graphics(minor: int, vendor: str) -> dict[str, str]:
    device = f"sys/class/drm/renderD{minor}/device"
    return {
        **_nodes(f"dri/card{minor - 128}", f"dri/renderD{minor}"),
        f"{device}/vendor": f"{vendor}\n",
    }


def _kfd(node: int, version: int, minor: int) -> dict[str, str]:
    processor = "cpu_cores_count 16\nsimd_count 0\ngfx_target_version 0\n"
    graphics = (
        f"cpu_cores_count 0\nsimd_count 8\ngfx_target_version {version}\ndrm_render_minor {minor}\n"
    )
    return {f"{_KFD}/0/properties": processor, f"{_KFD}/{node}/properties": graphics, "dev/kfd": ""}


def _videos(names: Mapping[int, str]) -> dict[str, str]:
    classes = {
        f"sys/class/video4linux/video{number}/name": f"{name}\n" for number, name in names.items()
    }
    return {**_nodes(*(f"video{number}" for number in names)), **classes}


_NVIDIA_NODES = _nodes("nvidia0", "nvidiactl", "nvidia-modeset", "nvidia-uvm", "nvidia-uvm-tools")
_NVIDIA_DRIVER = {
    "proc/driver/nvidia/version": (
        "NVRM version: NVIDIA UNIX Open Kernel Module for x86_64  565.57.01  Release Build\n"
        "GCC version:  gcc version 13.3.0 (Ubuntu 13.3.0-6ubuntu2~24.04)\n"
    ),
}

EXAMPLES: dict[str, ExampleMachine] = {
    "jetson_orin_nx": _made(
        # Jetson Orin NX, JetPack 6.2: Linux' device tree bindings (tegra.yaml), L4T R36's files
        Accelerator.JETSON,
        "Ubuntu 22.04.5 LTS",
        _board(
            "NVIDIA Jetson Orin NX Engineering Reference Developer Kit",
            *("nvidia,p3768-0000+p3767-0000", "nvidia,p3767-0000", "nvidia,tegra234"),
        ),
        {
            "etc/nv_tegra_release": "# R36 (release), REVISION: 4.3, GCID: 38968081, BOARD: generic, "
            "EABI: aarch64, DATE: Wed Jan  8 01:49:37 UTC 2025\n# KERNEL_VARIANT: oot\n"
        },
        _nodes("nvmap", "nvhost-ctrl-gpu", "nvhost-gpu", "nvhost-nvdec", "nvgpu/igpu0/ctrl"),
        _nodes("nvidia0", "nvidiactl", "nvidia-modeset", "v4l2-nvdec", "v4l2-nvenc"),
        _nodes("dri/card0", "dri/renderD128"),
        _videos({0: "vi-output, imx219 9-0010"}),
    ),
    "jetson_xavier_nx": _made(
        # Jetson Xavier NX, JetPack 4.6: L4T R32's files
        Accelerator.JETSON,
        "Ubuntu 18.04.6 LTS",
        _board(
            "NVIDIA Jetson Xavier NX Developer Kit",
            "nvidia,p3449-0000+p3668-0000",
            "nvidia,tegra194",
        ),
        {
            "etc/nv_tegra_release": "# R32 (release), REVISION: 7.1, GCID: 29818004, BOARD: t186ref, "
            "EABI: aarch64, DATE: Sat Feb 19 17:07:00 UTC 2022\n"
        },
        _nodes("nvmap", "nvhost-ctrl", "nvhost-gpu", "nvhost-msenc", "nvhost-nvdec", "nvidiactl"),
    ),
    "workstation_rtx": _made(
        # Workstation with an RTX card beside an AMD processor's graphics: NVIDIA's README, amdgpu
        Accelerator.CUDA,
        "Ubuntu 24.04.1 LTS",
        _NVIDIA_NODES,
        _NVIDIA_DRIVER,
        _graphics(128, "0x10de"),
        _graphics(129, "0x1002"),
        _kfd(1, 100306, 129),
    ),
    "nvidia_without_driver": _made(
        # PC with an NVIDIA card that nouveau drives: Linux, sysfs-bus-pci
        Accelerator.NONE,
        "Debian GNU/Linux 12 (bookworm)",
        _graphics(128, "0x10de"),
    ),
    "desktop_rocm": _made(
        # Desktop with a Radeon RX 7900 XTX, gfx1100: AMD's list of supported GPUs, amdkfd's sysfs
        Accelerator.ROCM,
        "Ubuntu 24.04.1 LTS",
        _graphics(128, "0x1002"),
        _kfd(1, 110000, 128),
    ),
    "steam_deck": _made(
        # Steam Deck OLED, whose gfx1033 has /dev/kfd but is not on AMD's list: amdkfd
        Accelerator.VAAPI,
        "SteamOS",
        _graphics(128, "0x1002"),
        _kfd(1, 100303, 128),
    ),
    "laptop_intel": _made(
        # Laptop with Intel's graphics and a camera: i915, uvcvideo
        Accelerator.VAAPI,
        "Fedora Linux 41 (Workstation Edition)",
        _graphics(128, "0x8086"),
        _videos({0: "Integrated Camera: Integrated C"}),
    ),
    "raspberry_pi_5": _made(
        # Raspberry Pi 5: its kernel's drivers rpi-hevc-dec and pispbe; v3d is no PCI device
        Accelerator.V4L2,
        "Debian GNU/Linux 12 (bookworm)",
        _board("Raspberry Pi 5 Model B Rev 1.0", "raspberrypi,5-model-b", "brcm,bcm2712"),
        _nodes("dri/card0", "dri/card1", "dri/renderD128"),
        _videos({19: "rpi-hevc-dec", 20: "pispbe-input", 21: "pispbe-tdn_input"}),
    ),
    "raspberry_pi_4": _made(
        # Raspberry Pi 4: its kernel's driver bcm2835-codec, one node for each role
        Accelerator.V4L2,
        "Debian GNU/Linux 12 (bookworm)",
        _board("Raspberry Pi 4 Model B Rev 1.4", "raspberrypi,4-model-b", "brcm,bcm2711"),
        _nodes("dri/card0", "dri/renderD128"),
        _videos(
            {
                10: "bcm2835-codec-decode",
                11: "bcm2835-codec-encode",
                12: "bcm2835-codec-isp",
                13: "bcm2835-isp0-output0",
                18: "bcm2835-codec-image_fx",
                19: "rpivid",
            }
        ),
    ),
    "wsl2": _made(
        # WSL 2 on Windows with NVIDIA's driver: NVIDIA, CUDA on WSL User Guide
        Accelerator.CUDA,
        "Ubuntu 22.04.5 LTS",
        _nodes("dxg"),
        {"usr/lib/wsl/lib/libcuda.so.1.1": ""},
        links={"usr/lib/wsl/lib/libcuda.so.1": "libcuda.so.1.1"},
    ),
    "container": _made(
        # Container without devices on an RTX workstation: Docker's mark, the host's /proc and /sys
        Accelerator.NONE,
        "Ubuntu 24.04.1 LTS",
        {".dockerenv": ""},
        _NVIDIA_DRIVER,
        {"sys/class/drm/renderD128/device/vendor": "0x10de\n"},
    ),
    "riscv_board": _made(
        # VisionFive 2, a RISC-V board that there are no images for: Linux, jh7110 device tree
        Accelerator.NONE,
        "Debian GNU/Linux trixie/sid",
        _board("StarFive VisionFive 2 v1.3B", "starfive,visionfive-2-v1.3b", "starfive,jh7110"),
    ),
}
"""Machines by name; the paper's test bed has the first, a workstation, a Steam Deck and Raspberry Pi 5."""

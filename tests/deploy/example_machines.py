"""Machines to try detection on, none a copy of a real one: the few files that it looks at, and their source."""

_LINK = "-> "  # before the target of a link, as ls writes it


def write_example(name, folder, **changes):
    """Write an example's files into a folder, its root for `detect`: changed, or left out if None."""
    for path, text in (EXAMPLES[name] | changes).items():
        place = folder / path
        place.parent.mkdir(parents=True, exist_ok=True)
        if text is not None and text.startswith(_LINK):
            place.symlink_to(text.removeprefix(_LINK))
        elif text is not None:
            place.write_text(text)
    return folder


_TREE = "sys/firmware/devicetree/base"
_KFD = "sys/class/kfd/kfd/topology/nodes"


def _board(model, compatible):
    names = compatible.replace(" ", "\0")
    link = {"proc/device-tree": f"{_LINK}/{_TREE}"}
    return link | {f"{_TREE}/model": f"{model}\0", f"{_TREE}/compatible": f"{names}\0"}


def _nodes(names):
    return {f"dev/{name}": "" for name in names.split()}


def _graphics(minor, vendor):
    device = f"sys/class/drm/renderD{minor}/device"
    return {f"{device}/vendor": f"{vendor}\n"} | _nodes(f"dri/card{minor - 128} dri/renderD{minor}")


def _kfd(version, minor):
    processor = "cpu_cores_count 16\nsimd_count 0\ngfx_target_version 0\n"
    graphics = (
        f"cpu_cores_count 0\nsimd_count 8\ngfx_target_version {version}\ndrm_render_minor {minor}\n"
    )
    return {f"{_KFD}/0/properties": processor, f"{_KFD}/1/properties": graphics, "dev/kfd": ""}


def _videos(**names):
    files = _nodes(" ".join(names))
    for node, name in names.items():
        files[f"sys/class/video4linux/{node}/name"] = f"{name}\n"
    return files


_NVIDIA_DRIVER = {
    "proc/driver/nvidia/version": (
        "NVRM version: NVIDIA UNIX Open Kernel Module for x86_64  565.57.01  Release Build\n"
        "GCC version:  gcc version 13.3.0 (Ubuntu 13.3.0-6ubuntu2~24.04)\n"
    ),
}

EXAMPLES = {
    # Jetson Orin NX, JetPack 6.2: Linux' device tree bindings (tegra.yaml), L4T R36's files
    "jetson_orin_nx": _board(
        "NVIDIA Jetson Orin NX Engineering Reference Developer Kit",
        "nvidia,p3768-0000+p3767-0000 nvidia,p3767-0000 nvidia,tegra234",
    )
    | _nodes("nvmap nvhost-ctrl-gpu nvhost-gpu nvhost-nvdec nvgpu/igpu0/ctrl nvidia0 nvidiactl")
    | _nodes("nvidia-modeset v4l2-nvdec v4l2-nvenc dri/card0 dri/renderD128")
    | _videos(video0="vi-output, imx219 9-0010")
    | {
        "etc/os-release": 'NAME="Linux"\nPRETTY_NAME="Ubuntu 22.04.5 LTS"\n',
        "etc/nv_tegra_release": "# R36 (release), REVISION: 4.3, GCID: 38968081, BOARD: generic, "
        "EABI: aarch64, DATE: Wed Jan  8 01:49:37 UTC 2025\n# KERNEL_VARIANT: oot\n",
    },
    # Jetson Xavier NX, JetPack 4.6: L4T R32's files
    "jetson_xavier_nx": _board(
        "NVIDIA Jetson Xavier NX Developer Kit", "nvidia,p3449-0000+p3668-0000 nvidia,tegra194"
    )
    | _nodes("nvmap nvhost-ctrl nvhost-gpu nvhost-msenc nvhost-nvdec nvidiactl")
    | {
        "etc/nv_tegra_release": "# R32 (release), REVISION: 7.1, GCID: 29818004, BOARD: t186ref, "
        "EABI: aarch64, DATE: Sat Feb 19 17:07:00 UTC 2022\n"
    },
    # Workstation with an RTX card beside an AMD processor's graphics: NVIDIA's README, amdgpu
    "workstation_rtx": _nodes("nvidia0 nvidiactl nvidia-modeset nvidia-uvm nvidia-uvm-tools")
    | _NVIDIA_DRIVER
    | _graphics(128, "0x10de")
    | _graphics(129, "0x1002")
    | _kfd(100306, 129),
    # PC with an NVIDIA card that nouveau drives: Linux, sysfs-bus-pci
    "nvidia_without_driver": _graphics(128, "0x10de"),
    # Desktop with a Radeon RX 7900 XTX, gfx1100: AMD's list of supported GPUs, amdkfd's sysfs
    "desktop_rocm": _graphics(128, "0x1002") | _kfd(110000, 128),
    # Steam Deck OLED, whose gfx1033 has /dev/kfd but is not on AMD's list: amdkfd
    "steam_deck": _graphics(128, "0x1002") | _kfd(100303, 128),
    # Laptop with Intel's graphics and a camera: i915, uvcvideo
    "laptop_intel": _graphics(128, "0x8086") | _videos(video0="Integrated Camera: Integrated C"),
    # Raspberry Pi 5: its kernel's drivers rpi-hevc-dec and pispbe; v3d is no PCI device
    "raspberry_pi_5": _board("Raspberry Pi 5 Model B Rev 1.0", "raspberrypi,5-model-b brcm,bcm2712")
    | _nodes("dri/card0 dri/card1 dri/renderD128")
    | _videos(video19="rpi-hevc-dec", video20="pispbe-input", video21="pispbe-tdn_input"),
    # Raspberry Pi 4: its kernel's driver bcm2835-codec, one node for each role
    "raspberry_pi_4": _board("Raspberry Pi 4 Model B Rev 1.4", "raspberrypi,4-model-b brcm,bcm2711")
    | _nodes("dri/card0 dri/renderD128")
    | _videos(
        video10="bcm2835-codec-decode",
        video11="bcm2835-codec-encode",
        video12="bcm2835-codec-isp",
        video13="bcm2835-isp0-output0",
        video18="bcm2835-codec-image_fx",
        video19="rpivid",
    ),
    # WSL 2 on Windows with NVIDIA's driver: NVIDIA, CUDA on WSL User Guide
    "wsl2": {
        "dev/dxg": "",
        "usr/lib/wsl/lib/libcuda.so.1.1": "",
        "usr/lib/wsl/lib/libcuda.so.1": f"{_LINK}libcuda.so.1.1",
    },
    # Container without devices on an RTX workstation: Docker's mark, the host's /proc and /sys
    "container": _NVIDIA_DRIVER
    | {".dockerenv": "", "sys/class/drm/renderD128/device/vendor": "0x10de\n"},
    # VisionFive 2, a RISC-V board that there are no images for: Linux, jh7110 device tree
    "riscv_board": _board(
        "StarFive VisionFive 2 v1.3B", "starfive,visionfive-2-v1.3b starfive,jh7110"
    ),
}
"""Files by path below the root, empty for device nodes, of machines by name.

The paper's test bed has the first, a workstation, a Steam Deck and Raspberry Pi 5.
"""

"""What a machine has, found out from here: detection runs on copies of the few files that it reads.

Nothing has to be installed on the machine for it.
"""

from __future__ import annotations

import base64
import tempfile
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.deploy.errors import DeployError
from sfglab.deploy.hardware import detect
from sfglab.deploy.images import JETPACK
from sfglab.deploy.rollout.transport import Local, transport_to
from sfglab.fleet.fleet_file import Accelerator

if TYPE_CHECKING:
    from sfglab.deploy.hardware import Machine
    from sfglab.deploy.rollout.transport import Transport
    from sfglab.fleet.fleet_file import HostSpec


NODES = (
    "/.dockerenv /dev/dri/* /dev/dxg /dev/kfd /dev/nvgpu/*/* /dev/nvhost-* /dev/nvidia* /dev/nvmap "
    "/dev/v4l2-nv* /dev/video* /run/.containerenv /usr/lib/wsl/lib/libcuda.so*"
)
"""What detection looks for, by patterns of a shell; only whether it is there counts."""

FILES = (
    "/bin/sh /etc/group /etc/nv_tegra_release /etc/os-release /proc/device-tree/compatible "
    "/proc/device-tree/model /proc/driver/nvidia/version /sys/bus/pci/devices/*/class "
    "/sys/bus/pci/devices/*/device /sys/bus/pci/devices/*/uevent /sys/bus/pci/devices/*/vendor "
    "/sys/class/dmi/id/product_name /sys/class/dmi/id/product_version /sys/class/dmi/id/sys_vendor "
    "/sys/class/drm/renderD*/device/vendor /sys/class/kfd/kfd/topology/nodes/*/properties "
    "/sys/class/video4linux/*/name /sys/firmware/devicetree/base/compatible "
    "/sys/firmware/devicetree/base/model /usr/lib/os-release"
)
"""What detection reads."""

_HEAD_BYTES = 65536


def detect_over(host: HostSpec, *, root: Path | None = None) -> Accelerator | None:
    """Return what a machine has, here or over SSH.

    Args:
        host: The machine.
        root: A folder of this machine that stands for its root; None: the machine itself.

    Raises:
        DeployError: It cannot be reached.
    """
    return accelerator_of(transport_to(host, root=root))


def accelerator_of(transport: Transport) -> Accelerator:
    """Return what images for a machine are made for.

    Args:
        transport: The machine.

    Raises:
        DeployError: It cannot be reached, or is a Jetson with another JetPack than the images' base.
    """
    machine = machine_of(transport)
    if machine.accelerator is Accelerator.JETSON and machine.jetpack != JETPACK:
        raise DeployError(
            f"{transport.name}: given JetPack {machine.jetpack or 'unknown'}, allowed: {JETPACK}, as in "
            "the images' base"
        )
    return machine.accelerator


def machine_of(transport: Transport) -> Machine:
    """Return what a machine was found to have.

    Args:
        transport: The machine.

    Raises:
        DeployError: It cannot be reached.
    """
    if isinstance(transport, Local):
        return detect(transport.folder)
    with tempfile.TemporaryDirectory(prefix="sfglab-facts-") as folder:
        copy_facts(transport, Path(folder))
        return detect(Path(folder))


def copy_facts(transport: Transport, folder: Path) -> None:
    """Copy what detection reads into a folder that stands for the machine's root; nodes become empty files.

    Args:
        transport: The machine.
        folder: Where to.

    Raises:
        DeployError: It cannot be reached, or its answer is none.
    """
    root = transport.root
    nodes, files = (" ".join(root + path for path in paths.split()) for paths in (NODES, FILES))
    script = (
        f'for p in {nodes}; do if [ -e "$p" ]; then echo "$p"; fi; done\n'
        f'for p in {files}; do if [ -f "$p" ]; then\n'
        f'  echo "$p $(head -c {_HEAD_BYTES} "$p" 2>/dev/null | base64 | tr -d "\\n")"\nfi; done\n'
    )
    for line in transport.run(script).decode(errors="replace").splitlines():
        path, _, content = line.removeprefix(root).partition(" ")
        target = folder / path.lstrip("/")
        if folder not in target.resolve().parents:
            raise DeployError(f"{transport.name}: given {path!r}, allowed: a path below the machine's root")
        target.parent.mkdir(parents=True, exist_ok=True)
        target.write_bytes(base64.b64decode(content))

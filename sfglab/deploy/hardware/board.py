"""What a machine calls itself: its model, its board's compatible names, its distribution."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from sfglab.deploy.hardware.files import plain
from sfglab.deploy.hardware.machine import DeviceGroup, Source

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sfglab.deploy.hardware.files import MachineFiles


UNKNOWN = "unknown"
_TREES = ("/proc/device-tree", "/sys/firmware/devicetree/base")  # the first is a link to the second
_DMI = "/sys/class/dmi/id"

_GROUPS = (
    (re.compile(r"/dev/dri/renderD[0-9]+|/dev/kfd"), "render"),
    (re.compile(r"/dev/video[0-9]+|/dev/dri/card[0-9]+"), "video"),
    (re.compile(r"/dev/(nvhost-|nvmap|nvgpu|v4l2-nv).*"), "video"),
)
"""Groups of device nodes: systemd's 50-udev-default.rules, and for Jetson L4T's 99-tegra-devices.rules."""


def find_model(files: MachineFiles) -> str:
    """Return the device tree's model, else what DMI has for maker and product, else 'unknown'."""
    for tree in _TREES:
        model = plain(files.text(f"{tree}/model") or "")
        if model:
            return model
    names = [plain(files.text(f"{_DMI}/{name}") or "") for name in ("sys_vendor", "product_name")]
    return " ".join(filter(None, names)) or UNKNOWN


def find_compatible(files: MachineFiles, prefix: str) -> Source | None:
    """Return what a board is compatible with, by the beginning of its name (Devicetree Specification, 2.3.1).

    Args:
        files: The machine's files.
        prefix: Maker and family, as in ``nvidia,tegra``.
    """
    for tree in _TREES:
        path = f"{tree}/compatible"
        names = [plain(name) for name in (files.text(path) or "").split("\0")]
        found = next((name for name in names if name.startswith(prefix)), None)
        if found:
            return Source(path=path, says=found)
    return None


def find_operating_system(files: MachineFiles) -> str:
    """Return PRETTY_NAME of os-release(5), else 'unknown'."""
    for path in ("/etc/os-release", "/usr/lib/os-release"):
        name = re.search(r"^PRETTY_NAME=(.*)$", files.text(path) or "", re.MULTILINE)
        if name and plain(name[1]).strip("\"'"):
            return plain(name[1]).strip("\"'")
    return UNKNOWN


def in_container(files: MachineFiles) -> bool:
    """Return whether Docker's or Podman's mark is there: such a root has only the devices it was given."""
    return files.has("/.dockerenv") or files.has("/run/.containerenv")


def find_groups(files: MachineFiles, devices: Iterable[str]) -> tuple[DeviceGroup, ...]:
    """Return the groups that udev gives device nodes, with their numbers on this machine.

    Args:
        files: The machine's files.
        devices: Absolute paths of device nodes.
    """
    wanted = {name for path in devices for pattern, name in _GROUPS if pattern.fullmatch(path)}
    lines = (files.text("/etc/group") or "").splitlines()
    return tuple(DeviceGroup(name=name, gid=_gid(lines, name)) for name in sorted(wanted))


def _gid(lines: list[str], name: str) -> int | None:
    fields = next((line.split(":") for line in lines if line.startswith(f"{name}:")), [])
    return int(fields[2]) if len(fields) > 2 and re.fullmatch(r"[0-9]{1,10}", fields[2]) else None

"""Graphics controllers on the PCI bus, with or without a driver, from /sys/bus/pci."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

from sfglab.deploy.hardware.files import plain
from sfglab.deploy.hardware.machine import Source

if TYPE_CHECKING:
    from sfglab.deploy.hardware.files import MachineFiles


VENDORS = {"0x1002": "AMD", "0x8086": "Intel", "0x10de": "NVIDIA", "0x1af4": "virtio", "0x1234": "QEMU"}
"""Makers by the number that the PCI-SIG gave them."""

_BUS = "/sys/bus/pci/devices"
_DISPLAY = "0x03"  # base class of display controllers: PCI Code and ID Assignment Specification, 1.4


def display_controllers(files: MachineFiles, vendor: str) -> list[Source]:
    """Return one maker's graphics controllers, and by whom each is driven.

    Args:
        files: The machine's files.
        vendor: The maker's number, of `VENDORS`.
    """
    found = []
    for name in files.names(_BUS, r"[0-9a-fA-F]+:[0-9a-fA-F]+:[0-9a-fA-F]+\.[0-7]"):
        place = f"{_BUS}/{name}"
        is_display = read_id(files, f"{place}/class").startswith(_DISPLAY)
        if is_display and read_id(files, f"{place}/vendor") == vendor:
            says = f"a graphics card of {VENDORS.get(vendor, vendor)}, {_driver(files, place)}"
            found.append(Source(path=f"{place}/vendor", says=says))
    return found


def read_id(files: MachineFiles, path: str) -> str:
    """Return a number as /sys writes it, as ``0x10de``; empty where there is none."""
    return plain(files.text(path) or "").lower()


def _driver(files: MachineFiles, place: str) -> str:
    """Return by whom a device is driven, from the variables that the kernel gives udev."""
    text = files.text(f"{place}/uevent")
    if text is None:
        return "by whom driven is not known"
    driver = re.search(r"^DRIVER=([\w-]{1,64})$", text, re.MULTILINE)
    return f"driven by {driver[1]}" if driver else "without a driver"

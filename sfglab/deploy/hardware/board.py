"""A machine's files below a folder that stands for its ``/``, and what they say: architecture, model, groups.

Files are read without leaving the folder or opening a device. Whatever is missing, unreadable, looped or not a
plain file reads as absent: detection must not fail on it.
"""

from __future__ import annotations

import platform
import re
import stat
import struct
from collections import deque
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from sfglab.deploy.errors import DeployError
from sfglab.deploy.hardware.machine import DeviceGroup, Source
from sfglab.fleet.fleet_file import Architecture

if TYPE_CHECKING:
    from collections.abc import Iterable

_MOST_BYTES = 65536
_MOST_LINKS = 40  # Linux gives up after as many: path_resolution(7)
_LONGEST = 160


@dataclass(frozen=True, slots=True)
class MachineFiles:
    """A machine's files."""

    root: Path  #: Folder that stands for ``/``.

    def __post_init__(self) -> None:
        try:
            is_folder = self.root.is_dir()
        except OSError:  # as for a name that is too long
            is_folder = False
        if not is_folder:
            raise DeployError(
                f"{self.root}: given as a machine's root, allowed: a folder that exists"
            )

    def resolve(self, path: str) -> Path | None:
        """Return where a path leads, None for a loop; absolute links start at the root, as in chroot(2)."""
        rest, here, links = deque(_parts(path)), list[str](), 0
        while rest:
            part = rest.popleft()
            if part == "..":
                here = here[:-1]
                continue
            try:
                target = self.root.joinpath(*here, part).readlink()
            except OSError:  # not a link, or nothing at all: what comes after tells
                here.append(part)
                continue
            links += 1
            if links > _MOST_LINKS:
                return None
            if target.is_absolute():
                here = []
            rest.extendleft(reversed(_parts(str(target))))
        return self.root.joinpath(*here)

    def has(self, path: str) -> bool:
        """Return whether there is anything at a path, and if it is a link, where it leads."""
        return self._mode(path) is not None

    def head(self, path: str, size_bytes: int = _MOST_BYTES) -> bytes | None:
        """Return the first bytes of a plain file; None for all else, devices above all."""
        mode, place = self._mode(path), self.resolve(path)
        if mode is None or place is None or not stat.S_ISREG(mode):
            return None
        try:
            with place.open("rb") as file:
                return file.read(size_bytes)
        except OSError:
            return None

    def text(self, path: str) -> str | None:
        """Return the text at the beginning of a plain file, with marks for what is no text; None if none."""
        head = self.head(path)
        return None if head is None else head.decode(errors="replace")

    def names(self, folder: str, pattern: str) -> list[str]:
        """Return the names in a folder that match a regular expression as a whole, by their numbers."""
        place = self.resolve(folder)
        try:
            found = [child.name for child in place.iterdir()] if place is not None else []
        except OSError:
            return []
        return sorted((name for name in found if re.fullmatch(pattern, name)), key=_by_number)

    def paths(self, folder: str, pattern: str) -> list[str]:
        """Return absolute paths of what matches in a folder and leads somewhere."""
        paths = [f"{folder}/{name}" for name in self.names(folder, pattern)]
        return [path for path in paths if self.has(path)]

    def _mode(self, path: str) -> int | None:
        place = self.resolve(path)
        if place is None:
            return None
        try:
            return place.stat().st_mode
        except OSError:
            return None


def plain(text: str) -> str:
    """Return text fit for one line of a terminal: no control characters, no marks of bad bytes, not long."""
    shown = "".join(char if char.isprintable() and char != "\ufffd" else " " for char in text)
    line = " ".join(shown.split())
    return line if len(line) <= _LONGEST else f"{line[: _LONGEST - 1]}…"


def _parts(path: str) -> list[str]:
    return [part for part in PurePosixPath(path).parts if part.strip("/")]


def _by_number(name: str) -> tuple[str, int, str]:
    stem = name.rstrip("0123456789")
    return stem, int(name[len(stem) :] or -1), name


MACHINES = {
    3: "386",
    8: "mips",
    20: "ppc",
    21: "ppc64",
    22: "s390x",
    40: "arm",
    62: "amd64",
    183: "arm64",
} | {
    243: "riscv64",
    258: "loong64",
}
"""Names in container images by ``e_machine`` of the System V ABI's ELF header (elf.h, EM_*)."""

_PROGRAMS = ("/bin/sh", "/usr/bin/sh", "/bin/busybox", "/usr/bin/env", "/sbin/init")
_LOADERS = ("/lib64", "/lib", "/usr/lib64", "/usr/lib")
_KERNEL_NAMES = {"x86_64": "amd64", "aarch64": "arm64"}
_CLASS_64, _LITTLE_ENDIAN = 2, 1


def find_architecture(files: MachineFiles) -> tuple[Architecture | None, str]:
    """Return the architecture, and how it is known or why there is none."""
    loaders = [
        path
        for place in _LOADERS
        for path in files.paths(place, r"ld-(linux|musl)-?[\w.-]*so[\w.-]*")
    ]
    for path in (*_PROGRAMS, *loaders):
        name = _elf_name(files.head(path, 20))
        if name is not None:
            return _supported(name, f"the ELF header of {path}")
    if files.root == Path("/"):
        kernel = platform.machine()
        return _supported(_KERNEL_NAMES.get(kernel, kernel), "the kernel's own name for it")
    return (
        None,
        f"not known: no program with an ELF header, looked for {', '.join(_PROGRAMS)} and ld-linux-*",
    )


def elf_header(machine: int, *, bits: int = 64) -> bytes:
    """Return a little-endian program's first 20 bytes, of 32 or 64 bits; its machine is an ``e_machine``."""
    identity = b"\x7fELF" + bytes([bits // 32, _LITTLE_ENDIAN, 1]) + bytes(9)
    return identity + struct.pack("<HH", 3, machine)


def _elf_name(header: bytes | None) -> str | None:
    """Return the architecture's name in container images; None if this is no program."""
    if header is None or len(header) < 20 or header[:4] != b"\x7fELF":
        return None
    order = "<" if header[5] == _LITTLE_ENDIAN else ">"
    (machine,) = struct.unpack_from(f"{order}H", header, 18)
    name = MACHINES.get(machine, f"ELF machine {machine}")
    if name in {"amd64", "arm64"} and (header[4] != _CLASS_64 or order != "<"):
        return f"{name} with 32-bit or big-endian programs"
    return "riscv32" if name == "riscv64" and header[4] != _CLASS_64 else name


def _supported(name: str, known_from: str) -> tuple[Architecture | None, str]:
    try:
        return Architecture(name), f"from {known_from}"
    except ValueError:
        allowed = ", ".join(member.value for member in Architecture)
        return None, f"{name}, from {known_from}: there are no images for it, allowed: {allowed}"


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
    """Return what a board is compatible with that begins so (Devicetree Specification, 2.3.1)."""
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
    """Return the groups that udev gives device nodes (absolute paths), with their numbers on this machine."""
    wanted = {name for path in devices for pattern, name in _GROUPS if pattern.fullmatch(path)}
    lines = (files.text("/etc/group") or "").splitlines()
    return tuple(DeviceGroup(name=name, gid=_gid(lines, name)) for name in sorted(wanted))


def _gid(lines: list[str], name: str) -> int | None:
    fields = next((line.split(":") for line in lines if line.startswith(f"{name}:")), [])
    return int(fields[2]) if len(fields) > 2 and re.fullmatch(r"[0-9]{1,10}", fields[2]) else None


AMD, INTEL, NVIDIA = "0x1002", "0x8086", "0x10de"
VENDORS = {AMD: "AMD", INTEL: "Intel", NVIDIA: "NVIDIA", "0x1af4": "virtio", "0x1234": "QEMU"}
"""Makers by the number that the PCI-SIG gave them."""

_BUS = "/sys/bus/pci/devices"
# base class of display controllers: PCI Code and ID Assignment Specification, 1.4
_DISPLAY = "0x03"


def display_controllers(files: MachineFiles, vendor: str) -> list[Source]:
    """Return one maker's graphics controllers, of `VENDORS`, and by whom each is driven."""
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

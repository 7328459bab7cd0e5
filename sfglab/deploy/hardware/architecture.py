"""A machine's processor architecture, from the header of one of its own programs.

A root may belong to another machine than the one that looks at it, so its programs are asked, not the kernel;
only for ``/`` itself, where the two are one, the kernel is asked when no program can be read.
"""

from __future__ import annotations

import platform
import struct
from pathlib import Path
from typing import TYPE_CHECKING

from sfglab.fleet.fleet_file import Architecture

if TYPE_CHECKING:
    from sfglab.deploy.hardware.files import MachineFiles


MACHINES = {3: "386", 8: "mips", 20: "ppc", 21: "ppc64", 22: "s390x", 40: "arm", 62: "amd64", 183: "arm64"} | {
    243: "riscv64",
    258: "loong64",
}
"""Names in container images by ``e_machine`` of the System V ABI's ELF header (elf.h, EM_*)."""

_PROGRAMS = ("/bin/sh", "/usr/bin/sh", "/bin/busybox", "/usr/bin/env", "/sbin/init")
_LOADERS = ("/lib64", "/lib", "/usr/lib64", "/usr/lib")
_KERNEL_NAMES = {"x86_64": "amd64", "aarch64": "arm64"}
_CLASS_64, _LITTLE_ENDIAN = 2, 1


def find_architecture(files: MachineFiles) -> tuple[Architecture | None, str]:
    """Return the architecture, and how it is known or why there is none.

    Args:
        files: The machine's files.
    """
    loaders = [
        path for folder in _LOADERS for path in files.paths(folder, r"ld-(linux|musl)-?[\w.-]*so[\w.-]*")
    ]
    for path in (*_PROGRAMS, *loaders):
        name = _elf_name(files.head(path, 20))
        if name is not None:
            return _supported(name, f"the ELF header of {path}")
    if files.root == Path("/"):
        kernel = platform.machine()
        return _supported(_KERNEL_NAMES.get(kernel, kernel), "the kernel's own name for it")
    return None, f"not known: no program with an ELF header, looked for {', '.join(_PROGRAMS)} and ld-linux-*"


def elf_header(machine: int, *, bits: int = 64) -> bytes:
    """Return the first 20 bytes of a little-endian program, which is all that is read of one.

    Args:
        machine: ``e_machine``, of `MACHINES`.
        bits: 32 or 64.
    """
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

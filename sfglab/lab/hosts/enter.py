"""Makes or joins namespaces and then becomes another program; runs as a script of its own.

The script imports nothing of sfglab and few other modules, because every process in a host needs its start.
Usage::

    enter.py new COMMAND...                          appends root or rootless to COMMAND
    enter.py join PID INODE root|rootless COMMAND...
"""

from __future__ import annotations

import ctypes
import os
import sys

# linux/sched.h
CLONE_NEWUSER = 0x10000000
CLONE_NEWNET = 0x40000000
# linux/capability.h
_CAP_NET_ADMIN, _CAP_SYS_ADMIN = 12, 21
# signal(7); Python ignores both signals, and a program that is executed inherits that.
_IGNORED_BY_PYTHON = (13, 25)
# Exit statuses of env(1) and nohup(1): own failure; command found but not executable; not found.
_EXIT_OWN, _EXIT_CANNOT_RUN, _EXIT_NOT_FOUND = 125, 126, 127

_libc = ctypes.CDLL(None, use_errno=True)


def _call(name: str, *args: int) -> None:
    if getattr(_libc, name)(*args) != 0:
        number = ctypes.get_errno()
        raise OSError(number, f"{name}: {os.strerror(number)}")


def unshare(flags: int) -> None:
    """Give the calling thread new namespaces (unshare(2)); `flags` is a sum of ``CLONE_NEW*``.

    Raises:
        OSError: The kernel refuses.
    """
    _call("unshare", flags)


def setns(fd: int, flags: int) -> None:
    """Move the calling thread into the namespace of a file descriptor (setns(2)); `flags` is the namespace's kind.

    Raises:
        OSError: The namespace has another kind, or the kernel refuses.
    """
    _call("setns", fd, flags)


def _may_be_root() -> bool:
    """Return whether this process has the capabilities for network administration (capabilities(7))."""
    with open("/proc/self/status", encoding="ascii", errors="replace") as file:  # noqa: PTH123 - pathlib costs 10 ms
        effective = next(int(line.split()[1], 16) for line in file if line.startswith("CapEff"))
    return all(effective >> number & 1 for number in (_CAP_NET_ADMIN, _CAP_SYS_ADMIN))


def new() -> str:
    """Move this process into a new network namespace; return the way, ``root`` or ``rootless``.

    Without the capabilities for a network namespace, the process makes a user namespace as well.

    Raises:
        OSError: The kernel refuses.
    """
    if _may_be_root():
        unshare(CLONE_NEWNET)
        return "root"
    user, group = os.geteuid(), os.getegid()
    unshare(CLONE_NEWUSER | CLONE_NEWNET)
    # The group map can be written only after setgroups is denied (user_namespaces(7)).
    for name, text in (
        ("setgroups", "deny"),
        ("uid_map", f"0 {user} 1"),
        ("gid_map", f"0 {group} 1"),
    ):
        with open(f"/proc/self/{name}", "w", encoding="ascii") as file:  # noqa: PTH123 - pathlib costs 10 ms
            file.write(text)
    return "rootless"


def join(pid: int, inode: int, how: str) -> None:
    """Move this process into the network namespace of a host's holder; ``rootless``: also into its user namespace.

    The inode of the network namespace distinguishes the holder from a later process with the same pid.

    Raises:
        OSError: The holder is gone, or the kernel refuses.
    """
    kinds = [("net", CLONE_NEWNET)]
    if how == "rootless":
        kinds.insert(0, ("user", CLONE_NEWUSER))
    opened = [
        (os.open(f"/proc/{pid}/ns/{kind}", os.O_RDONLY | os.O_CLOEXEC), flag)
        for kind, flag in kinds
    ]
    if os.fstat(opened[-1][0]).st_ino != inode:
        raise ProcessLookupError(f"process {pid} is not the holder of this host any more")
    for fd, flag in opened:
        setns(fd, flag)
    # A closing network ends its holders first, and then looks for members. This process joined before the
    # holder ended, so the network finds it.
    if os.stat(f"/proc/{pid}/ns/net").st_ino != inode:  # noqa: PTH116 - pathlib costs 10 ms
        raise ProcessLookupError(f"the host of process {pid} closed meanwhile")


def _become(command: list[str]) -> int:
    for number in _IGNORED_BY_PYTHON:
        _libc.signal(number, None)
    try:
        os.execvp(command[0], command)  # noqa: S606 - a shell is not wanted
    except OSError as error:
        sys.stderr.write(f"cannot run {command[0]!r} inside the host: {error}\n")
        return _EXIT_NOT_FOUND if isinstance(error, FileNotFoundError) else _EXIT_CANNOT_RUN


def _main(verb: str, *rest: str) -> int:
    try:
        if verb == "new":
            command = [*rest, new()]
        else:
            pid, inode, how, *command = rest
            join(int(pid), int(inode), how)
    except OSError as error:
        sys.stderr.write(f"{error}\n")
        return _EXIT_OWN
    return _become(command)


if __name__ == "__main__":
    sys.exit(_main(*sys.argv[1:]))

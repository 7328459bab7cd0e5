"""Doctor: tries what this machine can do, and reports the results and their consequences.

The report contains no paths and no name of the machine.
"""

from __future__ import annotations

import os
import re
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

import psutil

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Callable

_MIB = 1 << 20
_LOOPBACK = "127.0.0.1"
_ENOUGH_CORES = 4
_ENOUGH_MEMORY_BYTES = 4 << 30
_BUSY_SHARE = 0.25
# An uncompressed Full HD colour image has 6 MB, and Linux gives a socket 208 KiB by default.
_RECEIVE_BUFFER_BYTES = 4 * _MIB
_SHARED_MEMORY_BYTES = 256 * _MIB
_DDS_TIMEOUT_S = 15.0
_ROS = "ROS 2 (optional)"
_NO_VIDEO = "experiments with compressed video do not run"


class Level(Enum):
    """Level of a check's result."""

    OK = "ok"
    LIMITED = "limited"
    MISSING = "missing"


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """Result of one check of this machine by `sfglab doctor`."""

    topic: str  #: Subject of the check.
    level: Level  #: Level of the result.
    said: str  #: Observation, as a sentence.
    consequence: str  #: Consequence for experiments.


_Verdict = tuple[Level, str, str]


def _namespaces() -> _Verdict:
    from sfglab.lab.hosts import HostsUnavailableError, Network

    capability = Network.available()
    if not capability.ok:
        raise HostsUnavailableError(capability.reason)
    how = "as root" if capability.how == "root" else "without root, in a user namespace"
    return (
        Level.OK,
        f"hosts with a network of their own work {how}",
        "experiments with several hosts run live",
    )


def _capacity() -> _Verdict:
    cores = len(os.sched_getaffinity(0))
    memory = psutil.virtual_memory()
    load = os.getloadavg()[0]
    said = (
        f"{cores} cores, {memory.available / 2**30:.1f} of {memory.total / 2**30:.1f} GiB of memory free, "
        f"load {load:.2f} in the last minute"
    )
    reasons = []
    if load > _BUSY_SHARE * cores:
        reasons.append("other work is running, so times and CPU loads will be noisy")
    if cores < _ENOUGH_CORES:
        reasons.append(
            "with few cores the hosts of an experiment compete, so compare ratios, not absolute values"
        )
    if memory.available < _ENOUGH_MEMORY_BYTES:
        reasons.append("large profiles may run out of memory; use the quick one")
    if reasons:
        return Level.LIMITED, said, "; ".join(reasons)
    return Level.OK, said, "numbers will be steady"


def _receive_buffer() -> _Verdict:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        # The kernel doubles a requested size for its own bookkeeping (socket(7)), but not the default.
        default_bytes = probe.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        granted = probe.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2
    said = f"a UDP socket gets {granted / _MIB:.1f} of {_RECEIVE_BUFFER_BYTES / _MIB:.0f} MiB that it requests"
    said += f", and {default_bytes / _MIB:.1f} MiB by default, as in ROS 2 nodes on Fast DDS"
    if granted < _RECEIVE_BUFFER_BYTES:
        consequence = (
            "bursts of large messages may be lost; only RELIABLE retransmits them; "
            f"raise it with sysctl net.core.rmem_max={_RECEIVE_BUFFER_BYTES}"
        )
        return Level.LIMITED, said, consequence
    if default_bytes < _RECEIVE_BUFFER_BYTES:
        consequence = (
            "bursts of images fit in sfglab's nodes; a Fast DDS node may lose images that it receives best "
            f"effort; raise the default with sysctl net.core.rmem_default={_RECEIVE_BUFFER_BYTES}"
        )
        return Level.OK, said, consequence
    return Level.OK, said, "bursts of images fit"


def _shared_memory() -> _Verdict:
    os.close(os.memfd_create("sfglab-probe"))
    with tempfile.TemporaryFile(dir="/dev/shm") as file:
        file.write(b"x")
    status = os.statvfs("/dev/shm")  # noqa: S108 - the check is about this folder
    free = status.f_bavail * status.f_frsize
    said = f"memfd works, {free / _MIB:.0f} MiB free in /dev/shm"
    if free < _SHARED_MEMORY_BYTES:
        consequence = (
            "queues of large images may not fit; in a container, start it with --shm-size=1g"
        )
        return Level.LIMITED, said, consequence
    return Level.OK, said, "messages cross between processes of one host without copies"


def _multicast() -> _Verdict:
    group = "239.255.0.77"
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        receiver.settimeout(1.0)
        receiver.bind((group, 0))
        membership = socket.inet_aton(group) + socket.inet_aton(_LOOPBACK)
        receiver.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, membership)
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_IF, socket.inet_aton(_LOOPBACK))
        sender.sendto(b"probe", receiver.getsockname())
        receiver.recv(16)
    return Level.OK, "multicast on the loopback arrives", "DDS discovery needs no list of peers"


_DDS_CONFIG = (
    "<CycloneDDS><Domain><General><Interfaces><NetworkInterface name='lo'/></Interfaces></General></Domain>"
    "</CycloneDDS>"
)
_DDS_PROBE = """
from cyclonedds.domain import DomainParticipant
print(DomainParticipant(77).guid)
"""


def _dds() -> _Verdict:
    start_s = time.perf_counter()
    # DDS runs in a process of its own, because it must not stall or crash the doctor.
    subprocess.run(
        [sys.executable, "-c", _DDS_PROBE],
        env=os.environ | {"CYCLONEDDS_URI": _DDS_CONFIG},
        capture_output=True,
        text=True,
        timeout=_DDS_TIMEOUT_S,
        check=True,
    )
    said = f"a DDS participant starts on the loopback ({time.perf_counter() - start_s:.1f} s with its process)"
    return Level.OK, said, "live experiments run"


def _h264() -> _Verdict:
    from sfglab.codecs import available_encoders

    encoders = available_encoders()
    works = [f"{e.name} ({'hardware' if e.hardware else 'software'})" for e in encoders if e.works]
    broken = "; ".join(f"{e.name}: {e.reason}" for e in encoders if not e.works)
    if not works:
        return Level.MISSING, f"no H.264 encoder works: {broken}", _NO_VIDEO
    said = f"encoders that work: {', '.join(works)}"
    if not any(e.works and e.hardware for e in encoders):
        consequence = (
            "video is encoded in software, and the log names the encoder; CPU loads are higher"
        )
        return Level.LIMITED, said, consequence
    return Level.OK, said, "video is encoded in hardware"


def _ros() -> _Verdict:
    from sfglab.bus.ros.services import PYTHON_VARIABLE, ros_python
    from sfglab.lab.ros2 import distributions

    found = list(distributions().values())
    if not found:
        raise SfglabError(
            "no ROS 2 installation was found; run make ros, or source the setup file of one"
        )
    services = (
        "routers forward services of rmw_fastrtps"
        if ros_python()
        else f"routers forward no services of rmw_fastrtps until {PYTHON_VARIABLE} names an interpreter "
        f"with rclpy, such as {'/'.join(found[0].python.parts[-3:])}"
    )
    return (
        Level.OK,
        ", ".join(map(str, found)),
        f"tests run beside rclpy; {services}",
    )


#: Each check by its topic, and the consequence if it fails with an error.
_CHECKS: dict[str, tuple[Callable[[], _Verdict], str]] = {
    "network namespaces": (
        _namespaces,
        "experiments with several hosts run on this machine's loopback or are simulated, and logs name this",
    ),
    "cores, memory, load": (_capacity, "how steady the numbers are is unknown"),
    "UDP receive buffer": (_receive_buffer, "live experiments over UDP do not run"),
    "shared memory": (
        _shared_memory,
        "messages between processes of one host go through DDS on the loopback, which costs copies",
    ),
    "multicast on the loopback": (
        _multicast,
        "DDS on one host finds its peers only when they are listed in its configuration",
    ),
    "DDS": (_dds, "live experiments do not run; simulated ones do"),
    "H.264": (_h264, _NO_VIDEO),
    _ROS: (
        _ros,
        "tests beside rclpy are skipped, and routers forward no services of rmw_fastrtps; nothing else needs ROS",
    ),
}


def _tame(text: str) -> str:
    """Return a text of other software on one line, without paths and the machine's name."""
    text = re.sub(r"(?<![\w.])/(?!(?:dev|proc|sys)/)(?:[^\s/'\":,;()]+/)+", "", text)
    text = text.replace(socket.gethostname(), "this machine")
    return " ".join(text.split())


def _words(error: Exception) -> str:
    """Return the text of an error; for a failed program, the last line of its output."""
    if isinstance(error, subprocess.TimeoutExpired):
        return f"it did not end within {error.timeout:.0f} s"
    if isinstance(error, subprocess.CalledProcessError):
        lines = (error.stderr or "").strip().splitlines()
        return _tame(lines[-1]) if lines else f"it ended with status {error.returncode}"
    return _tame(str(error)) or type(error).__name__


def _examine(topic: str) -> Finding:
    check, without = _CHECKS[topic]
    try:
        level, said, consequence = check()
    except Exception as error:  # noqa: BLE001 - one failed check must not hide the others
        level = Level.LIMITED if topic == _ROS else Level.MISSING
        said = _words(error)
        consequence = without
    return Finding(topic=topic, level=level, said=said, consequence=consequence)


def diagnose() -> list[Finding]:
    """Check everything that experiments depend on; takes a few seconds and leaves nothing behind."""
    return [_examine(topic) for topic in _CHECKS]


def render(findings: list[Finding]) -> str:
    """Return the results of `diagnose` as plain text for a terminal."""
    texts = [
        f"[{f.level.value}] {f.topic}\n    found: {f.said}\n    so:    {f.consequence}"
        for f in findings
    ]
    fine = sum(finding.level is Level.OK for finding in findings)
    return "\n".join([*texts, "", f"{fine} of {len(findings)} are in order."])

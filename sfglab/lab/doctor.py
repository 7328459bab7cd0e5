"""Doctor: what this machine can do, tried, in words without its paths and name, and what follows."""

from __future__ import annotations

import contextlib
import importlib.metadata
import os
import platform
import re
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING, Any

import psutil

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from collections.abc import Callable

_MIB = 1 << 20
_LOOPBACK = "127.0.0.1"
_ENOUGH_CORES = 4
_ENOUGH_MEMORY_BYTES = 4 << 30
_BUSY_SHARE = 0.25
_NOTABLE_STEAL_PERCENT = 1.0
# An uncompressed Full HD colour image is 6 MB; Linux gives a socket 208 KiB unless asked.
_RECEIVE_BUFFER_BYTES = 4 * _MIB
_SHARED_MEMORY_BYTES = 256 * _MIB
_DDS_TIMEOUT_S = 15.0
_NO_VIDEO = "experiments with compressed video do not run"


class Level(Enum):
    """How well something works here."""

    OK = "ok"
    LIMITED = "limited"
    MISSING = "missing"


@dataclass(frozen=True, slots=True, kw_only=True)
class Finding:
    """One thing that was looked at."""

    topic: str  #: What it is about.
    level: Level  #: How well it works.
    said: str  #: What was found.
    consequence: str  #: What an experiment does with that.

    @property
    def ok(self) -> bool:
        """Return whether nothing is limited or missing."""
        return self.level is Level.OK


_Verdict = tuple[Level, str, str]


@dataclass(frozen=True, slots=True)
class _Check:
    """One line of the table of checks; `without` is the consequence when it fails as expected."""

    topic: str
    run: Callable[[], _Verdict]
    expected: tuple[type[Exception], ...]
    without: str


def _version(distribution: str) -> str | None:
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def _libraries() -> _Verdict:
    required = [r for r in importlib.metadata.requires("sfglab") or () if "extra ==" not in r]
    names = sorted(
        re.split(r"[^A-Za-z0-9._-]", requirement)[0] for requirement in required
    )  # PEP 508
    versions = {name: _version(name) for name in names}
    missing = [name for name, version in versions.items() if version is None]
    found = ", ".join(f"{name} {version}" for name, version in versions.items() if version)
    python = f"Python {platform.python_version()}"
    if missing:
        said = f"{python}; not installed: {', '.join(missing)}; installed: {found}"
        consequence = (
            "what needs the missing libraries stops with their names; install sfglab again"
        )
        return Level.MISSING, said, consequence
    return Level.OK, f"{python}, {found}", "all parts of sfglab can be imported"


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


def _link_control() -> _Verdict:
    from sfglab.lab.hosts import LinkControlError, Network

    links: dict[str, Any] = {"rate": {"rate_bps": 1e6}, "loss": {"loss": 0.5}}
    works = []
    with Network() as network:
        network.add_host("probe")
        for name, link in links.items():
            with contextlib.suppress(LinkControlError):
                network.set_link("probe", **link)
                works.append(name)
    if len(works) == len(links):
        return (
            Level.OK,
            "the kernel limits rates and loses packets on request",
            "lossy and slow links run live",
        )
    said = f"of rate and loss, the kernel emulates {' and '.join(works) or 'neither'}"
    return Level.LIMITED, said, "links that need the rest are simulated, and the log says so"


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
            "with few cores the hosts of an experiment compete, so compare ratios, not absolute figures"
        )
    if memory.available < _ENOUGH_MEMORY_BYTES:
        reasons.append("large profiles may run out of memory; use the quick one")
    if reasons:
        return Level.LIMITED, said, "; ".join(reasons)
    return Level.OK, said, "numbers will be steady"


def _clock() -> _Verdict:
    virtual = "hypervisor" in Path("/proc/cpuinfo").read_text(encoding="utf-8", errors="replace")
    times = psutil.cpu_times()
    steal_percent = 100 * times.steal / max(1.0, sum(times))
    governor = Path("/sys/devices/system/cpu/cpu0/cpufreq/scaling_governor")
    scaling = (
        governor.read_text(encoding="ascii").strip()
        if governor.is_file()
        else "not under our control"
    )
    machine = "virtual machine" if virtual else "physical machine"
    said = f"{machine}, clock governor {scaling}, {steal_percent:.1f} % of its time stolen by others so far"
    if steal_percent > _NOTABLE_STEAL_PERCENT:
        return (
            Level.LIMITED,
            said,
            "stolen time shows as latency; each row of the meters carries steal_percent",
        )
    if scaling == "powersave":
        return (
            Level.LIMITED,
            said,
            "CPU times grow when the clock is low; choose the performance governor",
        )
    return Level.OK, said, "CPU times of one run can be compared with each other"


def _receive_buffer() -> _Verdict:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        # The kernel doubles the figure that is set for its own bookkeeping (socket(7)), and not the default.
        unasked = probe.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF)
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, _RECEIVE_BUFFER_BYTES)
        granted = probe.getsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF) // 2
    said = f"a UDP socket gets {granted / _MIB:.1f} of {_RECEIVE_BUFFER_BYTES / _MIB:.0f} MiB asked for"
    said += f", and {unasked / _MIB:.1f} unasked, as ROS 2 nodes on Fast DDS do"
    if granted < _RECEIVE_BUFFER_BYTES:
        consequence = (
            "bursts of large messages may be lost: RELIABLE repairs them at a cost, BEST_EFFORT does not; "
            f"raise it with sysctl net.core.rmem_max={_RECEIVE_BUFFER_BYTES}"
        )
        return Level.LIMITED, said, consequence
    if unasked < _RECEIVE_BUFFER_BYTES:
        consequence = (
            "bursts of images fit here, but not where nobody asks: an image that a Fast DDS node hears by best "
            f"effort may be lost; raise it with sysctl net.core.rmem_default={_RECEIVE_BUFFER_BYTES}"
        )
        return Level.OK, said, consequence
    return Level.OK, said, "bursts of images fit"


def _shared_memory() -> _Verdict:
    os.close(os.memfd_create("sfglab-probe"))
    with tempfile.TemporaryFile(dir="/dev/shm") as file:
        file.write(b"x")
    status = os.statvfs("/dev/shm")  # noqa: S108 - the very thing to be tried
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
    # In a process of its own: DDS that hangs or crashes must not take the doctor along.
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


def _viewer() -> _Verdict:
    return (
        Level.OK,
        f"rerun-sdk {importlib.metadata.version('rerun-sdk')}",
        "logs open in the Rerun viewer",
    )


def _ros() -> _Verdict:
    from sfglab.bus.ros.services import PYTHON_VARIABLE, ros_python
    from sfglab.lab.ros2 import distributions

    found = ", ".join(map(str, distributions().values()))
    if not found:
        raise SfglabError("neither environments of make ros nor a sourced ROS 2")
    services = (
        "cross routers"
        if ros_python()
        else f"cross none until {PYTHON_VARIABLE} names its interpreter"
    )
    return (
        Level.OK,
        found,
        f"our nodes are tested beside rclpy; services of rmw_fastrtps {services}",
    )


_NOT_INSTALLED = (importlib.metadata.PackageNotFoundError,)
_CHECKS = (
    _Check(
        "Python and libraries",
        _libraries,
        _NOT_INSTALLED,
        "versions cannot be written into logs; install sfglab with pip",
    ),
    _Check(
        "network namespaces",
        _namespaces,
        (SfglabError,),
        "experiments with several hosts run on this machine's loopback or are simulated, and say so",
    ),
    _Check(
        "rate and loss control",
        _link_control,
        (SfglabError,),
        "slow and lossy links are simulated, and the log says so",
    ),
    _Check(
        "cores, memory, load", _capacity, (OSError,), "nobody can say how steady the numbers are"
    ),
    _Check("CPU clock", _clock, (OSError,), "nobody can say how steady CPU times are"),
    _Check(
        "UDP receive buffer", _receive_buffer, (OSError,), "live experiments over UDP do not run"
    ),
    _Check(
        "shared memory",
        _shared_memory,
        (OSError,),
        "messages between processes of one host go through DDS on the loopback, which costs copies",
    ),
    _Check(
        "multicast on the loopback",
        _multicast,
        (OSError,),
        "DDS on one host finds its peers only when they are listed in its configuration",
    ),
    _Check(
        "DDS",
        _dds,
        (subprocess.SubprocessError, OSError),
        "live experiments do not run; simulated ones do",
    ),
    _Check("H.264", _h264, (ImportError,), _NO_VIDEO),
    _Check(
        "Rerun viewer (optional)",
        _viewer,
        _NOT_INSTALLED,
        "logs are not opened in the Rerun viewer; figures and tables need nothing of it",
    ),
    _Check(
        "ROS 2 (optional)",
        _ros,
        (SfglabError,),
        "nothing is tested beside rclpy, and services of rmw_fastrtps cross no router; nothing else needs ROS",
    ),
)


def _tame(text: str) -> str:
    """Remove paths and the machine's name from somebody else's words, and make one line of them."""
    text = re.sub(r"(?<![\w.])/(?!(?:dev|proc|sys)/)(?:[^\s/'\":,;()]+/)+", "", text)
    text = text.replace(socket.gethostname(), "this machine")
    return " ".join(text.split())


def _words(error: Exception) -> str:
    if isinstance(error, subprocess.CalledProcessError):
        lines = (error.stderr or "").strip().splitlines()
        return _tame(lines[-1]) if lines else f"it ended with status {error.returncode}"
    if isinstance(error, subprocess.TimeoutExpired):
        return f"it did not end within {error.timeout:.0f} s"
    if isinstance(error, importlib.metadata.PackageNotFoundError):
        return f"{error.name} is not installed"
    return _tame(str(error)) or type(error).__name__


def _examine(check: _Check) -> Finding:
    try:
        level, said, consequence = check.run()
    except check.expected as error:
        level = Level.LIMITED if "optional" in check.topic else Level.MISSING
        said, consequence = _words(error), check.without
    except Exception as error:  # noqa: BLE001 - one broken check must not hide the others
        level = Level.MISSING
        said = f"the check itself failed with {type(error).__name__}: {_words(error)}"
        consequence = f"treated as missing: {check.without}; please report it"
    return Finding(topic=check.topic, level=level, said=said, consequence=consequence)


def diagnose() -> list[Finding]:
    """Look at everything that experiments depend on; takes a few seconds and leaves nothing behind."""
    return [_examine(check) for check in _CHECKS]


def render(findings: list[Finding]) -> str:
    """Return what `diagnose` found as plain text for a terminal."""
    texts = [
        f"[{f.level.value}] {f.topic}\n    found: {f.said}\n    so:    {f.consequence}"
        for f in findings
    ]
    fine = sum(finding.ok for finding in findings)
    return "\n".join([*texts, "", f"{fine} of {len(findings)} are in order."])

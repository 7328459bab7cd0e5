"""Measure the cost of the router: talker and listener in two domains, against both in one domain.

Three processes on loopback: talker, router (``python -m sfglab.fleet.router.node``), listener; for the direct
arm the router is idle and the listener is in the talker's domain. Talker and listener touch samples as
little as possible, so the difference is the router. One quantity is the latency of 64-byte messages at 200 Hz
and of 691 kB images at 30 Hz, from the source time stamp until the listener takes the sample. Another is the
throughput of 64-byte messages and of images when the talker sends as fast as RELIABLE and KEEP_ALL permit. The
router's CPU time until it is ready and the router's largest memory are measured as well. If ROS 2 is installed,
an rclpy node also receives the images, and its latency is from the stamp in the header to its callback. Rounds
of the arms alternate, so that other load on the machine falls on both; ratios are within a round.

    python benchmarks/router.py --seconds 5 --rounds 5
"""

from __future__ import annotations

import argparse
import asyncio
import ctypes as ct
import json
import os
import struct
import subprocess
import sys
import time
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import psutil

from sfglab.bus import Node, PublishError
from sfglab.bus.address import BusAddress
from sfglab.bus.dds.clib import ANY_STATE, SampleInfo, library
from sfglab.component import argument_of
from sfglab.fleet.router.config import RouterConfig
from sfglab.lab.ros2 import PEER, distribution, distributions
from sfglab.messages import default_message, serialize
from sfglab.messages.dds import idl_struct
from sfglab.qos import History, QoSProfile

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

TOPIC = "/global/bench/data"
STRING, IMAGE = "std_msgs/msg/String", "sensor_msgs/msg/Image"
# Name -> type, messages per second (0: as fast as possible).
LOADS = {
    "64 B": (STRING, 200.0),
    "691 kB": (IMAGE, 30.0),
    "64 B max": (STRING, 0.0),
    "691 kB max": (IMAGE, 0.0),
    "691 kB, rclpy": (IMAGE, 30.0),
}
ARMS = ("direct", "routed")
_BATCH = 256


def _payload(type_: str) -> bytes:
    message = default_message(type_)
    if type_ == STRING:
        message.data = "x" * 55  # with header, length and end 64 bytes
    else:
        message.height, message.width, message.step, message.encoding = 360, 640, 1920, "rgb8"
        message.data = np.random.default_rng(0).integers(0, 255, 640 * 360 * 3, np.uint8)
    return serialize(message)


def _qos(rate_hz: float) -> QoSProfile:
    return QoSProfile() if rate_hz else QoSProfile(history=History.KEEP_ALL)


def _say(**values: Any) -> None:
    print(json.dumps(values), flush=True)


async def talk(load: str, domain_id: int, seconds: float) -> None:
    """Send for some seconds once a listener is there; report how many."""
    type_, rate_hz = LOADS[load]
    cdr = _payload(type_)
    async with Node("talker", domain_id=domain_id, interface="lo") as node:
        publisher = node.create_publisher(type_, TOPIC, _qos(rate_hz))
        await publisher.wait_for_subscriptions(1, 20.0)
        await asyncio.to_thread(sys.stdin.readline)  # the path through the router is complete
        start_s, sent = time.monotonic(), 0
        cdr = bytearray(cdr)
        while (now_s := time.monotonic()) < start_s + seconds:
            if rate_hz and (wait_s := start_s + sent / rate_hz - now_s) > 0:
                time.sleep(wait_s)  # noqa: ASYNC251 - nothing else runs on this loop
            if type_ == IMAGE:
                struct.pack_into("<II", cdr, 4, *divmod(time.time_ns(), 10**9))
            try:
                publisher.publish_raw(cdr)
                sent += 1
            except PublishError:
                continue  # a slow listener: try again
        _say(sent=sent, seconds=time.monotonic() - start_s)
        await asyncio.to_thread(sys.stdin.readline)


async def listen(load: str, domain_id: int) -> None:
    """Take samples until told to stop; report latency and rate."""
    type_, rate_hz = LOADS[load]
    lib = library()
    serdata, infos = (ct.c_void_p * _BATCH)(), (SampleInfo * _BATCH)()
    taken: list[tuple[int, int]] = []
    async with Node("listener", domain_id=domain_id, interface="lo") as node:
        participant = node.backend.participant  # a subscription would cost more than the router
        qos = _qos(rate_hz) if not rate_hz else QoSProfile(depth=100)
        reader = participant.create_reader("rt" + TOPIC, idl_struct(type_), qos)

        def take() -> None:
            count = lib.dds_takecdr(reader, serdata, _BATCH, infos, ANY_STATE)
            now_ns = time.time_ns()
            for i in range(count):
                if infos[i].valid_data:
                    taken.append((infos[i].source_timestamp, now_ns))
                lib.ddsi_serdata_unref(serdata[i])

        participant.waitset.attach_reader(reader, take)
        if not await node.graph.wait_for(lambda: bool(node.graph.publishers(TOPIC)), 20.0):
            raise RuntimeError(f"no publisher of {TOPIC} in domain {domain_id}")
        _say(ready=True)
        await asyncio.to_thread(sys.stdin.readline)
        times = np.array(taken, dtype=np.int64)
        latency_ms = (times[:, 1] - times[:, 0]) / 1e6
        span_s = (times[-1, 1] - times[0, 1]) / 1e9
        p50, p99 = np.percentile(latency_ms, [50, 99])
        _say(count=len(times), p50_ms=p50, p99_ms=p99, rate_hz=(len(times) - 1) / span_s)


class Child:
    """Another process that talks in JSON lines."""

    def __init__(self, command: Sequence[str], environment: dict[str, str]) -> None:
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
        self._process = subprocess.Popen(command, env=os.environ | environment, **pipes)

    @property
    def cpu_s(self) -> float:
        """CPU time so far, in seconds."""
        times = psutil.Process(self._process.pid).cpu_times()
        return float(times.user + times.system)

    @property
    def peak_mb(self) -> float:
        """The most memory that it ever had, in MB."""
        status = Path(f"/proc/{self._process.pid}/status").read_text("ascii")
        return int(status.partition("VmHWM:")[2].split(maxsplit=1)[0]) * 1024 / 1e6

    def hear(self) -> dict[str, Any]:
        """Return the next thing it says."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"a process ended early with {self._process.wait()}")
        values: dict[str, Any] = json.loads(line)
        return values

    def tell(self, **order: Any) -> None:
        """Let it go on, by an order if it takes any."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(order) + "\n")
        self._process.stdin.flush()

    def end(self) -> None:
        """End it."""
        self._process.kill()
        self._process.communicate()


@contextmanager
def children(*commands: Sequence[str], **environment: str) -> Iterator[list[Child]]:
    """Start processes with environment variables of their own, and end them."""
    with ExitStack() as stack:
        started = [Child(command, environment) for command in commands]
        for child in started:
            stack.callback(child.end)
        yield started


def measure(load: str, arm: str, domain_id: int, seconds: float) -> dict[str, Any]:
    """Run one arm once."""
    far = domain_id if arm == "direct" else domain_id + 1
    config = RouterConfig(
        agent="bench",
        local=BusAddress(domain_id=domain_id, interface="lo"),
        remote=BusAddress(domain_id=domain_id + 1, interface="lo"),
    )
    real = load.endswith("rclpy")
    ours = (sys.executable, __file__, "listen", load, str(far))
    with children(
        (sys.executable, "-m", "sfglab.fleet.router.node", argument_of(config)),
        ros_listener(far) if real else ours,
        (sys.executable, __file__, "talk", load, str(domain_id), str(seconds)),
        **({"ROS_DISTRO": distribution().name} if real else {}),  # as beside ROS 2
    ) as (router, listener, talker):
        while router.hear()["is"] != "ready":
            pass
        ready = {"start_cpu_s": router.cpu_s}
        listener.hear()
        if real:
            listener.tell(do="look", topic=TOPIC, depth=100)
        time.sleep(
            3.0 if real else 0.5
        )  # until the router's reader and writer have found their peers
        talker.tell()
        sent = talker.hear()["sent"]
        time.sleep(0.5 if LOADS[load][1] else 2.0)  # until the last sample has arrived
        listener.tell(do="stop")
        found = seen_by_ros(listener) if real else listener.hear()
        return {**found, **ready, "sent": sent, "peak_mb": router.peak_mb}


def ros_listener(domain_id: int) -> list[str]:
    """Return the command line of a node of rclpy on this host alone."""
    values = {"ROS_DOMAIN_ID": domain_id, "FASTDDS_BUILTIN_TRANSPORTS": "UDPv4"}
    return distribution().argv(
        str(PEER), "listener", ROS_AUTOMATIC_DISCOVERY_RANGE="LOCALHOST", **values
    )


def seen_by_ros(listener: Child) -> dict[str, Any]:
    """Return what a node of rclpy saw, as `listen` reports."""
    while (report := listener.hear())["is"] != "seen":
        pass
    ages_ms = np.array(report["ages_ns"]) / 1e6
    p50, p99 = np.percentile(ages_ms, [50, 99])
    return {"count": len(ages_ms), "p50_ms": p50, "p99_ms": p99, "rate_hz": 0.0}


def main() -> None:
    """Run all rounds and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=5.0)
    parser.add_argument("--rounds", type=int, default=5)
    here = [load for load in LOADS if distributions() or not load.endswith("rclpy")]
    parser.add_argument("--loads", nargs="+", default=here, choices=here)
    parser.add_argument("--domain", type=int, default=20 + os.getpid() % 60)
    options = parser.parse_args()
    found: dict[tuple[str, str], list[dict[str, Any]]] = {}
    print("load        arm      sent    received   p50 ms   p99 ms    msg/s     MB/s  router MB")
    for _ in range(options.rounds):
        for load in options.loads:
            size = len(_payload(LOADS[load][0]))
            for arm in ARMS:
                r = measure(load, arm, options.domain, options.seconds)
                found.setdefault((load, arm), []).append(r)
                print(
                    f"{load:10}  {arm:6}  {r['sent']:7}  {r['count']:7}  {r['p50_ms']:9.3f} "
                    f"{r['p99_ms']:8.3f}  {r['rate_hz']:9.0f} {r['rate_hz'] * size / 1e6:7.1f}  "
                    f"{r['peak_mb']:9.1f}",
                    flush=True,
                )
    for load in options.loads:
        direct, routed = (found[load, arm] for arm in ARMS)
        pairs = list(zip(direct, routed, strict=True))
        if LOADS[load][1]:
            for key in ("p50_ms", "p99_ms"):
                added = [b[key] - a[key] for a, b in pairs]
                times = [b[key] / a[key] for a, b in pairs]
                print(f"{load}: added {key[:3]} {_spread(added)} ms, {_spread(times)} times direct")
        else:
            print(
                f"{load}: rate {_spread([b['rate_hz'] / a['rate_hz'] for a, b in pairs])} of direct"
            )
        print(f"{load}: the router took at most {max(r['peak_mb'] for r in routed):.0f} MB")
    starts = [r["start_cpu_s"] for runs in found.values() for r in runs]
    print(f"the router was ready after {_spread(starts)} s of CPU")


def _spread(values: list[float]) -> str:
    return f"{np.median(values):.3f} ({min(values):.3f} to {max(values):.3f})"


if __name__ == "__main__":
    if len(sys.argv) > 1 and sys.argv[1] == "talk":
        asyncio.run(talk(sys.argv[2], int(sys.argv[3]), float(sys.argv[4])))
    elif len(sys.argv) > 1 and sys.argv[1] == "listen":
        asyncio.run(listen(sys.argv[2], int(sys.argv[3])))
    else:
        main()

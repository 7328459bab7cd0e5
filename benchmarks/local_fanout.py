"""Measure the cost of an additional subscriber process on a host: shared memory against DDS over loopback.

A publisher sends 640x360x3 images at 30 Hz; 1, 4 and 10 subscriber processes read every byte of each. The
CPU time of all processes (user and system, all their threads, by the kernel's clock) over a window is divided
by the window's length; the slope is what each further subscriber adds. Callbacks run on the loop, uvloop's as
in every component, or in the thread that takes the messages. Rounds of these arms alternate, so that other load
on the machine falls on all; ratios are within a round. With --raw the subscribers read the CDR as it comes,
which leaves out the cost of making message objects.

    python benchmarks/local_fanout.py --seconds 6 --subscribers 1 4 10
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import resource
import struct
import subprocess
import sys
import time
from typing import Any

import numpy as np

from sfglab.bus import Node
from sfglab.component import run as run_loop
from sfglab.messages import default_message, ns_from_stamp, stamp_from_ns

WIDTH, HEIGHT, RATE_HZ = 640, 360, 30.0
TYPE, TOPIC = "sensor_msgs/msg/Image", "/local/host/camera_front/color/image_raw"
TRANSPORTS = ("shm", "dds")
WAYS = ("loop", "thread")


def _cpu_s() -> float:
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def _image() -> Any:
    image = default_message(TYPE)
    image.header.frame_id, image.encoding = "camera", "rgb8"
    image.height, image.width, image.step = HEIGHT, WIDTH, WIDTH * 3
    image.data = np.random.default_rng(0).integers(0, 255, WIDTH * HEIGHT * 3, np.uint8)
    return image


async def _window(seconds: float) -> dict[str, float]:
    """Wait for the common start on stdin, measure this process, and report."""
    await asyncio.to_thread(sys.stdin.readline)
    start_s, cpu_s = time.monotonic(), _cpu_s()
    await asyncio.sleep(seconds)
    return {"cpu_percent": 100 * (_cpu_s() - cpu_s) / (time.monotonic() - start_s)}


async def publish(transport: str, domain_id: int, seconds: float, subscribers: int) -> None:
    """Send images until stdin closes, and report the publisher's CPU time."""
    image = _image()
    async with Node("publisher", domain_id=domain_id, interface="lo") as node:
        publisher = node.create_publisher(TYPE, TOPIC, 5, transport=transport)
        await publisher.wait_for_subscriptions(subscribers, 20.0)

        def send() -> None:
            image.header.stamp = stamp_from_ns(time.time_ns())
            publisher.publish(image)

        node.create_timer(1 / RATE_HZ, send)
        print("{}", flush=True)
        print(json.dumps(await _window(seconds)), flush=True)
        await asyncio.to_thread(sys.stdin.readline)


def _stamp_ns(cdr: Any) -> int:
    seconds, nanoseconds = struct.unpack_from("<iI", cdr, 4)
    return int(seconds) * 10**9 + int(nanoseconds)


async def subscribe(arm: str, domain_id: int, seconds: float, *, raw: bool) -> None:
    """Read every byte of every image, and report CPU time, latency and losses."""
    transport, _, way = arm.partition(" ")
    options: dict[str, Any] = {"raw": raw, "transport": transport, "threaded": way == "thread"}
    latency_ns: list[int] = []
    async with Node("subscriber", domain_id=domain_id, interface="lo") as node:

        def read(image: Any) -> None:
            latency_ns.append(time.time_ns() - ns_from_stamp(image.header.stamp))
            np.bitwise_xor.reduce(image.data.view(np.uint64))

        def read_raw(cdr: Any) -> None:
            latency_ns.append(time.time_ns() - _stamp_ns(cdr))
            np.bitwise_xor.reduce(np.frombuffer(cdr, np.uint64, (len(cdr) - 4) // 8, 4))

        callback = read_raw if raw else read
        subscription = node.create_subscription(TYPE, TOPIC, callback, 5, **options)
        await subscription.wait_for_publishers(timeout_s=20.0)
        print("{}", flush=True)
        result = await _window(seconds)
        p50, p99 = np.percentile(latency_ns, [50, 99]) / 1e6
        lost = subscription.dropped + subscription.lost
        print(
            json.dumps(
                result | {"p50_ms": p50, "p99_ms": p99, "count": len(latency_ns), "lost": lost}
            ),
            flush=True,
        )
        await asyncio.to_thread(sys.stdin.readline)


async def idle(domain_id: int, seconds: float) -> None:
    """Report the CPU time of a node that does nothing."""
    async with Node("idle", domain_id=domain_id, interface="lo"):
        print("{}", flush=True)
        print(json.dumps(await _window(seconds)), flush=True)
        await asyncio.to_thread(sys.stdin.readline)


def _spawn(*arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, __file__, *map(str, arguments)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


def _line(process: subprocess.Popen[str]) -> dict[str, float]:
    assert process.stdout is not None
    line = process.stdout.readline()
    if not line:
        raise RuntimeError(f"a process ended early with {process.wait()}")
    values: dict[str, float] = json.loads(line)
    return values


def run(arm: str, count: int, seconds: float, domain_id: int, *, raw: bool) -> dict[str, float]:
    """Measure one arm, a transport and a way of subscribing, with `count` subscribers.

    Returns:
        Total CPU in percent of one core, latency quantiles in ms, and the numbers of messages.
    """
    transport = arm.partition(" ")[0]
    processes = [_spawn("subscribe", arm, domain_id, seconds, int(raw)) for _ in range(count)]
    processes.insert(0, _spawn("publish", transport, domain_id, seconds, count))
    try:
        for process in processes:
            _line(process)
        for process in processes:
            assert process.stdin is not None
            process.stdin.write("\n")
            process.stdin.flush()
        publisher, *readers = [_line(process) for process in processes]
    finally:
        for process in processes:
            process.kill()
            process.wait()
    return {
        "total": publisher["cpu_percent"] + sum(r["cpu_percent"] for r in readers),
        "publisher": publisher["cpu_percent"],
        "reader": float(np.mean([r["cpu_percent"] for r in readers])),
        "p50_ms": float(np.median([r["p50_ms"] for r in readers])),
        "p99_ms": float(np.median([r["p99_ms"] for r in readers])),
        "received": min(r["count"] for r in readers),
        "lost": max(r["lost"] for r in readers),
    }


def main() -> None:
    """Run all rounds and print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=6.0)
    parser.add_argument("--subscribers", type=int, nargs="+", default=[1, 4, 10])
    parser.add_argument("--rounds", type=int, default=1)
    parser.add_argument("--transports", nargs="+", default=TRANSPORTS, choices=TRANSPORTS)
    parser.add_argument("--raw", action="store_true")
    parser.add_argument("--domain", type=int, default=os.getpid() % 100)
    options = parser.parse_args()
    arms = [f"{transport} {way}" for transport in options.transports for way in WAYS]
    totals: dict[str, list[tuple[int, float]]] = {arm: [] for arm in arms}
    readers: dict[str, list[float]] = {arm: [] for arm in arms}
    print("arm         k  total %  publisher %  reader %  p50 ms  p99 ms  received  lost")
    for _ in range(options.rounds):
        for count in options.subscribers:
            for arm in arms:
                r = run(arm, count, options.seconds, options.domain, raw=options.raw)
                totals[arm].append((count, r["total"]))
                readers[arm].append(r["reader"])
                print(
                    f"{arm:10} {count:2}  {r['total']:7.2f}  {r['publisher']:11.2f}  {r['reader']:8.2f}  "
                    f"{r['p50_ms']:6.2f}  {r['p99_ms']:6.2f}  {r['received']:8.0f}  {r['lost']:4.0f}",
                    flush=True,
                )
    for arm, points in totals.items():
        slope, offset = np.polyfit(*zip(*points, strict=True), 1)
        print(f"{arm}: {slope:.2f} % of a core per further subscriber, {offset:.2f} % without any")
    for transport in options.transports:
        ratios = np.divide(*(readers[f"{transport} {way}"] for way in reversed(WAYS)))
        low, middle, high = np.percentile(ratios, [25, 50, 75])
        spread = f"{middle:.2f} (quartiles {low:.2f}, {high:.2f})"
        print(f"{transport}: a subscriber's thread costs {spread} of its loop")


if __name__ == "__main__":
    if len(sys.argv) > 1 and sys.argv[1] == "publish":
        run_loop(publish(sys.argv[2], int(sys.argv[3]), float(sys.argv[4]), int(sys.argv[5])))
    elif len(sys.argv) > 1 and sys.argv[1] == "subscribe":
        run_loop(
            subscribe(sys.argv[2], int(sys.argv[3]), float(sys.argv[4]), raw=sys.argv[5] == "1")
        )
    elif len(sys.argv) > 1 and sys.argv[1] == "idle":
        run_loop(idle(int(sys.argv[2]), float(sys.argv[3])))
    else:
        main()

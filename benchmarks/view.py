"""What the view adds to a picture on its way to the viewer, and whether its memory stays where it is.

Three processes on loopback: a camera that publishes 640 x 360 pictures (691 kB) at 30 Hz over DDS, the bridge,
and a Rerun server that stands for the viewer's sink. Measured is the time from a picture's arrival (the bus's
reception stamp) until the sink has taken it, which a flush after each picture tells. The baseline, in the same
process and to the same sink, is a bare ``rr.Image`` of the same array, logged at the same rate. Both are also
given without the flush: until the call returns. Rounds of the arms alternate, so that other load on the machine
falls on both.

    python benchmarks/view.py --seconds 10 --rounds 3
    python benchmarks/view.py --soak 600

The soak shows pictures for so long, with a sink that stands still for some seconds of each minute, and prints
the resident memory of the bridge.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import os
import signal
import socket
import subprocess
import sys
import time
from contextlib import closing, contextmanager
from typing import TYPE_CHECKING, Any

import numpy as np
import psutil

from sfglab.bus import Node
from sfglab.messages import default_message, serialize
from sfglab.qos import SENSOR_DATA
from sfglab.view.bridge import Bridge
from sfglab.view.rerunning import RerunCanvas, open_canvas, rerun
from sfglab.view.session import Session
from sfglab.view.visualizer import SinkError

if TYPE_CHECKING:
    from collections.abc import Iterator

TOPIC = "/global/bench/camera/color/image_raw"
IMAGE = "sensor_msgs/msg/Image"
RATE_HZ = 30.0
_SERVER = (
    "import rerun, sys; r = rerun.RecordingStream('sink'); r.serve_grpc(grpc_port=int(sys.argv[1]), \
server_memory_limit='256MB'); print('ready', flush=True); sys.stdin.read()"
)


def _pixels() -> Any:
    return np.random.default_rng(0).integers(0, 255, (360, 640, 3), np.uint8)


async def publish(domain_id: int) -> None:
    """Be the camera, until standard input ends."""
    message = default_message(IMAGE)
    message.height, message.width, message.step, message.encoding = 360, 640, 1920, "rgb8"
    message.data = _pixels().reshape(-1)
    cdr = serialize(message)
    async with Node("camera", domain_id=domain_id, interface="lo") as node:
        publisher = node.create_publisher(IMAGE, TOPIC, SENSOR_DATA)
        ended = asyncio.create_task(asyncio.to_thread(sys.stdin.read))
        next_s = time.monotonic()
        while not ended.done():
            publisher.publish_raw(cdr)
            next_s += 1 / RATE_HZ
            await asyncio.sleep(max(0.0, next_s - time.monotonic()))


@contextmanager
def child(*command: str, wait: bool) -> Iterator[subprocess.Popen[str]]:
    """Start a process and end it; wait for its first line if it says when it is ready."""
    process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
    try:
        if wait:
            assert process.stdout is not None
            process.stdout.readline()
        yield process
    finally:
        process.kill()
        process.communicate()


class Measured:
    """A canvas that waits for the sink after each picture, and notes how long everything took.

    Args:
        canvas: What is drawn on.
        flush: Whether to wait.
    """

    def __init__(self, canvas: RerunCanvas, *, flush: bool) -> None:
        self._canvas = canvas
        self._flush = flush
        self._received_ns = 0
        self.taken_ns: list[int] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._canvas, name)

    def at(self, *, stamp_ns: int, received_ns: int) -> None:
        """Note when the picture arrived."""
        self._received_ns = received_ns
        self._canvas.at(stamp_ns=stamp_ns, received_ns=received_ns)

    def settle(self, size_bytes: int) -> None:
        """Note when it was taken."""
        if self._flush:
            self._canvas.flush()
        if size_bytes:
            self.taken_ns.append(time.time_ns() - self._received_ns)

    def close(self) -> None:
        """Leave the canvas open for the next round."""


async def through_bridge(
    canvas: RerunCanvas, domain_id: int, seconds: float, *, flush: bool
) -> Any:
    """Return how long each picture took, nanoseconds."""
    measured, session = Measured(canvas, flush=flush), Session()
    display = session.add("image", TOPIC)
    session.limit(display.id, None)
    async with (
        Node("view", domain_id=domain_id, interface="lo") as node,
        Bridge(node, session, measured),
    ):
        await asyncio.sleep(seconds)
    if display.errors or not measured.taken_ns:
        raise RuntimeError(f"no pictures: {display.last_error}")
    return np.array(measured.taken_ns)


def bare(canvas: RerunCanvas, seconds: float, *, flush: bool) -> Any:
    """Return how long the bare calls of Rerun take for the same array, nanoseconds."""
    rr, array, taken = rerun(), _pixels(), []
    end_s = next_s = time.monotonic()
    end_s += seconds
    while time.monotonic() < end_s:
        start_ns = time.time_ns()
        canvas.recording.set_time("received", timestamp=np.datetime64(start_ns, "ns"))
        canvas.recording.log("/bare", rr.Image(array, "RGB"))
        if flush:
            canvas.recording.flush()
        taken.append(time.time_ns() - start_ns)
        next_s += 1 / RATE_HZ
        time.sleep(max(0.0, next_s - time.monotonic()))
    return np.array(taken)


def _free_port() -> int:
    with closing(socket.socket()) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def compare(options: argparse.Namespace) -> None:
    """Run all rounds and print medians and what is added."""
    port = _free_port()
    added: dict[str, list[float]] = {"in the sink": [], "call returned": []}
    print("until          arm      pictures   median ms   p99 ms")
    with (
        child(sys.executable, "-c", _SERVER, str(port), wait=True),
        child(sys.executable, __file__, "camera", str(options.domain), wait=False),
        closing(open_canvas([f"rerun+http://127.0.0.1:{port}/proxy"])) as canvas,
    ):
        for _ in range(options.rounds):
            for until, flush in (("in the sink", True), ("call returned", False)):
                direct = bare(canvas, options.seconds, flush=flush) / 1e6
                work = through_bridge(canvas, options.domain, options.seconds, flush=flush)
                bridged = asyncio.run(work) / 1e6
                for arm, found in (("bare", direct), ("bridge", bridged)):
                    median, p99 = np.percentile(found, [50, 99])
                    print(
                        f"{until:13}  {arm:7}  {len(found):8}   {median:9.3f}   {p99:6.2f}",
                        flush=True,
                    )
                added[until].append(float(np.median(bridged) - np.median(direct)))
    for until, values in added.items():
        spread = f"{np.median(values):.3f} ms ({min(values):.3f} to {max(values):.3f})"
        print(f"added by the bridge until {until}: median {spread}")


async def _soak(
    canvas: RerunCanvas, server: subprocess.Popen[str], options: argparse.Namespace
) -> None:
    session = Session()
    display = session.add("image", TOPIC)
    session.limit(display.id, None)
    me, start_s = psutil.Process(), time.monotonic()
    async with (
        Node("view", domain_id=options.domain, interface="lo") as node,
        Bridge(node, session, canvas) as bridge,
    ):
        failing = asyncio.create_task(bridge.failed())
        while (at_s := time.monotonic() - start_s) < options.soak and not failing.done():
            stopped = at_s % 60 >= 60 - options.stopped
            server.send_signal(signal.SIGSTOP if stopped else signal.SIGCONT)
            counts, rss = display.slot.counts, me.memory_info().rss / 2**20
            state = "stopped" if stopped else "runs"
            told = f"{counts.shown:6} shown  {counts.dropped:6} dropped"
            print(f"{at_s:6.0f} s  sink {state:8} {rss:7.1f} MiB  {told}", flush=True)
            await asyncio.wait([failing], timeout=5.0)
        if failing.done():
            print(failing.exception())
        failing.cancel()
        server.send_signal(signal.SIGCONT)


def soak(options: argparse.Namespace) -> None:
    """Show pictures for long, to a sink that does not always take them, and print the memory."""
    port = _free_port()
    with (
        child(sys.executable, "-c", _SERVER, str(port), wait=True) as server,
        child(sys.executable, __file__, "camera", str(options.domain), wait=False),
        contextlib.suppress(SinkError),
        closing(open_canvas([f"rerun+http://127.0.0.1:{port}/proxy"])) as canvas,
    ):
        asyncio.run(_soak(canvas, server, options))


def main() -> None:
    """Read the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--soak", type=float, default=0.0)
    parser.add_argument(
        "--stopped", type=float, default=8.0, help="seconds a minute that the sink stands still"
    )
    parser.add_argument("--domain", type=int, default=20 + os.getpid() % 60)
    options = parser.parse_args()
    soak(options) if options.soak else compare(options)


if __name__ == "__main__":
    if len(sys.argv) > 1 and sys.argv[1] == "camera":
        asyncio.run(publish(int(sys.argv[2])))
    else:
        main()

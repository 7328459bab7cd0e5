"""Measure the gain of the compiled reliability model: its event rate against SimPy's, and the time of paper B's grid.

The first part runs one model twice: `sfglab.rtps`, and `SimpyModel` below. The latter uses plain Python's data
structures, SimPy's processes for actors, and callbacks of timeouts for the rest, the faster of SimPy's styles. It
covers what the transmission experiment uses: RELIABLE, KEEP_LAST, one shared medium. Both count the same events
(publications, frames, heartbeats, requests, retransmissions, samples served; no wake-ups of SimPy), so the ratio of
the rates is the ratio of the times. Delivered and retransmitted samples of both must agree within the noise of two
random generators. Rounds alternate; ratios are within a round.

Then the grid of the transmission experiment, 4 Rmax x 7 DEPTH x 7 methods of 60 simulated seconds, as a sweep
over local threads, after everything is compiled.

    python benchmarks/rtps.py --rounds 30 --workers 2
"""

from __future__ import annotations

import argparse
import random
import tempfile
import time
from collections import deque
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import simpy

from sfglab.arp.hello import GridCell, scenario_of
from sfglab.lab.experiments.transmission.experiment import (
    exp,
    grid,
    simulate_cell,
)
from sfglab.lab.sweep import Workers, sweep
from sfglab.rtps import run

if TYPE_CHECKING:
    from collections.abc import Generator

    from sfglab.rtps import Flow, Scenario

CELLS = [
    GridCell(rate_max_hz=100, depth="10", method="none", duration_s=30.0),
    GridCell(rate_max_hz=100, depth="100", method="LC", duration_s=60.0),
    GridCell(rate_max_hz=200, depth="opt", method="OPT+LC+CC", duration_s=60.0),
    GridCell(rate_max_hz=1000, depth="10", method="LC", duration_s=20.0),
    GridCell(rate_max_hz=1000, depth="1000", method="none", duration_s=10.0),
]
ASKED_RATIO, ASKED_S = 30, 5
NS = 1e9
DATA, HEARTBEAT, ACKNACK, GAP = range(4)
# Bytes before the payload, as in sfglab.rtps.frames.
SIZES = {DATA: 98, HEARTBEAT: 110, ACKNACK: 138, GAP: 110}
PIGGYBACK_BYTES = 32
RECEIVED, IRRELEVANT = 1, 2


@dataclass
class Executor:
    """An executor that takes samples from its readers in turn."""

    channels: list[Channel] = field(default_factory=list)
    turn: int = 0
    wake: simpy.Event | None = None


@dataclass
class Channel:
    """One writer and its one reader; lists are by sample, from 1."""

    flow: Flow
    executor: Executor
    depth: int
    reader_depth: int
    then: Channel | None = None
    # The writer.
    values: list[int] = field(default_factory=lambda: [0])
    last: int = 0
    acked: int = 0
    armed: bool = False
    value: int = 0
    change_at: float = 0
    sent_value: int = -1
    repair_base: int = 0
    repair_bits: int = 0
    # The reader.
    arrived: list[int] = field(default_factory=lambda: [0])
    next: int = 1
    first: int = 1
    known: int = 0
    answers: bool = False
    history: deque[int] = field(default_factory=deque)
    behind_gap: int = 0
    oldest: int = 0
    last_value: int = -1
    delivered: int = 0

    @property
    def first_kept(self) -> int:
        """Return the oldest sample in the writer's history."""
        return max(1, self.last - self.depth + 1)


class SimpyModel:
    """A scenario in SimPy.

    Args:
        scenario: RELIABLE and KEEP_LAST flows over a shared medium without latency.
        seed: Of losses and values.
    """

    def __init__(self, scenario: Scenario, *, seed: int) -> None:
        self.env = simpy.Environment()
        self.scenario, self.medium, self.vendor = scenario, scenario.medium, scenario.vendor
        self.random = random.Random(seed)
        self.counts = dict.fromkeys(("events", "data", "repeated", "held", "lost", "queue_full"), 0)
        self.end = round(scenario.duration_s * NS)
        self.queues: dict[str, deque[Any]] = {}
        self.turn, self.busy = 0, False
        self.channels: dict[str, Channel] = {}
        executors: dict[str, Executor] = {}
        for flow in scenario.flows:
            self.queues.setdefault(flow.source, deque())
            self.queues.setdefault(flow.target, deque())
            executor = executors.setdefault(flow.executor or f"{flow.name}\0", Executor())
            depth = flow.qos.depth if flow.reader_depth is None else flow.reader_depth
            channel = Channel(flow, executor, flow.qos.depth, depth)
            executor.channels.append(channel)
            self.channels[flow.name] = channel
            if flow.rate_hz:
                self.env.process(self.source(channel))
        for channel in self.channels.values():
            channel.then = self.channels[channel.flow.then] if channel.flow.then else None
        for executor in executors.values():
            self.env.process(self.serve(executor))
        self.hosts = list(self.queues)

    def run(self) -> None:
        """Run to the end of time."""
        self.env.run(until=self.end + round(self.scenario.drain_s * NS))

    def later(self, delay_ns: int, what: Any, argument: Any) -> None:
        """Call something after a while."""
        timeout = self.env.timeout(delay_ns)
        timeout.callbacks.append(lambda _: what(argument))

    # --- The writer

    def source(self, channel: Channel) -> Generator[simpy.Event, None, None]:
        """Publish at a rate."""
        period = round(NS / channel.flow.rate_hz)
        yield self.env.timeout(round(channel.flow.phase_s * NS))
        while self.env.now < self.end:
            self.counts["events"] += 1
            self.publish(channel)
            yield self.env.timeout(period)

    def sensed(self, channel: Channel) -> int:
        """Return the number of the value that the sensor has now."""
        if not channel.flow.change_s:
            channel.value += 1
            return channel.value
        while self.env.now >= channel.change_at:
            channel.value += 1
            channel.change_at += max(
                1, int(self.random.expovariate(1 / (channel.flow.change_s * NS)))
            )
        return channel.value

    def publish(self, channel: Channel) -> None:
        """Publish now, if the local cache lets it."""
        value = self.sensed(channel)
        if channel.flow.cached and value == channel.sent_value:
            self.counts["held"] += 1
            return
        channel.sent_value = value
        channel.last += 1
        channel.values.append(value)
        channel.arrived.append(0)
        self.send_data(channel, channel.last)
        if not channel.armed:
            channel.armed = True
            self.later(self.vendor.heartbeat_ns, self.heartbeat, channel)

    def send_data(self, channel: Channel, sample: int) -> None:
        """Send a sample, with a heartbeat while the history is full."""
        rides = channel.last - channel.acked >= channel.depth
        self.counts["data"] += 1
        self.enqueue(
            channel.flow.source, (DATA, channel, sample, rides, channel.first_kept, channel.last)
        )

    def heartbeat(self, channel: Channel) -> None:
        """Say what there is, while anything is unacknowledged."""
        self.counts["events"] += 1
        channel.armed = False
        if channel.acked >= channel.last:
            return
        self.enqueue(
            channel.flow.source, (HEARTBEAT, channel, 0, False, channel.first_kept, channel.last)
        )
        channel.armed = True
        self.later(self.vendor.heartbeat_ns, self.heartbeat, channel)

    def hear_acknack(self, channel: Channel, base: int, bits: int) -> None:
        """Take a reader's acknowledgement and request."""
        channel.acked = max(channel.acked, base - 1)
        if bits:
            waits = channel.repair_base
            channel.repair_base, channel.repair_bits = base, bits
            if not waits:
                self.later(self.vendor.nack_response_ns, self.repair, channel)

    def repair(self, channel: Channel) -> None:
        """Send again what was asked for; declare what is gone."""
        self.counts["events"] += 1
        base, bits, channel.repair_base = channel.repair_base, channel.repair_bits, 0
        kept = channel.first_kept
        if base < kept:
            self.enqueue(channel.flow.source, (GAP, channel, base, False, kept, channel.last))
        while bits:
            lowest = bits & -bits
            bits ^= lowest
            sample = base + lowest.bit_length() - 1
            if kept <= sample <= channel.last:
                self.counts["repeated"] += 1
                self.send_data(channel, sample)

    # --- The medium

    def enqueue(self, host: str, frame: tuple[Any, ...]) -> None:
        """Put a frame into a host's queue."""
        queue = self.queues[host]
        if len(queue) == self.medium.queue_frames:
            self.counts["queue_full"] += 1
            return
        queue.append(frame)
        self.send_next()

    def send_next(self) -> None:
        """Send the next host's frame if the medium is free."""
        if self.busy:
            return
        order = self.hosts[self.turn :] + self.hosts[: self.turn]
        contenders = [host for host in order if self.queues[host]]
        if not contenders:
            return
        self.turn = (self.hosts.index(contenders[0]) + 1) % len(self.hosts)
        frame = self.queues[contenders[0]].popleft()
        kind, channel, _, rides, *_ = frame
        size = SIZES[kind]
        if kind == DATA:
            size += (channel.flow.size_bytes + 3) // 4 * 4 + PIGGYBACK_BYTES * rides
        stretch = 1 + self.medium.contention * (len(contenders) - 1)
        airtime = int((self.medium.overhead_s + size * 8 / self.medium.rate_bps) * NS * stretch)
        self.busy = True
        self.later(airtime, self.sent, frame)

    def sent(self, frame: tuple[Any, ...]) -> None:
        """Hear a frame, unless it is lost."""
        self.counts["events"] += 1
        self.busy = False
        lost = self.random.random() < self.medium.loss
        self.send_next()
        if lost:
            self.counts["lost"] += 1
            return
        kind, channel, sample, rides, first, last = frame
        if kind == ACKNACK:
            self.hear_acknack(channel, sample, first)
            return
        if kind == DATA:
            self.hear_data(channel, sample)
        elif kind == GAP:
            self.hear_gap(channel, sample, first)
        if rides or kind == HEARTBEAT:
            self.hear_heartbeat(channel, first, last)
        self.wake(channel.executor)

    # --- The reader

    def hear_data(self, channel: Channel, sample: int) -> None:
        """Take a sample, unless it is here already."""
        if channel.arrived[sample] or sample < channel.next:
            return
        channel.arrived[sample] = RECEIVED
        channel.behind_gap += 1
        channel.oldest = min(channel.oldest, sample)
        if sample == channel.next:
            self.advance(channel)
        if len(channel.history) + channel.behind_gap <= channel.reader_depth:
            return
        if channel.history:
            channel.history.popleft()
            return
        oldest = max(channel.oldest, channel.next)
        while channel.arrived[oldest] != RECEIVED:
            oldest += 1
        channel.oldest = oldest + 1
        channel.behind_gap -= 1
        channel.arrived[oldest] = IRRELEVANT

    def advance(self, channel: Channel) -> None:
        """Move what is in order to the history, past what the writer no longer has."""
        sample = channel.next
        while sample <= channel.last:
            if channel.arrived[sample] == RECEIVED:
                channel.behind_gap -= 1
                channel.history.append(sample)
            elif channel.arrived[sample] != IRRELEVANT and sample >= channel.first:
                break
            sample += 1
        channel.next = sample

    def hear_heartbeat(self, channel: Channel, first: int, last: int) -> None:
        """Learn what there is, and answer after a delay."""
        channel.first, channel.known = max(channel.first, first), max(channel.known, last)
        self.advance(channel)
        if not channel.answers:
            channel.answers = True
            lacks = channel.next <= channel.known
            delay = self.vendor.nack_delay_ns if lacks else self.vendor.ack_delay_ns
            self.later(delay, self.request, channel)

    def hear_gap(self, channel: Channel, start: int, end: int) -> None:
        """Give up what is gone."""
        for sample in range(max(start, channel.next), end):
            channel.arrived[sample] = channel.arrived[sample] or IRRELEVANT
        self.advance(channel)

    def request(self, channel: Channel) -> None:
        """Acknowledge, and ask for what is missing."""
        self.counts["events"] += 1
        channel.answers = False
        base, bits = channel.next, 0
        for i in range(min(self.vendor.nack_most, channel.known - base + 1)):
            if not channel.arrived[base + i]:
                bits |= 1 << i
        self.enqueue(channel.flow.target, (ACKNACK, channel, base, False, bits, 0))

    # --- The executor

    @staticmethod
    def wake(executor: Executor) -> None:
        """Tell an executor that waits that there is something."""
        if executor.wake is not None:
            executor.wake.succeed()
            executor.wake = None

    def serve(self, executor: Executor) -> Generator[simpy.Event, None, None]:
        """Take samples from readers in turn, indefinitely."""
        count = len(executor.channels)
        while True:
            for i in range(count):
                channel = executor.channels[(executor.turn + i) % count]
                if channel.history:
                    break
            else:
                executor.wake = self.env.event()
                yield executor.wake
                continue
            executor.turn = (executor.turn + i + 1) % count
            value, flow = channel.values[channel.history.popleft()], channel.flow
            same = value == channel.last_value
            cost_s = flow.compare_s if same and flow.compare_s is not None else flow.service_s
            channel.last_value = value
            yield self.env.timeout(round(cost_s * NS))
            self.counts["events"] += 1
            channel.delivered += 1
            if channel.then:
                channel.then.value = value - 1
                self.publish(channel.then)


@dataclass(frozen=True)
class Timed:
    """One run: what came of it, and how long it took."""

    seconds: float
    events: int
    published: int
    delivered: int
    repeated: int

    @property
    def rate(self) -> float:
        """Return events a second."""
        return self.events / self.seconds


def compiled(scenario: Scenario, seed: int) -> Timed:
    """Run a scenario in `sfglab.rtps`."""
    start_s = time.perf_counter()
    outcome = run(scenario, seed=seed)
    seconds = time.perf_counter() - start_s
    flows = outcome.flows.values()
    return Timed(
        seconds,
        outcome.counts["events"],
        sum(len(flow.fate) for flow in flows),
        sum(int(flow.delivered.sum()) for flow in flows),
        outcome.counts["repeated"],
    )


def interpreted(scenario: Scenario, seed: int) -> Timed:
    """Run a scenario in SimPy."""
    start_s = time.perf_counter()
    model = SimpyModel(scenario, seed=seed)
    model.run()
    seconds = time.perf_counter() - start_s
    channels = model.channels.values()
    return Timed(
        seconds,
        model.counts["events"],
        sum(channel.last for channel in channels),
        sum(channel.delivered for channel in channels),
        model.counts["repeated"],
    )


def compare(rounds: int) -> None:
    """Print both event rates, their ratio, and whether both say the same."""
    print(
        "cell                          events   ours events/s  SimPy events/s  ratio  delivered    repeated"
    )
    ratios = []
    for point in CELLS:
        scenario = scenario_of(point, seed=0)
        pairs = [(compiled(scenario, seed), interpreted(scenario, seed)) for seed in range(rounds)]
        own = [pair[0].rate / pair[1].rate for pair in pairs]
        ratios += own
        ours, simpys = (
            np.array([(t.published, t.delivered, t.repeated, t.events, t.rate) for t in side])
            for side in zip(*pairs, strict=True)
        )
        (a, b), (c, d) = (
            (m[:, 1].sum() / m[:, 0].sum(), m[:, 2].sum() / m[:, 0].sum()) for m in (ours, simpys)
        )
        name = f"{point.rate_max_hz} Hz, {point.depth}, {point.method}"
        print(
            f"{name:26} {ours[:, 3].mean():9.0f} {np.median(ours[:, 4]):15.0f} {np.median(simpys[:, 4]):15.0f} "
            f"{np.median(own):6.0f}   {a:.3f} {c:.3f}  {b:.3f} {d:.3f}",
            flush=True,
        )
        for what, one, other in (("delivered", a, c), ("repeated", b, d)):
            if abs(one - other) > 0.03 * max(1, one):
                raise SystemExit(
                    f"{name}: {what}: ours {one:.3f}, SimPy {other:.3f} of published: not one model"
                )
    spread = f"{np.median(ratios):.0f} ({min(ratios):.0f} to {max(ratios):.0f})"
    print(f"event rate against SimPy: {spread}, asked {ASKED_RATIO}")


def time_grid(workers: int) -> None:
    """Print how long the whole grid takes."""
    points = grid(exp.config("quick"))
    simulate_cell(points[0], 1)  # compiled or loaded from here on
    with tempfile.TemporaryDirectory() as folder:
        start_s, before_s = time.perf_counter(), time.process_time()
        rows = sweep(
            simulate_cell,
            points,
            [0],
            journal=Path(folder) / "grid",
            workers=Workers(count=workers, threads=True),
        )
        seconds, cpu_s = time.perf_counter() - start_s, time.process_time() - before_s
    frames = sum(row["data"] + row["heartbeats"] + row["acknacks"] for row in rows)
    print(
        f"grid: {len(rows)} cells of {points[0].duration_s:.0f} s, {frames / 1e6:.1f} million frames, "
        f"{workers} threads: {seconds:.1f} s ({cpu_s:.1f} s of processors), asked {ASKED_S} s"
    )


def main() -> None:
    """Run both and print."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--rounds", type=int, default=30, help="of few, chance alone exceeds what is allowed"
    )
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args()
    compiled(scenario_of(CELLS[0]), 0)
    compare(options.rounds)
    time_grid(options.workers)


if __name__ == "__main__":
    main()

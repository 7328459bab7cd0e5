"""Budget of a message: each step of its way to a reader, and the least that this machine takes.

A picture to a local reader by shared memory and by DDS, and 64 bytes by DDS and through a router, at a camera's
pace, at which every process sleeps in between, and at a fast one. The least is the work that nobody gets round:
a copy of the pixels, one pass over them, and a datagram to a process that waits for it.
"""

from __future__ import annotations

import asyncio
import socket
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sfglab.bus import Node
from sfglab.bus.address import BusAddress
from sfglab.fields import between
from sfglab.fleet.decoder.pipeline import LOCAL_QOS, image_bytes, image_prefix, write_image
from sfglab.fleet.router.node import RouterConfig
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.figures import COLORS, note
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import Estimate, ratio_of
from sfglab.lab.testbed import held_domains
from sfglab.lab.workers import steps
from sfglab.lab.workers.steps import IMAGE, TEXT, StepsConfig
from sfglab.messages import default_message, serialize
from sfglab.processes import Member, ProcessGroup

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.bench import Bench

SIZE = (360, 640, 3)  #: Shape of a picture.
RATES_HZ = (30.0, 500.0)  #: A camera's pace, and a fast one.
STEPS = {
    "prepare_us": "prepare",
    "write_us": "write",
    "hand_over_us": "hand over",
    "read_us": "read",
}
LEAST = "least"  #: The way that is measured for its steps alone.
_MATCH_S = 60.0


class Way(NamedTuple):
    """A way to a reader, and how often its messages have to be copied, handed to a process and read."""

    type: str
    transport: str
    far: bool  #: Whether the reader is behind a router.
    least: tuple[int, int, int]  #: Copies, hand-overs, passes over the pixels.


WAYS = {
    "picture, shared memory": Way(IMAGE, "shm", False, (1, 1, 1)),
    "picture, DDS": Way(IMAGE, "dds", False, (2, 1, 1)),
    "64 B, DDS": Way(TEXT, "dds", False, (0, 1, 0)),
    "64 B, router": Way(TEXT, "dds", True, (0, 2, 0)),
}


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    #: How often each way is measured at each pace, in random order.
    bouts: int = between(4, 1, 1000)
    messages: int = between(45, 4, 10_000)  #: How many a bout has.
    seed: int = 0  #: Seed of the order.


exp = Experiment(
    "performance",
    Config,
    where="beside all papers",
    smoke={"bouts": 1, "messages": 12},
    paper={"bouts": 40},
    actors=(
        Actor("sender", "this machine", "a picture, or 64 bytes"),
        Actor("router", "this machine", "one domain to another"),
        Actor("reader", "this machine", "reads every pixel", count="5: a process for each way"),
    ),
    links=(
        Link("sender", "reader", "pictures", over="shared memory, DDS"),
        Link("sender", "router", "64 bytes"),
        Link("router", "reader", "64 bytes", boundary="border"),
    ),
)


@exp.table("step")
class StepRow:
    """One message."""

    way: str  #: One of `WAYS`, or `LEAST`.
    rate_hz: float  #: At which pace.
    bout: int  #: In which bout.
    number: int  #: Which of it.
    prepare_us: float  #: To make what stands before the pixels, or the whole, as CDR.
    write_us: float  #: To copy the pixels.
    hand_over_us: float  #: From the call that sends until the reader's callback begins.
    read_us: float  #: To read every pixel.


class _Sender:
    """Sends along all ways, and notes when."""

    def __init__(self, near: Node, datagrams: socket.socket, port: int) -> None:
        self._pixels = np.random.default_rng(0).integers(0, 255, SIZE, np.uint8)
        self._others = [
            self._pixels.copy() for _ in range(24)
        ]  # 17 MB: a camera's next picture is in no cache
        self._text = default_message(TEXT)
        self._header = default_message(IMAGE).header
        self._datagrams, self._port = datagrams, port
        self._publishers = {
            name: near.create_publisher(
                way.type,
                topic_of(name),
                LOCAL_QOS,
                transport=way.transport,  # type: ignore[arg-type]
            )
            for name, way in WAYS.items()
        }

    async def matched(self) -> None:
        """Wait until every way has its reader."""
        for publisher in self._publishers.values():
            await publisher.wait_for_subscriptions(1, timeout_s=_MATCH_S)

    async def bout(self, way: str, count: int, rate_hz: float) -> list[list[int]]:
        """Send so many; return of each its number, and when it was begun, prepared, written and sent, ns."""
        due_ns, noted = time.monotonic_ns(), []
        for number in range(count):
            due_ns += round(1e9 / rate_hz)
            await asyncio.sleep((due_ns - time.monotonic_ns()) / 1e9)
            self._header.stamp.sec = number
            self._text.data = f"{number:055d}"
            noted.append([number, *(self._least(number) if way == LEAST else self._send(way))])
        return noted

    def _send(self, name: str) -> tuple[int, int, int, int]:
        publisher, way, begun_ns = self._publishers[name], WAYS[name], time.monotonic_ns()
        picture = way.type == IMAGE
        cdr = image_prefix(self._header, self._pixels, "bgr8") if picture else serialize(self._text)
        prepared_ns = time.monotonic_ns()
        if way.transport == "shm":
            with publisher.loan(len(cdr) + self._pixels.nbytes) as buffer:
                write_image(buffer, cdr, self._pixels)
                sent_ns = time.monotonic_ns()
        else:
            whole = image_bytes(cdr, self._pixels) if picture else cdr
            sent_ns = time.monotonic_ns()
            publisher.publish_raw(whole)
        return begun_ns, prepared_ns, sent_ns, sent_ns

    def _least(self, number: int) -> tuple[int, int, int, int]:
        begun_ns = time.monotonic_ns()
        np.copyto(self._others[number % 8], self._pixels)
        copied_ns = time.monotonic_ns()
        np.bitwise_xor.reduce(self._others[8 + number % 16].reshape(-1).view(np.uint64))
        sent_ns = time.monotonic_ns()
        self._datagrams.sendto(self._text.data.encode(), ("127.0.0.1", self._port))
        return begun_ns, begun_ns, copied_ns, sent_ns


def topic_of(way: str) -> str:
    """Return the topic of a way."""
    return f"/global/pc/steps_{list(WAYS).index(way)}"


@exp.part("ways", total=lambda config: config.bouts * len(RATES_HZ))
async def measure_ways(bench: Bench[Config]) -> None:
    """Measure all ways at both paces, interleaved."""
    config, rng = bench.config, np.random.default_rng(bench.config.seed)
    here, there = (
        BusAddress(domain_id=d, interface="lo") for d in bench.stack.enter_context(held_domains(2))
    )
    readers = {
        name: StepsConfig(
            address=there if way.far else here,
            topic=topic_of(name),
            type=way.type,
            transport=way.transport,
        )
        for name, way in WAYS.items()
    }
    readers[LEAST] = StepsConfig(address=there)
    members = [
        Member(name=name, module=steps.__name__, config=config) for name, config in readers.items()
    ]
    router = RouterConfig(agent="pc", local=here, remote=there)
    members.append(Member(name="router", module="sfglab.fleet.router.node", config=router))
    async with (
        ProcessGroup(lambda _, command: command, members) as group,
        Node("sender", **here.options()) as node,
    ):
        datagrams = bench.stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
        sender = _Sender(node, datagrams, group[LEAST].readiness["port"])
        await sender.matched()
        for bout in range(config.bouts):
            for rate_hz in RATES_HZ:
                for way in rng.permutation([*WAYS, LEAST]):
                    noted = await sender.bout(str(way), config.messages, rate_hz)
                    await asyncio.sleep(0.2)
                    told = (await group.ask("told", [str(way)], timeout_s=60, do="tell"))[str(way)][
                        "times"
                    ]
                    _write(bench, {"way": str(way), "rate_hz": rate_hz, "bout": bout}, noted, told)
                bench.advance(f"{rate_hz:g} Hz")


def _write(
    bench: Bench[Config], of: dict[str, Any], noted: list[list[int]], told: list[list[int]]
) -> None:
    had = {number: (begun_ns, done_ns) for number, begun_ns, done_ns in told}
    for number, begun_ns, prepared_ns, written_ns, sent_ns in noted:
        if number in had:
            in_hand_ns, read_ns = had[number]
            row = {"number": number, "prepare_us": (prepared_ns - begun_ns) / 1e3}
            row |= {
                "write_us": (written_ns - prepared_ns) / 1e3,
                "hand_over_us": (in_hand_ns - sent_ns) / 1e3,
            }
            # The least reads its pixels before it sends; a datagram alone is handed over.
            row["read_us"] = (read_ns - in_hand_ns + sent_ns - written_ns) / 1e3
            bench.write("step", of | row)


@derived
def budget(run: Run[Config]) -> pd.DataFrame:
    """Return, by way and pace, the median of each step, of the whole, and the least of it that there is, us."""
    rows = run["step"].rename(columns=STEPS)
    rows = rows.assign(whole=rows[list(STEPS.values())].sum(axis=1))
    medians = rows.groupby(["way", "rate_hz"])[[*STEPS.values(), "whole"]].median()
    of = medians.xs(LEAST)[["write", "hand over", "read"]]
    parts = {name: (of * np.array(way.least)).sum(axis=1) for name, way in WAYS.items()}
    medians = medians.drop(index=LEAST, level="way").reset_index()
    return medians.assign(least=[parts[row.way][row.rate_hz] for row in lines_of(medians)])


def slower(run: Run[Config], way: str) -> Estimate:
    """Return how many times as long a way takes at a camera's pace as at the fast one, by bouts."""
    rows = run["step"][run["step"]["way"] == way]
    rows = rows.assign(whole=rows[list(STEPS)].sum(axis=1))
    bouts = rows.pivot_table(index="bout", columns="rate_hz", values="whole", aggfunc="median")
    return ratio_of(bouts.to_numpy(float), np.median, unit="times as long")


@exp.figure("performance", size=(11, 4.4))
def draw(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw what each step of a message's way takes, by way and pace, and the least that this machine takes."""
    table = budget(run)
    for place, kind in zip(figure.subplots(1, 2), ("picture", "64 B"), strict=True):
        _draw_ways(place, kind, table[table["way"].str.startswith(kind)])
    shown = {f"{row['way']} at {row['rate_hz']:g} Hz": row for row in table.to_dict("records")}
    shared = shown[f"picture, shared memory at {RATES_HZ[0]:g} Hz"]
    took, least = shared["whole"] / 1e3, shared["least"] / 1e3
    figure.suptitle(
        f"A picture reaches a local reader in {took:.2f} ms; copy, wake-up and reading take {least:.2f} ms"
    )
    bouts, messages = run.config.bouts, run.config.messages
    note(figure, f"medians of {bouts} bouts of {messages} messages; pictures {SIZE[1]} x {SIZE[0]}")
    return shown


def _draw_ways(axes: Axes, kind: str, table: pd.DataFrame) -> None:
    names = [f"{row.way.partition(', ')[2]}\n{row.rate_hz:g} Hz" for row in lines_of(table)]
    left = np.zeros(len(table))
    for step, color in zip(STEPS.values(), ("network", "proxy", "standard", "third"), strict=True):
        axes.barh(names, table[step], left=left, color=COLORS[color], label=step)
        left += table[step].to_numpy()
    for place, least in enumerate(table["least"]):
        said = "the least" if not place else ""
        axes.plot([least] * 2, [place - 0.42, place + 0.42], color="black", linewidth=2, label=said)
    axes.invert_yaxis()
    axes.set(title=kind, xlabel="time (us)", xlim=(0, 1.03 * left.max()))
    axes.legend()

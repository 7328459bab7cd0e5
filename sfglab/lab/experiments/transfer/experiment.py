"""The module `transfer.experiment` has configuration, tables and parts of the experiment on transfer times.

The memory model gives the bars of Fig. 6 and 7. The experiment also simulates the memory part of a transfer in
hardware: each of the four paths over the memory interface has a law of cycles. With these laws the model gives the
bars again. The live part exchanges messages between processes in the setup of Fig. 5.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from sfglab.fields import to_json
from sfglab.lab.bench import TableRow
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.soc.memory import STORED, Costs
from sfglab.soc.paper_values import MESSAGE_BYTES, SUBSCRIBERS, speed_ups

if TYPE_CHECKING:
    from collections.abc import Mapping

    from sfglab.lab.bench import Bench

MODEL = "stored"  #: Name of the memory model's bars in the log.
RTL = "rtl"  #: Name of the bars with the cycles of simulated hardware in the log.
OUT, IN, READS, WRITE = PATHS = (
    "gateway, memory to stream",
    "gateway, stream to memory",
    "shared reads",
    "write",
)
"""Paths of a message over the memory interface, by the values of `sfglab.soc.rtl.MemoryPath`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The `Config` has the sizes and counts of a run."""

    #: Numbers of hardware subscribers for the simulated hardware.
    rtl_subscribers: tuple[int, ...] = SUBSCRIBERS
    #: Message sizes between processes, bytes, multiples of 8.
    live_bytes: tuple[int, ...] = MESSAGE_BYTES
    #: Numbers of subscribing processes on the hardware side.
    live_subscribers: tuple[int, ...] = SUBSCRIBERS
    live_rounds: int = 40  #: Number of live repetitions; 0 for a run without the live part.
    seed: int = 0  #: Seed of the order of live measurements and of the messages.


exp = Experiment(
    "transfer",
    Config,
    where="C 4",
    smoke={
        "rtl_subscribers": (2,),
        "live_bytes": (10_000,),
        "live_subscribers": (2,),
        "live_rounds": 3,
    },
    paper={"live_rounds": 500},
    actors=(
        Actor("software", "software side", "holds the topic in software and publishes"),
        Actor("subscriber", "software side", "subscribes"),
        Actor("gateway", "hardware side", "transfers each message once"),
        Actor("publisher", "hardware side", "publishes"),
        Actor("reader", "hardware side", "subscribes", count="2, 4 or 8"),
    ),
    links=(
        Link("software", "subscriber", "both: one copy", "socket"),
        Link("software", "reader", "SMT: one copy for each", "socket", "software and hardware"),
        Link("software", "gateway", "gateway: one copy", "socket", "software and hardware"),
        Link("publisher", "reader", "gateway: message", "shared memory"),
        Link("publisher", "gateway", "gateway: message", "shared memory"),
        Link("gateway", "reader", "gateway: message", "shared memory"),
        Link("gateway", "software", "gateway: one copy", "socket", "software and hardware"),
        Link("publisher", "software", "SMT: one copy", "socket", "software and hardware"),
    ),
)


@exp.table("bar")
class TransferRow(TableRow):
    """A `TransferRow` is one bar of Fig. 6 or 7."""

    #: Origin of the times: ``stored`` for the memory model, ``rtl`` for the model with the cycles of simulated
    #: hardware.
    model: str
    panel: str  #: Sides of publisher and subscriber.
    message_bytes: int  #: Size of the message, bytes.
    subscribers: int  #: Number of hardware subscribers.
    smt_s: float  #: Transfer time over a software-mapped topic, s.
    gateway_s: float  #: Transfer time through a gateway, s.


@exp.table("law")
class CycleLawRow(TableRow):
    """A `CycleLawRow` is one path's law of cycles in simulated hardware: a straight line over a message's chunks."""

    path: str  #: Path over the memory interface.
    subscribers: int  #: Number of hardware subscribers.
    fixed_cycles: float  #: Cycles per message.
    chunk_cycles: float  #: Cycles per chunk, for all subscribers together.


@exp.table("crossing")
class CrossingRow(TableRow):
    """A `CrossingRow` is one message between processes."""

    repeat: int  #: Number of the repetition.
    publisher: str  #: Side of the publisher: ``software`` or ``hardware``.
    transport: str  #: Path of the message: ``smt`` or ``gateway``.
    message_bytes: int  #: Size of the message, bytes.
    subscribers: int  #: Number of subscribing processes on the hardware side.
    #: Time from the publication until the last subscriber on the hardware side has read the message, ns.
    hardware_ns: int
    #: Time from the publication until the software subscriber has read the message, ns.
    software_ns: int
    load: float  #: Load average of the machine over the last minute, read before the message.


@exp.part("model", timed=False)
def write_model(bench: Bench[Config]) -> None:
    """Write the model's bars of Fig. 6 and 7."""
    for bar in speed_ups():
        bench.write("bar", {"model": MODEL, **to_json(bar)})


@dataclass(frozen=True, slots=True)
class PathPoint:
    """A `PathPoint` is a path that the experiment simulates in hardware."""

    path: str  #: Path over the memory interface.
    subscribers: int  #: Number of hardware subscribers.


def simulated_paths(config: Config) -> list[PathPoint]:
    """Return the paths that the experiment simulates; without the extra ``rtl`` there is none."""
    if missing_tools():
        return []
    return [PathPoint(path, count) for count in config.rtl_subscribers for path in PATHS]


def missing_tools() -> dict[str, str]:
    """Return the reason why the run leaves out the simulated hardware; empty if the run simulates hardware."""
    if find_spec("amaranth") is None:
        return {"rtl": "left out: amaranth is not installed (the extra rtl)"}
    return {}


def memory_in_hardware() -> Costs:
    """Return the model with whole numbers of latency cycles, as simulated hardware counts cycles."""
    return replace(
        STORED,
        read_latency_cycles=round(STORED.read_latency_cycles),
        write_latency_cycles=round(STORED.write_latency_cycles),
    )


@exp.sweep("law", over=simulated_paths, seeds=lambda _: (0,))
def simulate_law(point: PathPoint, _seed: int) -> dict[str, float]:
    """Simulate a path with two message sizes, and return the path's law of cycles."""
    from sfglab.soc.rtl import Delays, MemoryPath, cycle_model

    memory = memory_in_hardware()
    delays = Delays(read=int(memory.read_latency_cycles), write=int(memory.write_latency_cycles))
    return asdict(cycle_model(MemoryPath(point.path), point.subscribers, delays))


@exp.part("hardware", timed=False)
def write_hardware(bench: Bench[Config]) -> None:
    """Write the bars that follow from the cycles of simulated hardware."""
    bench.metadata("missing", missing_tools())
    chunk_cycles: dict[int, dict[str, float]] = {}
    for law in bench.rows.get("law", ()):
        chunk_cycles.setdefault(law.subscribers, {})[law.path] = law.chunk_cycles
    for count, cycles in chunk_cycles.items():
        bench.write_all("bar", bars_with_cycles(count, cycles))


def bars_with_cycles(count: int, chunk_cycles: Mapping[str, float]) -> list[dict[str, Any]]:
    """Return the bars for a number of subscribers if each path takes other cycles per chunk."""
    words = STORED.data_cycles
    over_topic = _with_cycles(chunk_cycles[READS] / count, chunk_cycles[WRITE])
    # A gateway's core takes the cycles of the stream in addition to the cycles of the memory.
    by_gateway = _with_cycles(chunk_cycles[OUT] - words, chunk_cycles[IN] - words)
    smt_bars = speed_ups(over_topic, subscribers=[count])
    gateway_bars = speed_ups(by_gateway, subscribers=[count])
    rows = []
    for smt, gateway in zip(smt_bars, gateway_bars, strict=True):
        rows.append({"model": RTL, **to_json(smt), "gateway_s": gateway.gateway_s})
    return rows


def _with_cycles(read_cycles: float, write_cycles: float) -> Costs:
    """Return the model with other cycles per chunk; all cycles except those of the words count as latency."""
    words = STORED.data_cycles
    return replace(
        STORED,
        control_cycles=0.0,
        read_latency_cycles=read_cycles - words,
        write_latency_cycles=write_cycles - words,
    )

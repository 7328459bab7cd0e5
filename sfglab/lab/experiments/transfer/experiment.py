"""Configuration of the transfer experiment, and the rows that it writes, one class a table."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.fields import between
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.soc.memory import STORED
from sfglab.soc.paper_values import MESSAGE_BYTES, SUBSCRIBERS

_US = 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    refits: int = 20  #: Starts from which the model is fitted anew.
    #: Numbers of hardware subscribers for which the hardware is simulated.
    rtl_subscribers: tuple[int, ...] = SUBSCRIBERS
    #: Bytes that the hardware moves where a law of cycles is checked; a multiple of 64.
    rtl_check_bytes: int = 100_032
    areas: bool = True  #: Whether the gateway is synthesised.
    proved: bool = True  #: Whether its control is held against the core's table by induction.
    live_bytes: tuple[int, ...] = MESSAGE_BYTES  #: Message sizes across processes; multiples of 8.
    #: Numbers of subscribing processes on the hardware's side.
    live_subscribers: tuple[int, ...] = SUBSCRIBERS
    live_rounds: int = 40  #: How often every cell is repeated; 0: nothing is live.
    most_subscribers: int = 16  #: Largest number of hardware subscribers in the break-even chart.
    sizes: int = 26  #: How many sizes the topics of Fig. 8 take, from 100 B to 10 MB.
    small_graphs: int = 12  #: Random graphs on which node mapping is compared with brute force.
    small_nodes: int = 8  #: Their largest number of nodes.
    large_graphs: int = 4  #: Random graphs on which node mapping is timed.
    large_nodes: int = 50  #: Their number of nodes.
    subscribers: int = between(4, 1, 16)  #: Hardware subscribers of the curves.
    #: Where the curves are read.
    message_bytes: int = between(1_000_000, 256, 100_000_000, log=True)
    #: From a read request to its first word [cycles].
    read_latency_cycles: float = between(STORED.memory.read_latency_cycles, 1, 300, log=True)
    #: From a write's last word to its response [cycles].
    write_latency_cycles: float = between(STORED.memory.write_latency_cycles, 1, 300, log=True)
    #: A delegate's round trip [µs].
    delegate_us: float = between(_US * STORED.delegate_s, 1, 2000, log=True)
    #: What a node or core spends on a message at either end [µs].
    endpoint_us: float = between(_US * STORED.endpoint_s, 1, 2000, log=True)
    #: A gateway core's cancel [µs].
    cancel_us: float = between(_US * STORED.cancel_s, 1, 2000, log=True)
    seed: int = 0  #: Seed of everything that is drawn.


exp = Experiment(
    "transfer",
    Config,
    where="C 4",
    smoke={
        "refits": 2,
        "rtl_subscribers": (2,),
        "rtl_check_bytes": 4096,
        "areas": False,
        "proved": False,
        "live_bytes": (10_000,),
        "live_subscribers": (2,),
        "live_rounds": 3,
        "most_subscribers": 8,
        "sizes": 6,
        "small_graphs": 2,
        "small_nodes": 5,
        "large_graphs": 1,
        "large_nodes": 12,
    },
    paper={
        "refits": 30,
        "rtl_check_bytes": 10**6,
        "live_rounds": 500,
        "small_graphs": 40,
        "large_graphs": 10,
    },
    actors=(
        Actor("software", "software's side", "holds the topic in software and publishes"),
        Actor("subscriber", "software's side", "subscribes in software"),
        Actor("gateway", "hardware's side", "carries each message across once"),
        Actor("publisher", "hardware's side", "publishes"),
        Actor("reader", "hardware's side", "subscribes", count="2, 4 or 8"),
    ),
    links=(
        Link("software", "subscriber", "messages", "socket"),
        Link("software", "reader", "a copy each", "socket", "software and hardware"),
        Link("software", "gateway", "one copy", "socket", "software and hardware"),
        Link("publisher", "reader", "messages", "shared memory"),
        Link("publisher", "gateway", "messages", "shared memory"),
        Link("gateway", "reader", "messages", "shared memory"),
        Link("gateway", "software", "one copy", "socket", "software and hardware"),
        Link("publisher", "software", "messages", "socket", "software and hardware"),
    ),
)


@exp.table("bar", "curve")
class TransferBarRow:
    """A bar of Fig. 6 or 7, or a point of a curve over sizes by the configuration's own constants."""

    #: Which set of constants; ``rtl``: the first with the hardware's cycles of a chunk; ``own``: the run's.
    model: str
    panel: str  #: From whom to whom.
    message_bytes: int  #: Size of the message.
    subscribers: int  #: Subscribing hardware nodes.
    smt_s: float  #: Transfer time over a software-mapped topic, seconds.
    gateway_s: float  #: Transfer time through a gateway, seconds.


@exp.table("stated")
class StatedRow:
    """A number that the paper states, beside the model's."""

    model: str  #: Which set of constants.
    panel: str  #: Whose speed-up.
    text: str  #: How the paper puts it.
    stated: float  #: The paper's number.
    found: float  #: The model's.


@exp.table("tendency")
class TendencyRow:
    """A sentence of the paper without a number."""

    model: str  #: Which set of constants.
    panel: str  #: Whose speed-up.
    text: str  #: What the paper says, as it is read here.
    holds: bool  #: Whether the model has it.


@exp.table("constant")
class ConstantRow:
    """A constant of the model."""

    model: str  #: Which set of constants.
    constant: str  #: Its name.
    value: float  #: In its unit.
    unit: str  #: As text.
    origin: str  #: Where it comes from.
    reason: str  #: Why this value, or what it stands for.
    #: What the best of this run's fits says; the value itself where it is not fitted.
    refitted: float


@exp.table("refit")
class RefitRow:
    """A fit from a drawn start."""

    model: str  #: Which set of constants.
    start: int  #: Counter from 0.
    farthest: float  #: Largest factor between a constant's start and its committed value.
    #: Root mean square of the logarithms of model / stated where it ended; NaN: nowhere.
    rms: float
    #: Largest relative difference between its constants and the committed ones; NaN: it ended nowhere.
    shift: float


@exp.table("variant")
class VariantRow:
    """A fit with one assumed constant changed."""

    model: str  #: Which set of constants.
    constant: str  #: The changed one.
    factor: float  #: By which it was multiplied.
    rms: float  #: Root mean square of the logarithms of model / stated.
    worst: float  #: Largest residual, relative and without sign.


@exp.table("law")
class CycleLawRow:
    """Cycles of a message in the simulated hardware, as a straight line over its chunks."""

    path: str  #: What was simulated.
    subscribers: int  #: Hardware subscribers.
    fixed_cycles: float  #: Of a message.
    chunk_cycles: float  #: Of each of its chunks, for all subscribers together.


@exp.table("cycles")
class CycleCheckRow:
    """A message in the simulated hardware beside the law and the model."""

    path: str  #: What was simulated.
    subscribers: int  #: Hardware subscribers.
    message_bytes: int  #: Size of the message.
    simulated: bool  #: Whether it was simulated; else it is the law's value.
    rtl_cycles: float  #: Of the hardware.
    law_cycles: float  #: Of its law.
    model_cycles: float  #: Of the model of the memory interface.


@exp.table("area")
class AreaRow:
    """What a gateway takes of an UltraScale+ device, by synthesis without placement."""

    subscribers: int  #: Hardware subscribers.
    luts: int  #: Look-up tables of logic.
    ram_cells: int  #: Cells of distributed memory.
    flip_flops: int  #: Flip-flops.
    carries: int  #: Carry cells.
    block_rams: int  #: Block memories.


@exp.table("crossing")
@dataclass(frozen=True, slots=True, kw_only=True)
class CrossingRow:
    """One message across the boundary between processes."""

    repeat: int  #: Which repetition.
    publisher: str  #: ``software`` or ``hardware``: the side on which it stands.
    transport: str  #: ``smt`` or ``gateway``.
    message_bytes: int  #: Size of the message.
    subscribers: int  #: Subscribing processes on the hardware's side.
    #: Place of the software subscriber among those that the topic in software delivers to, from 0.
    place: int
    hardware_ns: int  #: From the publication until the last of the hardware's side has read it, ns.
    software_ns: int  #: Until the software subscriber has read it, ns.
    load: float  #: The machine's load average over the last minute, before the message.


@exp.table("break_even")
class BreakEvenRow:
    """From which size on a gateway is faster in the model."""

    publisher: str  #: ``software`` or ``hardware``.
    judge: str  #: Whose transfer time counts: ``hardware``, ``software`` or ``last``.
    subscribers: int  #: Subscribing hardware nodes; one software node subscribes besides.
    worth: bool  #: Whether there is such a size.
    from_bytes: int  #: The size; 0 where there is none.
    #: How often the faster one changes between 256 B and 1 GiB, over 200 sizes; more than 1 would say that one
    #: size is not the whole answer.
    changes: int


@exp.table("sized_mapping")
class SizedMappingRow:
    """The example of Fig. 8 mapped by one rule, all its messages of one size."""

    message_bytes: int  #: The size.
    rule: str  #: ``paper``, ``size-aware`` or ``none``: who gets a gateway.
    gateways: int  #: Topics at a gateway.
    topics: str  #: Their names.
    #: Transfer time of one message of each topic, to its last subscriber, all added, seconds.
    predicted_s: float
    carriages: float  #: How often these messages are carried across, together.


@exp.table("placed")
class PlacedRow:
    """A random graph placed. Costs are seconds of work each second; NaN: not computed."""

    kind: str  #: ``small`` or ``large``.
    graph: int  #: Counter from 0.
    nodes: int  #: Its nodes.
    topics: int  #: Its topics.
    in_hardware: int  #: Nodes that the programme placed in hardware.
    gateways: int  #: Gateways that it took.
    optimal: bool  #: Whether that is proved.
    seconds: float  #: How long it took on this machine.
    placed: float  #: Its cost.
    #: The least cost of all placements with all choices of gateways; of small graphs.
    brute_force: float
    same_without_gateways: float  #: The cost of the same placement without gateways.
    #: The cost of a placement that fills the hardware by time saved per area, blind to topics.
    greedy: float
    greedy_with_gateways: float  #: The same with a gateway wherever it pays and fits.
    software: float  #: The cost of everything in software.

"""The rows that the transfer experiment writes into its log, one class a table."""

from __future__ import annotations

from dataclasses import dataclass

__all__ = [
    "AreaRow",
    "BreakEvenRow",
    "ConstantRow",
    "CrossingRow",
    "CycleCheckRow",
    "CycleLawRow",
    "PlacedRow",
    "RefitRow",
    "SizedMappingRow",
    "StatedRow",
    "TendencyRow",
    "TransferBarRow",
    "VariantRow",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class TransferBarRow:
    """A bar of Fig. 6 or 7.

    Attributes:
        model: Which set of constants, or ``rtl``: the first with the hardware's cycles of a chunk.
        panel: From whom to whom.
        message_bytes: Size of the message.
        subscribers: Subscribing hardware nodes.
        smt_s: Transfer time over a software-mapped topic, seconds.
        gateway_s: Transfer time through a gateway, seconds.
    """

    model: str
    panel: str
    message_bytes: int
    subscribers: int
    smt_s: float
    gateway_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StatedRow:
    """A number that the paper states, beside the model's.

    Attributes:
        model: Which set of constants.
        panel: Whose speed-up.
        text: How the paper puts it.
        stated: The paper's number.
        found: The model's.
    """

    model: str
    panel: str
    text: str
    stated: float
    found: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TendencyRow:
    """A sentence of the paper without a number.

    Attributes:
        model: Which set of constants.
        panel: Whose speed-up.
        text: What the paper says, as it is read here.
        holds: Whether the model has it.
    """

    model: str
    panel: str
    text: str
    holds: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class ConstantRow:
    """A constant of the model.

    Attributes:
        model: Which set of constants.
        constant: Its name.
        value: In its unit.
        unit: As text.
        origin: Where it comes from.
        reason: Why this value, or what it stands for.
        refitted: What the best of this run's fits says; the value itself where it is not fitted.
    """

    model: str
    constant: str
    value: float
    unit: str
    origin: str
    reason: str
    refitted: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RefitRow:
    """A fit from a drawn start.

    Attributes:
        model: Which set of constants.
        start: Counter from 0.
        farthest: Largest factor between a constant's start and its committed value.
        rms: Root mean square of the logarithms of model / stated where it ended; NaN: nowhere.
        shift: Largest relative difference between its constants and the committed ones; NaN: it ended nowhere.
    """

    model: str
    start: int
    farthest: float
    rms: float
    shift: float


@dataclass(frozen=True, slots=True, kw_only=True)
class VariantRow:
    """A fit with one assumed constant changed.

    Attributes:
        model: Which set of constants.
        constant: The changed one.
        factor: By which it was multiplied.
        rms: Root mean square of the logarithms of model / stated.
        worst: Largest residual, relative and without sign.
    """

    model: str
    constant: str
    factor: float
    rms: float
    worst: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleLawRow:
    """Cycles of a message in the simulated hardware, as a straight line over its chunks.

    Attributes:
        path: What was simulated.
        subscribers: Hardware subscribers.
        fixed_cycles: Of a message.
        chunk_cycles: Of each of its chunks, for all subscribers together.
    """

    path: str
    subscribers: int
    fixed_cycles: float
    chunk_cycles: float


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleCheckRow:
    """A message in the simulated hardware beside the law and the model.

    Attributes:
        path: What was simulated.
        subscribers: Hardware subscribers.
        message_bytes: Size of the message.
        simulated: Whether it was simulated; else it is the law's value.
        rtl_cycles: Of the hardware.
        law_cycles: Of its law.
        model_cycles: Of the model of the memory interface.
    """

    path: str
    subscribers: int
    message_bytes: int
    simulated: bool
    rtl_cycles: float
    law_cycles: float
    model_cycles: float


@dataclass(frozen=True, slots=True, kw_only=True)
class AreaRow:
    """What a gateway takes of an UltraScale+ device, by synthesis without placement.

    Attributes:
        subscribers: Hardware subscribers.
        luts: Look-up tables of logic.
        ram_cells: Cells of distributed memory.
        flip_flops: Flip-flops.
        carries: Carry cells.
        block_rams: Block memories.
    """

    subscribers: int
    luts: int
    ram_cells: int
    flip_flops: int
    carries: int
    block_rams: int


@dataclass(frozen=True, slots=True, kw_only=True)
class CrossingRow:
    """One message across the boundary between processes.

    Attributes:
        repeat: Which repetition.
        publisher: ``software`` or ``hardware``: the side on which it stands.
        transport: ``smt`` or ``gateway``.
        message_bytes: Size of the message.
        subscribers: Subscribing processes on the hardware's side.
        place: Place of the software subscriber among those that the topic in software delivers to, from 0.
        hardware_ns: From the publication until the last of the hardware's side has read it, ns.
        software_ns: Until the software subscriber has read it, ns.
        load: The machine's load average over the last minute, before the message.
    """

    repeat: int
    publisher: str
    transport: str
    message_bytes: int
    subscribers: int
    place: int
    hardware_ns: int
    software_ns: int
    load: float


@dataclass(frozen=True, slots=True, kw_only=True)
class BreakEvenRow:
    """From which size on a gateway is faster in the model.

    Attributes:
        publisher: ``software`` or ``hardware``.
        judge: Whose transfer time counts: ``hardware``, ``software`` or ``last``.
        subscribers: Subscribing hardware nodes; one software node subscribes besides.
        worth: Whether there is such a size.
        from_bytes: The size; 0 where there is none.
        changes: How often the faster one changes between 256 B and 1 GiB, over 200 sizes; more than 1 would say
            that one size is not the whole answer.
    """

    publisher: str
    judge: str
    subscribers: int
    worth: bool
    from_bytes: int
    changes: int


@dataclass(frozen=True, slots=True, kw_only=True)
class SizedMappingRow:
    """The example of Fig. 8 mapped by one rule, all its messages of one size.

    Attributes:
        message_bytes: The size.
        rule: ``paper``, ``size-aware`` or ``none``: who gets a gateway.
        gateways: Topics at a gateway.
        topics: Their names.
        predicted_s: Transfer time of one message of each topic, to its last subscriber, all added, seconds.
        carriages: How often these messages are carried across, together.
    """

    message_bytes: int
    rule: str
    gateways: int
    topics: str
    predicted_s: float
    carriages: float


@dataclass(frozen=True, slots=True, kw_only=True)
class PlacedRow:
    """A random graph placed. Costs are seconds of work each second; NaN: not computed.

    Attributes:
        kind: ``small`` or ``large``.
        graph: Counter from 0.
        nodes: Its nodes.
        topics: Its topics.
        in_hardware: Nodes that the programme placed in hardware.
        gateways: Gateways that it took.
        optimal: Whether that is proved.
        seconds: How long it took on this machine.
        placed: Its cost.
        brute_force: The least cost of all placements with all choices of gateways; of small graphs.
        same_without_gateways: The cost of the same placement without gateways.
        greedy: The cost of a placement that fills the hardware by time saved per area, blind to topics.
        greedy_with_gateways: The same with a gateway wherever it pays and fits.
        software: The cost of everything in software.
    """

    kind: str
    graph: int
    nodes: int
    topics: int
    in_hardware: int
    gateways: int
    optimal: bool
    seconds: float
    placed: float
    brute_force: float
    same_without_gateways: float
    greedy: float
    greedy_with_gateways: float
    software: float

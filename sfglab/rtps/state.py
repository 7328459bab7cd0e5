"""The module `state` has state and parameters of the compiled engine: named tuples of arrays, mostly of records.

Indices are flow, host, transmitter, server (a node's executor) or sample, counted from 1 as in RTPS. Times
are nanoseconds. A record's fields are those of a class below, each a number of 64 bits, so that compiled
code reads them as attributes (``world.writer[flow].last``).
"""

from __future__ import annotations

from enum import IntEnum
from functools import cache
from typing import Any, NamedTuple, get_type_hints

import numpy as np


class Event(IntEnum):
    """An `Event` is a kind of event; the argument of an event is a flow, a transmitter or a server."""

    PUBLISH = 0
    SENT = 1
    ARRIVED = 2
    HEARTBEAT = 3
    ACKNACK = 4
    REPAIR = 5
    SERVED = 6


class Frame(IntEnum):
    """A `Frame` is a kind of frame on the medium."""

    DATA = 0
    HEARTBEAT = 1
    ACKNACK = 2
    GAP = 3
    BURST = 4  #: Several samples that travel together; a BURST counts as one DATA.
    #: Full frame of a fragmented BURST. The last frame of the BURST follows, with the remaining bytes and fields.
    FRAGMENT = 5


class Arrival(IntEnum):
    """An `Arrival` is the state of a sample at the reader."""

    MISSING = 0
    HERE = 1
    #: The sample will not arrive: the writer no longer has the sample, or the reader has dropped the sample.
    GONE = 2


class Fate(IntEnum):
    """A `Fate` is the delivery outcome of a sample."""

    UNDERWAY = 0  #: Sample neither delivered nor given up.
    DELIVERED = 1
    #: Sample lost on the way, and overwritten in the writer's history before its retransmission.
    OVERWRITTEN = 2
    #: Sample arrived, and overwritten in the reader's history before the application took the sample.
    LATE = 3


class Count(IntEnum):
    """A `Count` is the index of a counter."""

    DATA = 0
    HEARTBEAT = 1
    ACKNACK = 2
    GAP = 3
    REPEATED = 4  #: Number of samples that were retransmitted.
    LOST = 5  #: Number of frames that the medium lost.
    QUEUE_FULL = 6  #: Number of frames that found the sender's queue full.
    AIRTIME_NS = 7
    HELD = 8  #: Number of values that the local cache suppressed.
    #: Number of publications that a writer refused because its history or the host's queue was full.
    THROTTLED = 9
    EVENTS = 10
    COMPARED = 11  #: Number of samples that cache control discarded after a comparison.


class FlowFields(NamedTuple):
    """`FlowFields` describes one flow for the engine."""

    source: int  #: Host of the writer.
    target: int  #: Host of the reader.
    server: int
    period_ns: int  #: Period of publications, ns; 0 if only a chain publishes the flow.
    phase_ns: int
    size_bytes: int  #: CDR size of a sample, bytes.
    depth: int  #: Depth of the writer's history.
    reader_depth: int  #: Depth of the reader's history.
    reliable: int
    chain: int  #: Flow that the executor publishes after a sample of this flow; -1: none.
    #: Mean time between changes of the value, ns; 0: every sample has a new value; `SET`: a session sets the value.
    change_ns: int
    cached: int  #: 1: a local cache suppresses repeated values.
    service_ns: int
    compare_ns: int  #: Time of the server per repeated value, ns; -1: the time of any other value.
    keeps_acked: int  #: 1: acknowledged samples stay in the writer's history, for late joiners.


class TimingFields(NamedTuple):
    """Parameters of the vendor, the medium and the run; most have the name of a field or property there."""

    heartbeat_ns: int
    burst_bytes: int
    nack_delay_ns: int
    ack_delay_ns: int
    nack_response_ns: int
    nack_most: int
    prompt: int
    final_within_ns: int
    reorder_most: int
    piggyback_bytes: int
    sent_before: int  #: `Vendor.sent_before_bytes`; -1: a sample adds only its own bytes.
    asynchronous: int
    extra_bytes: int
    gap_for_gone: int
    shared: int
    latency_ns: int
    overhead_ns: int
    queue_frames: int
    queue_rule: int  #: Index in `channel.QUEUE_RULES`.
    random_turns: int
    stall_every_ns: int
    stall_ns: int
    access_point: int  #: Number of the access point among the hosts; -1: no access point.
    duration_ns: int
    loss: float
    burst_frames: float
    contention: float
    rate_bps: float


class FrameFields(NamedTuple):
    """`FrameFields` describes one frame on the medium."""

    kind: int  #: Kind of the frame, a `Frame`.
    flow: int
    #: Sample of DATA; first sample of the bitmap of a BURST, an ACKNACK or a GAP; number of a FRAGMENT.
    sample: int
    samples: int  #: Number of samples that the frame carries, or that a GAP declares to be gone.
    #: Number of heartbeats in the frame; a BURST has one heartbeat behind each of several samples.
    heartbeats: int
    final: int  #: 1: the heartbeat requests no response.
    oldest: int  #: Oldest sample that the heartbeat announces.
    newest: int  #: Newest sample that the heartbeat announces.
    #: Bitmap of `BITMAP_WORDS` words: the samples of a BURST, or the requested samples of an ACKNACK.
    bits: int


class Trace(NamedTuple):
    """A `Trace` has the start and the end on air, ns, and the loss of one traced frame."""

    began_ns: int
    ended_ns: int
    lost: int
    wish: int  #: Wish of the caller: 0 for a random loss, 1 for lost, 2 for not lost.


class Writer(NamedTuple):
    """A `Writer` is the state of one writer."""

    last: int  #: Newest sample.
    acked: int  #: Newest sample up to which all samples are acknowledged.
    armed: int  #: 1: the periodic heartbeat is scheduled.
    last_heartbeat_ns: int  #: Time of the last heartbeat, ns.
    value: int  #: Number of the value that the sensor has now.
    next_change_ns: int  #: Time of the value's next change, ns.
    sent_value: int  #: Value that was published last.
    data_ns: int  #: Time of the last DATA frame, ns.
    last_queued: int  #: Newest sample that has left the history for the host's queue.
    bytes_since_heartbeat: int  #: Bytes of samples since the last heartbeat.
    sent_bytes: int  #: Number of all bytes that the sending thread has sent.


class Reader(NamedTuple):
    """A `Reader` is the state of one reader."""

    next: int  #: Next sample that the reader delivers in order.
    writer_oldest: int  #: Oldest sample that the writer still has.
    writer_newest: int  #: Newest sample that the reader knows to exist.
    armed: int  #: 1: a response is scheduled.
    head: int  #: Number of samples that have left the history.
    tail: int  #: Number of samples that have entered the history.
    value: int  #: Value of the last sample that was processed.
    behind_gap: int  #: Number of samples that wait behind a gap.
    oldest: int  #: Lower bound of the samples that wait behind a gap.
    newest: int  #: Newest sample that has arrived.
    #: First sample after the last request. This field and the fields below serve prompt readers.
    nacked: int
    nacked_ns: int  #: Time of the last request, ns.
    repeated: int  #: 1: the last request was repeated because its time was over.
    answered_next: int  #: Value of `next` at the last response.
    answered_ns: int  #: Time of the last response, ns.
    asked: int  #: 1: the writer requests a response.
    repaired: int  #: 1: a heartbeat after retransmissions requests the response.
    #: Number of the current message's frames that have arrived; -1: one of these frames is lost.
    fragments: int


class Server(NamedTuple):
    """A `Server` is the state of one executor."""

    busy: int
    flow: int  #: Flow whose sample the executor processes.
    sample: int
    next: int  #: Flow whose turn is next.
    waiting: int  #: Number of samples in the histories that the executor serves.
    same: int  #: 1: the sample has the value of the sample before.


class Transmitter(NamedTuple):
    """A `Transmitter` is the state of a sender of one frame at a time: the shared medium, or one host."""

    busy: int
    began_ns: int
    host: int  #: Host whose frame is on air.
    turn: int  #: Host whose turn is next.
    flight_head: int
    in_flight: int


class Delivery(NamedTuple):
    """The last delivery of another value than the flow's delivery before."""

    watched: int  #: 1: `engine.advance` returns at such a delivery.
    fresh: int  #: 1: not yet returned.
    flow: int
    sample: int


BITMAP_WORDS = 4
#: Largest number of samples that one request or BURST can name (RTPS 2.5, clause 9.4.2.6).
BITMAP = 64 * BITMAP_WORDS


@cache
def record(fields: Any) -> np.dtype[Any]:
    """Return the NumPy type of records with the fields of a class of this module; ``bits`` is a bitmap."""
    columns: list[tuple[Any, ...]] = []
    for name, kind in get_type_hints(fields).items():
        shape = BITMAP_WORDS if name == "bits" else ()
        columns.append((name, kind, shape))
    return np.dtype((np.record, np.dtype(columns, align=True)))


class Params(NamedTuple):
    """`Params` has the parameters of a run."""

    flows: Any  # (F,) of FlowFields
    timing: Any  # () of TimingFields


class State(NamedTuple):
    """Arrays of a run: F flows, N + 1 samples, H hosts, T transmitters, Q frames, S servers, E events."""

    # (E, 2) each event's time, and in one word its order (from bit 23), argument (20 bits) and kind (3 bits)
    heap: Any
    heap_sizes: Any  # (2,) number of events in the heap, and of all insertions
    random: Any  # (1,) state of the generator
    counts: Any  # see Count
    published_ns: Any  # (F, N + 1)
    received_ns: Any  # (F, N + 1), 0 while not delivered
    value: Any  # (F, N + 1) number of the value that a sample carries
    fate: Any  # (F, N + 1)
    arrived: Any  # (F, N + 1) of Arrival
    order: Any  # (F, N + 1) samples as the reader's history received them
    writer: Any  # (F,) of Writer
    reader: Any  # (F,) of Reader
    # (F,) of FrameFields: ACKNACK that waits for retransmissions; without an ACKNACK the sample is 0
    request: Any
    queue: Any  # (H, Q) of FrameFields, a ring
    head: Any  # (H,) place of the oldest frame in the queue
    waiting: Any  # (H,) frames in the queue
    blocked: Any  # (H,) whether a queue that blocks accepts no frame
    bad: Any  # (H,) whether a host's frames are in a burst of losses
    transmitter: Any  # (T,) of Transmitter
    on_air: Any  # (T,) of FrameFields
    flight: Any  # (T, K) of FrameFields: frames that have left the air and not arrived, a ring
    trace: Any  # (K,) of Trace; K is 0 without a trace
    traced: Any  # (K,) of FrameFields
    trace_end: Any  # (1,) number of frames in the trace
    server: Any  # (S,) of Server
    delivery: Any  # () of Delivery
    # (4,) of FrameFields: the received frame, the new frame, a fragment, an empty frame
    scratch: Any


SET = -1
LONG_AGO = -(10**18)


class Sizes(NamedTuple):
    """`Sizes` has the sizes of a state's arrays."""

    hosts: int
    servers: int
    samples: int  #: Largest number of samples of one flow.
    queue: int  #: Number of frames that a host's queue holds.
    flight: int  #: Largest number of frames in flight from one transmitter.
    trace: int = 0  #: Number of frames in the trace.


def new_state(params: Params, sizes: Sizes, *, seed: int) -> State:
    """Return the state at time 0, with each periodic flow's first publication scheduled."""
    # Numba takes its time to import.
    from sfglab.rtps.world import GOLDEN, push, scattered

    flows, hosts = len(params.flows), sizes.hosts
    transmitters = 1 if params.timing["shared"] else hosts
    frame = record(FrameFields)
    per_sample = (flows, sizes.samples + 1)
    room = 8 * flows + 4 * (transmitters + sizes.servers) + transmitters * sizes.flight + 16
    state = State(
        heap=np.zeros((room, 2), np.int64),
        heap_sizes=np.zeros(2, np.int64),
        # All random numbers are of one sequence. Seeds that follow each other must not begin one number apart,
        # because they would lose the same frames.
        random=np.array([scattered(np.uint64((seed + 1) * int(GOLDEN) % 2**64))], np.uint64),
        counts=np.zeros(len(Count), np.int64),
        published_ns=np.zeros(per_sample, np.int64),
        received_ns=np.zeros(per_sample, np.int64),
        value=np.zeros(per_sample, np.int32),
        fate=np.zeros(per_sample, np.int8),
        arrived=np.zeros(per_sample, np.int8),
        order=np.zeros(per_sample, np.int32),
        writer=np.zeros(flows, record(Writer)),
        reader=np.zeros(flows, record(Reader)),
        request=np.zeros(flows, frame),
        queue=np.zeros((hosts, sizes.queue), frame),
        head=np.zeros(hosts, np.int64),
        waiting=np.zeros(hosts, np.int64),
        blocked=np.zeros(hosts, np.int8),
        bad=np.zeros(hosts, np.int8),
        transmitter=np.zeros(transmitters, record(Transmitter)),
        on_air=np.zeros(transmitters, frame),
        flight=np.zeros((transmitters, sizes.flight), frame),
        trace=np.zeros(sizes.trace, record(Trace)),
        traced=np.zeros(sizes.trace, frame),
        trace_end=np.zeros(1, np.int64),
        server=np.zeros(sizes.servers, record(Server)),
        delivery=np.zeros((), record(Delivery)),
        scratch=np.zeros(4, frame),
    )
    state.writer["sent_value"] = -1
    state.writer["data_ns"] = LONG_AGO
    state.reader["next"] = state.reader["writer_oldest"] = state.reader["answered_next"] = 1
    state.reader["value"] = -1
    state.reader["nacked_ns"] = state.reader["answered_ns"] = LONG_AGO
    for flow, row in enumerate(params.flows):
        if row["period_ns"]:
            push(state.heap, state.heap_sizes, row["phase_ns"], int(Event.PUBLISH), flow)
    return state

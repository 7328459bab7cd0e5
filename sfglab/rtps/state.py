"""State of the compiled engine, and its parameters: named tuples of arrays.

Indices are flow, host, transmitter, server (a node's executor) or sample, counted from 1 as in RTPS.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np


class Event(IntEnum):
    """Kinds of events; the argument is a flow, a transmitter or a server."""

    PUBLISH = 0
    SENT = 1
    ARRIVED = 2
    HEARTBEAT = 3
    ACKNACK = 4
    REPAIR = 5
    SERVED = 6


class Frame(IntEnum):
    """Kinds of frames on the medium."""

    DATA = 0
    HEARTBEAT = 1
    ACKNACK = 2
    GAP = 3
    BURST = 4  #: Several samples that travel together; counted as one DATA.
    FRAGMENT = 5
    """A full frame of a BURST that IP cuts, before the last one, which has the rest and the words."""


class Fate(IntEnum):
    """What became of a sample."""

    NEVER_SENT = 0
    DELIVERED = 1
    #: Lost on the way, and pushed out of the writer's history before it could be repaired.
    OVERWRITTEN = 2
    LATE = 3  #: Arrived, and pushed out of the reader's history before the application took it.
    UNDERWAY = 4  #: Neither delivered nor given up when time was over.
    NOT_REPAIRED = 5  #: Lost on the way, best effort.


class Drop(IntEnum):
    """Where a sample's first frame was lost."""

    NOT = 0
    MEDIUM = 1
    QUEUE = 2


class Count(IntEnum):
    """Index of each counter."""

    DATA = 0
    HEARTBEAT = 1
    ACKNACK = 2
    GAP = 3
    REPEATED = 4  #: DATA that repairs.
    DUPLICATE = 5  #: DATA that the reader had already.
    LOST = 6  #: Frames that the medium lost.
    QUEUE_FULL = 7  #: Frames that found the sender's queue full.
    BYTES = 8
    AIRTIME_NS = 9
    HELD = 10  #: Values that the local cache held back.
    #: Publications that a KEEP_ALL writer refused because too much was unacknowledged.
    THROTTLED = 11
    EVENTS = 12
    PROCESSED = 13  #: Samples that cost the application its full time.
    COMPARED = 14  #: Samples that cache control discarded after a comparison.


class FlowColumn(IntEnum):
    """Columns of `Params.flows`."""

    SOURCE = 0
    TARGET = 1
    SERVER = 2
    PERIOD_NS = 3  #: 0: published by a chain only.
    PHASE_NS = 4
    SIZE_BYTES = 5
    DEPTH = 6  #: 0: KEEP_ALL.
    READER_DEPTH = 7
    RELIABLE = 8
    CHAIN = 9  #: Flow that is published when a sample of this one was processed; -1: none.
    #: Mean time between changes of the value; 0: every sample differs; `SET`: set from outside.
    CHANGE_NS = 10
    CACHED = 11
    SILENCE_NS = 12  #: Longest silence of the local cache; 0: none.
    SERVICE_NS = 13
    COMPARE_NS = 14  #: What a repeated value costs the server; -1: as much as any.
    #: Whether acknowledged samples stay in the writer's history, for late joiners.
    KEEPS_ACKED = 15


class TimingColumn(IntEnum):
    """Entries of `Params.timing`."""

    HEARTBEAT_NS = 0
    HEARTBEAT_MAX_NS = 1
    PIGGYBACK_WHEN_FULL = 2
    BURST_BYTES = 3
    NACK_DELAY_NS = 4
    ACK_DELAY_NS = 5
    NACK_RESPONSE_NS = 6
    NACK_MOST = 7
    SHARED = 8  #: 1: one half-duplex medium for all hosts.
    LATENCY_NS = 9
    OVERHEAD_NS = 10
    DURATION_NS = 11
    UNACKED_MOST = 12
    DRAIN_NS = 13  #: How long repairs go on after the last publication.
    PROMPT = 14
    FINAL_NS = 15
    REORDER_MOST = 16
    PIGGYBACK_BYTES = 17
    SENT_BEFORE = 18  #: -1: a sample adds its own bytes only.
    QUEUES = 19  #: 1: the history is the queue of what is not sent yet.
    EXTRA_BYTES = 20
    QUEUE_FRAMES = 21
    QUEUE_RULE = 22  #: Place in `model.QUEUE_RULES`.
    ACCESS_POINT = 23  #: Its number among the hosts; -1: there is none.
    STALL_EVERY_NS = 24
    STALL_NS = 25
    RANDOM_TURNS = 26
    GAPS = 27  #: 1: a request for what has left the history is answered by a GAP.


class Params(NamedTuple):
    """What does not change: flows, timing, rates (loss, contention, mean burst), bits a second of each host."""

    flows: Any
    timing: Any
    rates: Any
    host_bps: Any


class State(NamedTuple):
    """What changes. Shapes: F flows, N + 1 samples, H hosts, T transmitters, Q frames, S servers."""

    heap: Any
    heap_sizes: Any
    random: Any  # (1,) state of the generator
    counts: Any  # (15,) see Count
    published_ns: Any  # (F, N + 1)
    received_ns: Any  # (F, N + 1), 0 while not delivered
    value: Any  # (F, N + 1) number of the value that a sample carries
    fate: Any  # (F, N + 1)
    dropped: Any  # (F, N + 1) see Drop
    arrived: Any  # (F, N + 1) 1 received, 2 declared irrelevant
    order: Any  # (F, N + 1) samples as the reader's history received them
    writer: Any  # (F, 14) see W
    reader: Any  # (F, 18) see R
    repair: Any  # (F, 5) base and bitmap of the request that waits
    queue: Any  # (H, Q, 8) frames
    queue_ends: Any  # (H, 3) head, length, whether somebody waits for room
    on_air: Any  # (T, 11) busy, frame, since when, whose
    bad: Any  # (H,) whether a host's frames are in a burst of losses
    trace: Any  # (K, 12) see TraceColumn; frames as they left the air; K is 0 where nobody looks
    trace_end: Any  # (1,) how many there are
    next_host: Any  # (T,)
    flight: Any  # (T, K, 8) frames that are under way
    flight_ends: Any  # (T, 2)
    server: Any  # (S, 7) see S
    watched: Any  # (F,) `advance` returns at: 0 none of the flow's deliveries, 1 those of a new value, 2 each
    delivery: Any  # (4,) see D; the last one
    scratch: Any  # (3, 8) the frame that is heard, one that is made, and one that goes before it


class W(IntEnum):
    """Columns of `State.writer`; HB is a heartbeat."""

    (
        LAST,
        ACKED,
        ARMED,
        INTERVAL,
        LAST_HB,
        ACKED_AT_HB,
        VALUE,
        CHANGE_AT,
        SENT,
        SENT_AT,
        WROTE_AT,
    ) = range(11)
    # Newest sample that has left the history for the host's queue; bytes since the last heartbeat, and in all.
    QUEUED, UNSHOWN, BYTES = range(11, 14)


class R(IntEnum):
    """Columns of `State.reader`."""

    # Next sample in order, first that the writer still has, last that is known to exist. Those that wait behind
    # a gap are counted in WAITING, and none of them is older than OLDEST.
    NEXT, FIRST, KNOWN, ARMED, HEAD, TAIL, VALUE, WAITING, OLDEST = range(9)
    # Of a prompt reader: the newest sample that has arrived; where the last request ended, when it was sent and
    # whether it was for the same again; what was acknowledged last and when; whether an answer is asked for,
    # and whether by a heartbeat after repairs.
    NEWEST, NACKED, NACKED_AT, AGAIN, ACKED, ACKED_AT, ASKED, REPAIRED = range(9, 17)
    FRAGMENTS = 17  # how many of the message that comes are here; -1: one of them is lost


class S(IntEnum):
    """Columns of `State.server`."""

    BUSY, FLOW, SAMPLE, NEXT, WAITING, SKIPS, SAME = range(7)


class TraceColumn(IntEnum):
    """Columns of `State.trace` behind a frame's words; WISH, set from outside: 0 as drawn, 1 lost, 2 not."""

    BEGAN, ENDED, LOST, WISH = range(8, 12)


class D(IntEnum):
    """Entries of `State.delivery`; FRESH: it was watched, and not yet returned."""

    FRESH, FLOW, SAMPLE, SKIPPED = range(4)


SET = -1
LONG_AGO = -(10**18)

_FRAME_FIELDS = 8


class Sizes(NamedTuple):
    """How much room a state has."""

    hosts: int
    servers: int
    samples: int  #: Most of one flow.
    queue: int  #: Frames that a host's queue holds.
    flight: int  #: Most frames under way at once from one transmitter.
    trace: int = 0  #: Frames of which a trace is kept.


def _scattered(seed: int) -> int:
    """Return where a seed's random numbers begin, far from every other seed's: all are of one sequence.

    It is SplitMix64's own scattering (S. Vigna, prng.di.unimi.it); seeds that follow each other would begin one
    number apart, and lose the same frames.
    """
    z = (seed + 1) * 0x9E3779B97F4A7C15 % 2**64
    z = (z ^ z >> 30) * 0xBF58476D1CE4E5B9 % 2**64
    z = (z ^ z >> 27) * 0x94D049BB133111EB % 2**64
    return z ^ z >> 31


def new_state(params: Params, sizes: Sizes, *, seed: int) -> State:
    """Return the state at time 0, with each periodic flow's first publication scheduled."""
    from sfglab.rtps.world import new_heap, push  # Numba takes its time to import

    flows = len(params.flows)
    transmitters = 1 if params.timing[TimingColumn.SHARED] else sizes.hosts
    room = 8 * flows + 4 * (transmitters + sizes.servers) + transmitters * sizes.flight + 16
    heap, heap_sizes = new_heap(room)
    per_sample = (flows, sizes.samples + 1)
    reader = np.zeros((flows, len(R)), np.int64)
    writer = np.zeros((flows, len(W)), np.int64)
    writer[:, W.SENT] = -1
    reader[:, R.NEXT] = reader[:, R.FIRST] = 1
    reader[:, R.VALUE] = -1
    reader[:, R.ACKED] = 1
    reader[:, [R.NACKED_AT, R.ACKED_AT]] = writer[:, W.WROTE_AT] = LONG_AGO
    for flow, row in enumerate(params.flows):
        if row[FlowColumn.PERIOD_NS]:
            push(heap, heap_sizes, row[FlowColumn.PHASE_NS], int(Event.PUBLISH), flow)
    return State(
        heap=heap,
        heap_sizes=heap_sizes,
        random=np.array([_scattered(seed)], np.uint64),
        counts=np.zeros(len(Count), np.int64),
        **{name: np.zeros(per_sample, np.int64) for name in ("published_ns", "received_ns")},
        **{name: np.zeros(per_sample, np.int32) for name in ("value", "order")},
        **{name: np.zeros(per_sample, np.int8) for name in ("fate", "dropped", "arrived")},
        writer=writer,
        reader=reader,
        repair=np.zeros((flows, 5), np.int64),
        queue=np.zeros((sizes.hosts, sizes.queue, _FRAME_FIELDS), np.int64),
        queue_ends=np.zeros((sizes.hosts, 3), np.int64),
        on_air=np.zeros((transmitters, 3 + _FRAME_FIELDS), np.int64),
        bad=np.zeros(sizes.hosts, np.int8),
        trace=np.zeros((sizes.trace, _FRAME_FIELDS + len(TraceColumn)), np.int64),
        trace_end=np.zeros(1, np.int64),
        next_host=np.zeros(transmitters, np.int64),
        flight=np.zeros((transmitters, sizes.flight, _FRAME_FIELDS), np.int64),
        flight_ends=np.zeros((transmitters, 2), np.int64),
        server=np.zeros((sizes.servers, len(S)), np.int64),
        watched=np.zeros(flows, np.int8),
        delivery=np.zeros(len(D), np.int64),
        scratch=np.zeros((3, _FRAME_FIELDS), np.int64),
    )

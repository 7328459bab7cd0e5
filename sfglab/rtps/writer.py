"""The module `writer` has the compiled writer: publications, heartbeats and retransmissions (RTPS 2.5, clause 8.4.9).

In all functions `world` is the state of the run, `now` is nanoseconds, and `flow` is the writer's flow. A prompt
vendor, such as Cyclone DDS, sends a heartbeat with each sample (`Vendor.prompt`). A BURST is one RTPS message with
several samples; if IP fragments a BURST, FRAGMENTs precede the BURST.
"""

from __future__ import annotations

import math
from typing import Any

from sfglab.rtps.medium import (
    burst_most,
    copy_frame,
    enqueue,
    fragment_count,
    has_bit,
    has_room,
    message_bytes,
    new_frame,
    set_bit,
    uniform,
)
from sfglab.rtps.state import BITMAP, SET, Count, Event, Frame
from sfglab.rtps.world import compiled, push


@compiled
def _first_kept(world: Any, flow: int) -> int:
    """Return the oldest sample in the writer's history."""
    return int(max(1, world.writer[flow].last - world.flows[flow].depth + 1))


# --- Samples -----------------------------------------------------------------------------------


@compiled
def _sample_value(world: Any, now: int, flow: int) -> int:
    """Return the number of the value that the sensor has now; the value changes at random times."""
    mean_ns = world.flows[flow].change_ns
    writer = world.writer[flow]
    if mean_ns == 0:
        writer.value += 1
    elif mean_ns != SET:  # With `SET` a session sets the value.
        while now >= writer.next_change_ns:
            writer.value += 1
            wait_ns = -math.log(1.0 - uniform(world.random)) * mean_ns
            writer.next_change_ns += max(1, int(wait_ns))
    return int(writer.value)


@compiled
def _is_full(world: Any, flow: int) -> bool:
    """Return whether a new sample would overwrite an unacknowledged sample, or with BEST_EFFORT an unsent one."""
    settings, writer = world.flows[flow], world.writer[flow]
    kept = writer.last - (writer.acked if settings.reliable else writer.last_queued)
    return bool(settings.depth <= kept)


@compiled
def write(world: Any, now: int, flow: int) -> None:
    """Publish the sensor's value, unless the local cache suppresses it or the writer still waits in its last one.

    A synchronous writer waits until its last sample has left the history. An asynchronous writer waits for the sending
    thread only if its history is full, because only then the oldest sample must leave the history.
    """
    writer, reliable = world.writer[flow], world.flows[flow].reliable
    value = _sample_value(world, now, flow)
    if world.flows[flow].cached and value == writer.sent_value:  # the local cache (paper B, 2.2)
        world.counts[Count.HELD] += 1
        return
    room = has_room(world, world.flows[flow].source)
    sends = room and writer.last_queued == writer.last
    waits = not sends and not world.timing.asynchronous
    if waits or (not room and _is_full(world, flow)):
        world.counts[Count.THROTTLED] += 1
        return
    sample = writer.last + 1
    if sample >= world.fate.shape[1]:
        raise IndexError("more samples than the state has room for")
    writer.last = sample
    writer.sent_value = value
    world.published_ns[flow, sample] = now
    world.value[flow, sample] = value
    if sends:
        writer.last_queued = sample
        _send_data(world, now, flow, sample)
    if reliable and not writer.armed:
        _schedule_heartbeat(world, flow, now + world.timing.heartbeat_ns)


@compiled
def _send_data(world: Any, now: int, flow: int, sample: int) -> None:
    """Send one sample, with a heartbeat if a heartbeat is due."""
    writer = world.writer[flow]
    frame = new_frame(world, Frame.DATA, flow)
    frame.sample = sample
    frame.samples = 1
    _add_heartbeats(world, frame, _heartbeats(world, now, flow, 1, False))
    frame.final = now - writer.data_ns < world.timing.final_within_ns
    writer.data_ns = now
    world.counts[Count.DATA] += 1
    enqueue(world, now, world.flows[flow].source, frame)


@compiled
def send_unsent(world: Any, now: int, host: int) -> None:
    """Send the samples of the flow that waits longest at a host whose queue has room, all samples together."""
    flow = -1
    oldest_ns = 0
    for other in range(world.flows.shape[0]):
        writer = world.writer[other]
        if world.flows[other].source == host and writer.last_queued < writer.last:
            since_ns = world.published_ns[other, writer.last_queued + 1]
            if flow < 0 or since_ns < oldest_ns:
                flow = other
                oldest_ns = since_ns
    if flow < 0 or not has_room(world, host):
        return
    writer, timing = world.writer[flow], world.timing
    first = max(writer.last_queued + 1, _first_kept(world, flow))
    most = burst_most(world.flows[flow].size_bytes, timing.burst_bytes)
    count = min(writer.last - first + 1, most, BITMAP)
    writer.last_queued = first + count - 1
    if count == 1:
        _send_data(world, now, flow, first)
        return
    frame = new_frame(world, Frame.BURST, flow)
    frame.sample = first
    frame.samples = count
    for place in range(count):
        set_bit(frame.bits, place)
    _add_heartbeats(world, frame, _heartbeats(world, now, flow, count, False))
    _send_burst(world, now, frame)


@compiled
def _send_burst(world: Any, now: int, frame: Any) -> None:
    """Send a BURST; if IP fragments the BURST, send the full frames of the BURST first."""
    settings, before = world.flows[frame.flow], world.scratch[2]
    before.kind = Frame.FRAGMENT
    before.flow = frame.flow
    for number in range(fragment_count(settings.size_bytes, frame.samples, frame.heartbeats)):
        before.sample = number
        enqueue(world, now, settings.source, before)
    world.counts[Count.DATA] += 1
    enqueue(world, now, settings.source, frame)


# --- Heartbeats --------------------------------------------------------------------------------


@compiled
def _shows_each(world: Any, flow: int) -> bool:
    """Return whether a heartbeat travels with every sample: always, or while the history is full."""
    settings, writer = world.flows[flow], world.writer[flow]
    if world.timing.prompt:
        return True
    # Without late joiners to keep it for, what is acknowledged leaves the history.
    gone = 0 if settings.keeps_acked else writer.acked
    return bool(writer.last - gone >= settings.depth)


@compiled
def _heartbeats(world: Any, now: int, flow: int, samples: int, retransmits: bool) -> int:  # noqa: FBT001 - compiled
    """Count the heartbeats that travel with samples, at most one behind each sample, and restart the count of bytes.

    Asynchronous Fast DDS counts all bytes that its sending thread has sent, not only the sample's own bytes, so
    heartbeats become more frequent during a run (`Vendor.sent_before_bytes`).
    """
    writer, timing = world.writer[flow], world.timing
    if not world.flows[flow].reliable:
        return 0
    each, count = _shows_each(world, flow), 0
    own = message_bytes(world.flows[flow].size_bytes)
    counts_all_bytes = timing.sent_before >= 0 and (retransmits or timing.asynchronous)
    for _ in range(samples):
        sent = own
        if counts_all_bytes:
            writer.sent_bytes += own
            sent = timing.sent_before + writer.sent_bytes
        writer.bytes_since_heartbeat += sent
        if each or writer.bytes_since_heartbeat > timing.piggyback_bytes > 0:
            writer.last_heartbeat_ns = now
            writer.bytes_since_heartbeat = 0
            count += 1
    return count


@compiled
def _add_heartbeats(world: Any, frame: Any, count: int) -> None:
    """Add heartbeats to a frame; each heartbeat announces the samples that the writer has now."""
    frame.heartbeats = count
    frame.oldest = _first_kept(world, frame.flow)
    frame.newest = world.writer[frame.flow].last


@compiled
def _schedule_heartbeat(world: Any, flow: int, due: int) -> None:
    world.writer[flow].armed = 1
    push(world.heap, world.heap_sizes, due, Event.HEARTBEAT, flow)


@compiled
def heartbeat(world: Any, now: int, flow: int) -> None:
    """Announce the samples while any is unacknowledged, and again after the period."""
    writer, timing = world.writer[flow], world.timing
    writer.armed = 0
    if writer.acked >= writer.last:
        return
    due = writer.last_heartbeat_ns + timing.heartbeat_ns
    if timing.prompt and now < due:
        _schedule_heartbeat(world, flow, due)
        return
    writer.last_heartbeat_ns = now
    writer.bytes_since_heartbeat = 0
    frame = new_frame(world, Frame.HEARTBEAT, flow)
    _add_heartbeats(world, frame, 1)
    world.counts[Count.HEARTBEAT] += 1
    enqueue(world, now, world.flows[flow].source, frame)
    _schedule_heartbeat(world, flow, now + timing.heartbeat_ns)


# --- Retransmissions ---------------------------------------------------------------------------


@compiled
def hear_acknack(world: Any, now: int, frame: Any) -> None:
    """Process a reader's ACKNACK at a time, ns, and retransmit requested samples after the vendor's delay."""
    flow, bits = frame.flow, frame.bits
    writer, request = world.writer[flow], world.request[flow]
    writer.acked = max(writer.acked, frame.sample - 1)
    if (bits[0] | bits[1] | bits[2] | bits[3]) == 0:
        return
    is_first = request.sample == 0
    copy_frame(request, frame)
    if is_first:
        due = now + world.timing.nack_response_ns
        push(world.heap, world.heap_sizes, due, Event.REPAIR, flow)


@compiled
def repair(world: Any, now: int, flow: int) -> None:
    """Send the samples of the last request again, and declare missing samples to be gone."""
    request, kept = world.request[flow], _first_kept(world, flow)
    base = request.sample
    first, end = max(base, kept), min(base + BITMAP, world.writer[flow].last_queued + 1)
    left = 0
    for sample in range(first, end):
        left += has_bit(request.bits, sample - base)
    if base < kept and world.timing.gap_for_gone:
        _send_gap(world, now, request, kept, left)
    world.counts[Count.REPEATED] += left
    if world.timing.burst_bytes:
        _repair_in_bursts(world, now, request, first, left)
    else:
        for sample in range(first, end):
            if has_bit(request.bits, sample - base):
                _send_data(world, now, flow, sample)
    request.sample = 0


@compiled
def _send_gap(world: Any, now: int, request: Any, kept: int, left: int) -> None:
    """Declare the samples before the oldest kept sample to be gone, with a prompt vendor's heartbeat if `left` is 0."""
    frame = new_frame(world, Frame.GAP, request.flow)
    frame.sample = request.sample
    frame.samples = kept - request.sample
    if left == 0 and world.timing.prompt:
        _add_heartbeats(world, frame, 1)
    world.counts[Count.GAP] += 1
    enqueue(world, now, world.flows[request.flow].source, frame)


@compiled
def _repair_in_bursts(world: Any, now: int, request: Any, first: int, left: int) -> None:
    """Send `left` samples, many per message; a prompt vendor sends a heartbeat with the last message."""
    flow, base, prompt = request.flow, request.sample, world.timing.prompt
    most = burst_most(world.flows[flow].size_bytes, world.timing.burst_bytes)
    sample = first
    while left > 0:
        frame = new_frame(world, Frame.BURST, flow)
        frame.sample = base
        while left > 0 and frame.samples < most:
            if has_bit(request.bits, sample - base):
                set_bit(frame.bits, sample - base)
                frame.samples += 1
                left -= 1
            sample += 1
        last = int(left == 0)
        heartbeats = last if prompt else _heartbeats(world, now, flow, frame.samples, True)
        _add_heartbeats(world, frame, heartbeats)
        _send_burst(world, now, frame)

"""One host of scenarios of the reliability model: ``python -m sfglab.lab.workers.scenario_player CONFIG``.

The process publishes its flows on an absolute schedule, through local caches where flows have them. It
takes samples for its executors as those of the model do: one after the other, in turn among an executor's
flows, each for its service time. The time of an executor is computed, not spent: a sample's service begins
when that of the previous one ended. Therefore a late check does not add up. The module depends on raw DDS
endpoints, in one thread, but not on hosts and measurements.

Orders, one scenario after the other: ``{"do": "open", "flows", "seed"}`` is answered by ``matched`` when
every endpoint has its peer. ``{"do": "play", "start_ns", "duration_s", "drain_s", "result"}`` is answered
by ``done`` with the delay of its schedule, after its arrays are in the file ``result`` (NumPy's npz).
``{"do": "close"}`` is answered by ``closed``.
"""

from __future__ import annotations

import asyncio
import ctypes as ct
import heapq
import random
import time
from collections import defaultdict, deque
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.cache import CacheControl, LocalCache
from sfglab.bus.address import BusAddress
from sfglab.bus.dds.clib import ANY_STATE, MatchedStatus, SampleInfo, library
from sfglab.bus.dds.domain import DdsParticipant, DomainConfig
from sfglab.bus.dds.endpoints import bytes_from_serdata, serdata_from_bytes, sertype_of, stamp
from sfglab.component import Orders, Reporter, run_component
from sfglab.fields import from_json
from sfglab.rtps import Flow
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.qos import QoSProfile

_TYPE = "std_msgs/msg/String"
# CDR of a text: header, length, characters, a final zero (RTPS 2.5, clause 10).
_HEADER = b"\x00\x01\x00\x00"
_FRAME_BYTES = len(_HEADER) + 4 + 1
_LONGEST_PAUSE_NS = 50_000_000
_MAX_TRIGGERED = 64
_LOOK_S = 0.02
# Participants assert their liveliness rarely. Unlike the medium, the times between announcements are not
# slowed down, and their frames would take the medium from the samples.
_LEASE_S = 1200.0
_PR_SET_TIMERSLACK = 29  # linux/prctl.h


@dataclass(frozen=True, slots=True, kw_only=True)
class PartsConfig:
    """Configuration of the process that plays one host's part of a scenario."""

    host: str  #: Name of the host in the flows.
    address: BusAddress  #: Address on the bus.


def text_of(value: int, size_bytes: int) -> bytes:
    """Return the CDR of a text of a given size that ends with a number's last digits: five in "Hello"."""
    letters = size_bytes - _FRAME_BYTES
    value %= 10**letters
    length = (letters + 1).to_bytes(4, "little")
    return _HEADER + length + f"{value:>{letters}}".encode() + b"\x00"


def value_of(cdr: bytes) -> int:
    """Return the digits that `text_of` wrote, as a number."""
    return int(cdr[8 : 7 + int.from_bytes(cdr[4:8], "little")])


def _reader_qos(flow: Flow) -> QoSProfile:
    if flow.reader_depth is None:
        return flow.qos
    return replace(flow.qos, depth=flow.reader_depth)


class _Sensor:
    """Value, writer and cache of a flow, and what it published; a time stamp identifies a sample."""

    def __init__(self, flow: Flow, participant: DdsParticipant, idl: type[Any], seed: int) -> None:
        self.flow = flow
        self.late_ns: list[int] = []  # delays of samples beyond their due times
        self.sent_ns: list[int] = []  # times of publication, which are also the source time stamps
        self.value: list[int] = []
        self.handle = participant.create_writer(f"rt/{flow.name}", idl, flow.qos)
        self._sertype = sertype_of(self.handle)
        self._random = random.Random(f"{seed} {flow.name}")
        self._latest = 0
        self._change_ns = 0
        self._cache = LocalCache() if flow.cached else None

    def read(self, now_ns: int) -> int:
        """Return the number of the sensor's current value."""
        if not self.flow.change_s:
            self._latest += 1
            return self._latest
        self._change_ns = self._change_ns or now_ns
        while now_ns >= self._change_ns:
            self._latest += 1
            pause_s = self._random.expovariate(1 / self.flow.change_s)
            self._change_ns += max(1, round(pause_s * NS_PER_S))
        return self._latest

    def offer(self, value: int, due_ns: int) -> None:
        """Publish a value unless the local cache holds it back."""
        name = self.flow.name
        cache = self._cache
        if cache is not None and not cache.offer(name, value, now_ns=due_ns).passes:
            return
        serdata = serdata_from_bytes(self._sertype, text_of(value, self.flow.size_bytes))
        assert serdata, "a text that Cyclone DDS cannot parse"
        now_ns = time.time_ns()
        stamp(serdata, now_ns)
        if library().dds_forwardcdr(self.handle, serdata) < 0:
            return  # DDS refused it
        self.late_ns.append(now_ns - due_ns)
        self.sent_ns.append(now_ns)
        self.value.append(value)


class _Inlet:
    """Reader of a flow with cache control, and the samples that its executor has received."""

    def __init__(self, flow: Flow, participant: DdsParticipant, idl: type[Any]) -> None:
        self.flow = flow
        self.sent_ns: list[int] = []  # source time stamps of the samples
        self.done_ns: list[int] = []  # times at which the executor was done with them
        # time since which samples are known to wait; None if none wait
        self.since_ns: int | None = None
        self.handle = participant.create_reader(f"rt/{flow.name}", idl, _reader_qos(flow))
        self.condition: int = library().dds_create_readcondition(self.handle, ANY_STATE)
        self._cache = CacheControl() if flow.compare_s is not None else None
        self._serdata: Any = (ct.c_void_p * 1)()
        self._infos: Any = (SampleInfo * 1)()

    def take(self) -> tuple[int, int] | None:
        """Return source time stamp and value of the oldest sample; None when there is none."""
        lib = library()
        if lib.dds_takecdr(self.handle, self._serdata, 1, self._infos, ANY_STATE) != 1:
            return None
        serdata = self._serdata[0]
        info = self._infos[0]
        cdr = bytes_from_serdata(serdata) if info.valid_data else b""
        lib.ddsi_serdata_unref(serdata)
        return (info.source_timestamp, value_of(cdr)) if cdr else self.take()

    def cost_ns(self, value: int, now_ns: int) -> int:
        """Return the service time of a value, ns: that of a comparison or the full one."""
        flow = self.flow
        cache = self._cache
        if cache is not None and not cache.offer(flow.name, value, now_ns=now_ns).passes:
            return round((flow.compare_s or 0.0) * NS_PER_S)
        return round(flow.service_s * NS_PER_S)


@dataclass(slots=True)
class _Executor:
    inlets: deque[_Inlet] = field(default_factory=deque)
    free_ns: int = 0

    def waiting(self) -> bool:
        return any(inlet.since_ns is not None for inlet in self.inlets)

    def turn(self) -> _Inlet | None:
        """Return the next flow, in turn, with samples that are known to wait."""
        for _ in range(len(self.inlets)):
            inlet = self.inlets[0]
            self.inlets.rotate(-1)
            if inlet.since_ns is not None:
                return inlet
        return None


class Player:
    """Flows that begin or end at this host; the seed is that of their values."""

    def __init__(
        self, participant: DdsParticipant, host: str, flows: Sequence[Flow], *, seed: int
    ) -> None:
        from sfglab.messages.dds import idl_struct

        idl = idl_struct(_TYPE)
        self._sensors = {
            f.name: _Sensor(f, participant, idl, seed) for f in flows if f.source == host
        }
        self._inlets = [_Inlet(f, participant, idl) for f in flows if f.target == host]
        executors: defaultdict[str, _Executor] = defaultdict(_Executor)
        for inlet in self._inlets:
            executors[inlet.flow.executor or f"{inlet.flow.name}\0"].inlets.append(inlet)
        self._executors = list(executors.values())
        lib = library()
        #: Endpoints, each with the function that reads its number of peers.
        self._ends = [
            *((lib.dds_get_publication_matched_status, s.handle) for s in self._sensors.values()),
            *((lib.dds_get_subscription_matched_status, i.handle) for i in self._inlets),
        ]
        self._waitset: int = lib.dds_create_waitset(participant.handle)
        for key, inlet in enumerate(self._inlets):
            lib.dds_waitset_attach(self._waitset, inlet.condition, key)
        self._keys: Any = (ct.c_ssize_t * _MAX_TRIGGERED)()
        # due time, flow, and the value of a processing chain or -1
        self._agenda: list[tuple[int, str, int]] = []

    def matched(self) -> bool:
        """Return whether every endpoint of this process has at least one matching endpoint."""
        status = MatchedStatus()
        for read_status, handle in self._ends:
            read_status(handle, ct.byref(status))
            if status.current_count < 1:
                return False
        return True

    def arrays(self) -> dict[str, Any]:
        """Return published and received samples, as columns of times or values by flow."""
        columns = {}
        for name, sensor in self._sensors.items():
            columns[f"{name} written sent_ns"] = sensor.sent_ns
            columns[f"{name} written value"] = sensor.value
        for inlet in self._inlets:
            columns[f"{inlet.flow.name} received sent_ns"] = inlet.sent_ns
            columns[f"{inlet.flow.name} received done_ns"] = inlet.done_ns
        return {name: np.array(column, np.int64) for name, column in columns.items()}

    def late_p95_s(self) -> float:
        """Return the 95th percentile of the delays of the schedule, s."""
        late_ns = [late for sensor in self._sensors.values() for late in sensor.late_ns]
        return float(np.percentile(late_ns, 95)) / NS_PER_S if late_ns else 0.0

    def close(self) -> None:
        """Destroy the endpoints."""
        delete = library().dds_delete
        delete(self._waitset)
        for _, handle in self._ends:
            delete(handle)

    def play(self, *, start_ns: int, duration_s: float, drain_s: float) -> None:
        """Publish for a duration from `start_ns`, Unix time, and receive for `drain_s` beyond that."""
        ct.CDLL(None).prctl(_PR_SET_TIMERSLACK, 1, 0, 0, 0)  # of this thread only
        for sensor in self._sensors.values():
            if sensor.flow.rate_hz:
                self._note(start_ns + round(sensor.flow.phase_s * NS_PER_S), sensor.flow.name, -1)
        last_ns = start_ns + round(duration_s * NS_PER_S)
        end_ns = last_ns + round(drain_s * NS_PER_S)
        while (now_ns := time.time_ns()) < end_ns:
            self._publish_due(now_ns, last_ns)
            for executor in self._executors:
                self._serve(executor, now_ns)
            self._wait(end_ns)

    def _note(self, due_ns: int, name: str, value: int) -> None:
        heapq.heappush(self._agenda, (due_ns, name, value))

    def _publish_due(self, now_ns: int, last_ns: int) -> None:
        while self._agenda and self._agenda[0][0] <= now_ns:
            due_ns, name, value = heapq.heappop(self._agenda)
            sensor = self._sensors[name]
            if value >= 0:
                sensor.offer(value, due_ns)
            elif due_ns < last_ns:
                sensor.offer(sensor.read(due_ns), due_ns)
                self._note(due_ns + round(NS_PER_S / sensor.flow.rate_hz), name, -1)

    def _serve(self, executor: _Executor, now_ns: int) -> None:
        while executor.free_ns <= now_ns and (inlet := executor.turn()) is not None:
            sample = inlet.take()
            if sample is None:
                inlet.since_ns = None
                continue
            sent_ns, value = sample
            assert inlet.since_ns is not None
            # the sample was sent after that time
            since_ns = inlet.since_ns if inlet.since_ns > sent_ns else time.time_ns()
            start_ns = max(executor.free_ns, since_ns)
            done_ns = executor.free_ns = start_ns + inlet.cost_ns(value, start_ns)
            inlet.since_ns = now_ns
            inlet.sent_ns.append(sent_ns)
            inlet.done_ns.append(done_ns)
            if inlet.flow.then is not None:
                self._note(done_ns, inlet.flow.then, value)

    def _wait(self, end_ns: int) -> None:
        """Wait for samples, at most until the next scheduled event."""
        next_ns = min(end_ns, self._agenda[0][0] if self._agenda else end_ns)
        busy = [executor.free_ns for executor in self._executors if executor.waiting()]
        pause_ns = max(0, min([next_ns, *busy]) - time.time_ns())
        if busy or not self._inlets:
            # The wait set would return at once, because samples wait for their executor, or because it is
            # empty.
            time.sleep(pause_ns / NS_PER_S)
            pause_ns = 0
        pause_ns = min(pause_ns, _LONGEST_PAUSE_NS)
        count = library().dds_waitset_wait(self._waitset, self._keys, _MAX_TRIGGERED, pause_ns)
        now_ns = time.time_ns()
        for i in range(min(count, _MAX_TRIGGERED)):
            inlet = self._inlets[self._keys[i]]
            if inlet.since_ns is None:
                inlet.since_ns = now_ns


async def serve(config: PartsConfig, report: Reporter, orders: Orders) -> None:
    """Run one scenario after the other until cancelled."""
    domain = DomainConfig(**config.address.options(), lease_s=_LEASE_S)
    participant = DdsParticipant(domain, b"", name=f"{config.host}.dds", after_round=lambda: None)
    report({"is": "ready"})
    try:
        while True:
            order = await orders.get()
            flows = from_json(tuple[Flow, ...], order["flows"])
            player = Player(participant, config.host, flows, seed=order["seed"])
            while not player.matched():  # noqa: ASYNC110 - Cyclone's status has no event
                await asyncio.sleep(_LOOK_S)
            report({"is": "matched"})
            order = await orders.get()
            del order["do"]
            result = order.pop("result")
            await asyncio.to_thread(player.play, **order)
            np.savez(result, **player.arrays())
            report({"is": "done", "late_p95_s": player.late_p95_s()})
            # the order to close: endpoints stay matched until all hosts are done
            await orders.get()
            await asyncio.to_thread(player.close)
            report({"is": "closed"})
    finally:
        await asyncio.to_thread(participant.close)


if __name__ == "__main__":
    run_component(PartsConfig, serve)

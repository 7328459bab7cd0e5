# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""A test bench in hardware: memory with latencies, a delegate, a publisher and subscribers around a gateway.

All of it is clocked logic, so that a simulation needs no Python per cycle. Knows what surrounds a gateway;
refuses to know what is measured with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from amaranth import Elaboratable, Module, Signal
from amaranth.lib.memory import Memory

from sfglab.soc.gateway import Drive
from sfglab.soc.rtl.control import ADDRESS_BITS
from sfglab.soc.rtl.core import Answer, Call, Gateway

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.soc.rtl.memif import MemoryPort
    from sfglab.soc.rtl.topic import Stream


OWN_SMT, OWN_HMT = 0x5_0001, 0x4_0001
"""Ids of the core on both topics."""
OUTPUT_WORD = 0
"""Word of the memory at which the output message begins; the message to forward follows it."""
WORD_FACTOR = 0x9E37_79B9_7F4A_7C15
"""Word i of a message in memory is i times this: all differ, in every part."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Delays:
    """Cycles that the memory takes."""

    read: int = 30  #: From the address to the first word, not counting either.
    write: int = 9  #: From the last word to the response, counting the latter; at least 1.


class SlowMemory(Elaboratable):
    """A memory that answers one request after the other.

    Args:
        port: Its master.
        content: Its words; as many as a power of two.
        delays: Its latencies.

    Attributes:
        content: The memory.
    """

    def __init__(self, port: MemoryPort, content: Sequence[int], delays: Delays) -> None:
        self.port = port
        self.content = Memory(shape=ADDRESS_BITS, depth=len(content), init=content)
        self._delays = delays

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m, port = Module(), self.port
        m.submodules.content = content = self.content
        read, write = content.read_port(domain="comb"), content.write_port()
        at, left, wait = Signal(32), Signal(8), Signal(16)
        m.d.comb += [
            port.grant.eq(1),
            read.addr.eq(at),
            port.read_data.eq(read.data),
            write.addr.eq(at),
            write.data.eq(port.write_data),
            write.en.eq(port.write_valid & port.write_ready),
        ]
        with m.FSM():
            with m.State("IDLE"):
                m.d.sync += [left.eq(port.words), at.eq(port.address >> 3)]
                with m.If(port.address_valid & port.write):
                    m.d.sync += wait.eq(self._delays.write - 1)
                    m.next = "WRITE"
                with m.Elif(port.address_valid):
                    m.d.sync += wait.eq(self._delays.read - 1)
                    m.next = "LATENCY" if self._delays.read else "READ"
            with m.State("LATENCY"):
                m.d.sync += wait.eq(wait - 1)
                with m.If(wait == 0):
                    m.next = "READ"
            with m.State("READ"):
                m.d.comb += port.read_valid.eq(1)
                self._step(m, at, left, "IDLE")
            with m.State("WRITE"):
                m.d.comb += port.write_ready.eq(1)
                with m.If(port.write_valid):
                    self._step(m, at, left, "RESPONSE")
            with m.State("RESPONSE"):
                m.d.sync += wait.eq(wait - 1)
                with m.If(wait == 0):
                    m.d.comb += port.response.eq(1)
                    m.next = "IDLE"
        return m

    @staticmethod
    def _step(m: Any, at: Any, left: Any, after: str) -> None:
        m.d.sync += [at.eq(at + 1), left.eq(left - 1)]
        with m.If(left == 1):
            m.next = after


class Bench(Elaboratable):
    """A gateway with all around it, for one message after another in one direction.

    Args:
        subscribers: Hardware subscribers.
        words: Of a message.
        from_software: The messages come from the software-mapped topic, else from the hardware node.
        delays: Of the memory.
        stalled: How many of eight cycles, in a fixed irregular order, each subscriber does not listen.

    Attributes:
        gateway: The gateway.
        memory: The memory.
        received: What each subscriber got last, without the id.
        cycles: Cycles of the latest transfer between memory and stream.
        through: Messages that went through the core.
    """

    def __init__(
        self, subscribers: int, words: int, *, from_software: bool, delays: Delays, stalled: int = 0
    ) -> None:
        self.gateway = Gateway(subscribers)
        size = 1 << (2 * words - 1).bit_length()
        content = [WORD_FACTOR * word % (1 << ADDRESS_BITS) for word in range(size)]
        self.memory = SlowMemory(self.gateway.mover.master.port, content, delays)
        self.received = [Memory(shape=ADDRESS_BITS, depth=size, init=[]) for _ in range(subscribers)]
        self.cycles = Signal(32)
        self.through = Signal(16)
        self._words, self._from_software, self._stalled = words, from_software, stalled

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m, gateway = Module(), self.gateway
        m.submodules.gateway = gateway
        m.submodules.memory = self.memory
        m.d.comb += [gateway.own_smt.eq(OWN_SMT), gateway.own_hmt.eq(OWN_HMT), gateway.words.eq(self._words)]
        for i, port in enumerate(gateway.ports):
            self._subscribe(m, i, port)
        self._delegate(m)
        if not self._from_software:
            self._publish(m)
        does, mover = gateway.control.does, gateway.mover
        now = Signal(32)
        with m.If(does(Drive.MEMORY_TO_HMT) | does(Drive.HMT_TO_MEMORY)):
            m.d.sync += now.eq(now + 1)
        with m.If(mover.done):
            m.d.sync += [self.through.eq(self.through + 1), self.cycles.eq(now + 1), now.eq(0)]
        return m

    def _subscribe(self, m: Any, place: int, port: Stream) -> None:
        """Write down what comes; irregular pauses come from a shift register."""
        m.submodules[f"received{place}"] = memory = self.received[place]
        write = memory.write_port()
        at, noise = Signal(32, name=f"at{place}"), Signal(16, init=0xACE1 + 77 * place, name=f"noise{place}")
        m.d.sync += noise.eq((noise >> 1) ^ ((noise[0]).replicate(16) & 0xB400))
        m.d.comb += [
            port.ready.eq(noise[:3] >= self._stalled),
            write.addr.eq(at - 1),
            write.data.eq(port.data),
            write.en.eq(port.passes & (at != 0)),
        ]
        with m.If(port.passes & port.last):
            m.d.sync += at.eq(0)
        with m.Elif(port.passes):
            m.d.sync += at.eq(at + 1)

    def _delegate(self, m: Any) -> None:
        """Answer each request once: with the one message of the memory, or by cancelling it."""
        gateway = self.gateway
        with m.FSM():
            with m.State("LOCATE"):
                self._answer(m, Answer.LOCATED, OUTPUT_WORD, "IDLE")
            with m.State("IDLE"):
                m.d.comb += gateway.call_ready.eq(1)
                with m.If(gateway.call_valid):
                    with m.If(gateway.call == Call.PUBLISH):
                        m.next = "PUBLISHED"
                    with m.Elif(gateway.call == Call.CANCEL):
                        m.next = "CANCELLED"
                    with m.Elif(self._from_software):
                        m.next = "ANSWER"
            with m.State("ANSWER"):
                self._answer(m, Answer.ANSWERED, OUTPUT_WORD + 8 * self._words, "IDLE")
            with m.State("CANCELLED"):
                self._answer(m, Answer.CANCELLED, 0, "IDLE")
            with m.State("PUBLISHED"):
                self._answer(m, Answer.PUBLISHED, 0, "IDLE")

    def _answer(self, m: Any, kind: Answer, address: int, after: str) -> None:
        gateway = self.gateway
        m.d.comb += [
            gateway.answer_valid.eq(1),
            gateway.answer.eq(kind),
            gateway.answer_address.eq(address),
        ]
        with m.If(gateway.answer_ready):
            m.next = after

    def _publish(self, m: Any) -> None:
        """Send messages without a pause: an id, then words that count."""
        node, at = self.gateway.node, Signal(32)
        m.d.comb += [node.valid.eq(1), node.data.eq(at + 0x1000), node.last.eq(at == self._words)]
        with m.If(node.ready):
            m.d.sync += at.eq(at + 1)
            with m.If(node.last):
                m.d.sync += at.eq(0)

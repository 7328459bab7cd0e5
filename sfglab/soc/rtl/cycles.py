# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""Cycles of a message between memory and stream: simulated on a test bench, and the cycle model through them.

The test bench is clocked logic (memory with latencies, a delegate, a publisher and subscribers around a
gateway), so that a simulation needs no Python per cycle. A message is an id, then chunks; all whole chunks take
the same number of cycles, so two sizes give the cycle model and a third shows that it holds.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

from amaranth import Elaboratable, Module, Signal
from amaranth.lib.memory import Memory

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.fields import between, bounds, check_bounds
from sfglab.soc.gateway import Drive
from sfglab.soc.rtl.core import Answer, Call, Gateway
from sfglab.soc.rtl.data_path import ADDRESS_BITS, CHUNK_WORDS, MemoryPort, Stream

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

T = TypeVar("T")

OWN_SMT, OWN_HMT = 0x5_0001, 0x4_0001  #: Ids of the core on both topics.
#: Word of the memory at which the output message begins; the message to forward follows it.
OUTPUT_WORD = 0
WORD_FACTOR = 0x9E37_79B9_7F4A_7C15
"""Word i of a message in memory is i times this: all differ, in every part."""
WORD_BYTES = ADDRESS_BITS // 8
CHUNK_BYTES = CHUNK_WORDS * WORD_BYTES
_STEP_CYCLES = 64  #: How often a simulation looks whether it is through.
_PERIOD_S = 10e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class Delays:
    """Cycles that the memory takes."""

    read: int = between(30)  #: From the address to the first word, not counting either.
    write: int = between(9, 1)  #: From the last word to the response, counting the latter.

    def __post_init__(self) -> None:
        check_bounds(self)


def check_words(message_bytes: int) -> None:
    """Refuse a message that is no positive number of words."""
    if message_bytes <= 0 or message_bytes % WORD_BYTES:
        raise InvalidValueError(
            "message_bytes", message_bytes, f"a multiple of {WORD_BYTES} above 0"
        )


class SlowMemory(Elaboratable):
    """A memory of 2**n words that answers one request of its master after the other, with delays."""

    def __init__(self, port: MemoryPort, content: Sequence[int], delays: Delays) -> None:
        self.port = port
        self.content = Memory(shape=ADDRESS_BITS, depth=len(content), init=content)  #: The memory.
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Transfer:
    """A message that is simulated on its way through a gateway."""

    message_bytes: int  #: A multiple of 8.
    subscribers: int = field(metadata=bounds())  #: Hardware subscribers.
    from_software: bool  #: From memory to the stream, else from the stream to memory.
    delays: Delays = field(default_factory=Delays)  #: Of the memory.
    #: Of eight cycles, in a fixed irregular order, how many each subscriber does not listen.
    stalled: int = between(0, 0, 7)

    def __post_init__(self) -> None:
        check_words(self.message_bytes)
        check_bounds(self)

    @property
    def words(self) -> int:
        """Words of the message."""
        return self.message_bytes // WORD_BYTES


class TransferBench(Elaboratable):
    """A gateway with all around it, for one message after another in one direction."""

    def __init__(self, transfer: Transfer) -> None:
        self.gateway = Gateway(transfer.subscribers)
        size = 1 << (2 * transfer.words - 1).bit_length()
        content = [WORD_FACTOR * word % (1 << ADDRESS_BITS) for word in range(size)]
        self.memory = SlowMemory(self.gateway.mover.master.port, content, transfer.delays)
        #: What each subscriber got last, without the id.
        self.received = [
            Memory(shape=ADDRESS_BITS, depth=size, init=[]) for _ in range(transfer.subscribers)
        ]
        self.cycles = Signal(32)  #: Cycles of the latest transfer between memory and stream.
        self.through = Signal(16)  #: Messages that went through the core.
        self._transfer, self._words = transfer, transfer.words

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m, gateway = Module(), self.gateway
        m.submodules.gateway = gateway
        m.submodules.memory = self.memory
        m.d.comb += [
            gateway.own_smt.eq(OWN_SMT),
            gateway.own_hmt.eq(OWN_HMT),
            gateway.words.eq(self._words),
        ]
        for i, port in enumerate(gateway.ports):
            self._subscribe(m, i, port)
        self._delegate(m)
        if not self._transfer.from_software:
            # Send messages without a pause: an id, then words that count.
            node, at = self.gateway.node, Signal(32)
            m.d.comb += [
                node.valid.eq(1),
                node.data.eq(at + 0x1000),
                node.last.eq(at == self._words),
            ]
            with m.If(node.ready):
                m.d.sync += at.eq(at + 1)
                with m.If(node.last):
                    m.d.sync += at.eq(0)
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
        at, noise = (
            Signal(32, name=f"at{place}"),
            Signal(16, init=0xACE1 + 77 * place, name=f"noise{place}"),
        )
        m.d.sync += noise.eq((noise >> 1) ^ ((noise[0]).replicate(16) & 0xB400))
        m.d.comb += [
            port.ready.eq(noise[:3] >= self._transfer.stalled),
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
                    with m.Elif(self._transfer.from_software):
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


@dataclass(frozen=True, slots=True, kw_only=True)
class CycleModel:
    """Cycles of messages of whole chunks."""

    fixed_cycles: float  #: Of a message.
    chunk_cycles: float  #: Of each chunk.

    def cycles(self, message_bytes: int) -> float:
        """Return the cycles of a message; a last chunk that is not full counts as if it were."""
        return self.fixed_cycles + self.chunk_cycles * -(-message_bytes // CHUNK_BYTES)


def run_bench(bench: Any, limit: int, ended: Callable[[Any], T | None], what: object) -> T:
    """Simulate a test bench until it has ended, within a limit of cycles; some 10 000 cycles a second.

    `ended` returns the result once there is one, given the simulator's context, or refuses it; `what` is
    simulated, for the SfglabError where nothing ends within the limit.
    """
    from amaranth.sim import Simulator

    simulator = Simulator(bench)
    simulator.add_clock(_PERIOD_S)
    found: list[T] = []

    async def watch(ctx: Any) -> None:
        for _ in range(limit // _STEP_CYCLES + 1):
            await ctx.delay(_STEP_CYCLES * _PERIOD_S)
            result = ended(ctx)
            if result is not None:
                found.append(result)
                return

    simulator.add_testbench(watch)
    simulator.run()
    if not found:
        raise SfglabError(f"{what}: not through after {limit} cycles")
    return found[0]


def simulate_transfer(transfer: Transfer) -> int:
    """Return the cycles of the core's transfer of up to 100 kB; SfglabError for a wrong or missing word."""
    bench, words = TransferBench(transfer), transfer.words
    slack = 8 * (words + CHUNK_WORDS) * (2 + transfer.stalled + transfer.subscribers)
    limit = slack + (words // CHUNK_WORDS + 2) * (transfer.delays.read + transfer.delays.write)

    def ended(ctx: Any) -> int | None:
        if not ctx.get(bench.through):
            return None
        memory = bench.memory.content.data
        if transfer.from_software:
            wanted = [ctx.get(memory[words + i]) for i in range(words)]
        else:
            wanted = [0x1001 + i for i in range(words)]
            compare_words(
                [ctx.get(memory[OUTPUT_WORD + i]) for i in range(words)], wanted, "output message"
            )
        for place, received in enumerate(bench.received):
            compare_words(
                [ctx.get(received.data[i]) for i in range(words)], wanted, f"subscriber {place}"
            )
        return int(ctx.get(bench.cycles))

    return run_bench(bench, limit, ended, transfer)


def compare_words(given: Sequence[int], wanted: Sequence[int], place: str) -> None:
    """Refuse words that arrived wrong at a place; the SfglabError says which."""
    if given != wanted:
        wrong = next(
            i for i, pair in enumerate(zip(given, wanted, strict=True)) if pair[0] != pair[1]
        )
        raise SfglabError(f"{place}, word {wrong}: {given[wrong]:#x}, must be {wanted[wrong]:#x}")

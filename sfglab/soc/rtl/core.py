# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""The gateway as one piece of hardware: control generated from the core's table, data path, topic and ports.

Turns wires into the table's inputs, and the table's drives into wires. The control is the table of
`sfglab.soc.gateway` as a register of states, so that order of events has one place. Knows what each input
and drive is in hardware.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from amaranth import Elaboratable, Module, Mux, Signal

from sfglab.soc.gateway import TABLE, Drive, Input, Latch, State, Table
from sfglab.soc.rtl.data_path import ADDRESS_BITS, Broadcast, Mover, Stream, Turns


def code(member: State | Input | Drive) -> int:
    """Return the number of a state in its register, or of an input's or a drive's bit."""
    return tuple(type(member)).index(member)


class Control(Elaboratable):
    """The state register and its moves by a table; an input that a state does not wait for changes nothing."""

    def __init__(self, table: Table = TABLE) -> None:
        #: In: one bit per input that is there in this cycle. Of several, the row's first counts.
        self.given = Signal(len(Input))
        self.value = Signal(ADDRESS_BITS)  #: In: the address beside the input.
        self.state = Signal(range(len(State)), init=code(State.START))  #: Out: code of the state.
        self.drive = Signal(len(Drive))  #: Out: one bit per drive, exactly one of them set.
        self.output = Signal(ADDRESS_BITS)  #: Out: address of the output message.
        #: Out: address of the last message that the delegate gave.
        self.held = Signal(ADDRESS_BITS)
        self._table = table

    def does(self, drive: Drive) -> Any:
        """Return the bit that says a drive."""
        return self.drive[code(drive)]

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m = Module()
        registers = {Latch.OUTPUT: self.output, Latch.HELD: self.held}
        with m.Switch(self.state):
            for state, row in self._table.items():
                with m.Case(code(state)):
                    m.d.comb += self.does(row.drive).eq(1)
                    for place, (given, move) in enumerate(row.moves.items()):
                        there = self.given[code(given)]
                        with m.Elif(there) if place else m.If(there):
                            m.d.sync += self.state.eq(code(move.to))
                            if move.latch is not None:
                                m.d.sync += registers[move.latch].eq(self.value)
        return m


class Call(IntEnum):
    """What the core asks its delegate for."""

    TAKE = 0
    CANCEL = 1
    PUBLISH = 2


class Answer(IntEnum):
    """What the delegate answers; beside it stand an address (0 and 1) and a publisher's id (1)."""

    LOCATED = 0
    ANSWERED = 1
    CANCELLED = 2
    PUBLISHED = 3


_CALLS = {
    Drive.CALL_TAKE: Call.TAKE,
    Drive.CALL_CANCEL: Call.CANCEL,
    Drive.CALL_PUBLISH: Call.PUBLISH,
}
_ANSWERS = {
    Answer.LOCATED: Input.LOCATED,
    Answer.ANSWERED: Input.ANSWERED,
    Answer.CANCELLED: Input.CANCELLED,
    Answer.PUBLISHED: Input.PUBLISHED,
}


class Gateway(Elaboratable):
    """A gateway with one publishing hardware node, any number of subscribing ones, and this core."""

    def __init__(self, subscribers: int) -> None:
        self.control = Control()  #: The core's control.
        self.mover = Mover()  #: The core's data path; `mover.master.port` is the memory interface.
        self.node = Stream("node")  #: In: the hardware publisher's stream.
        #: Out: the subscribers' streams.
        self.ports = [Stream(f"port{i}") for i in range(subscribers)]
        #: In: the id of the core's writer on the software-mapped topic.
        self.own_smt = Signal(ADDRESS_BITS)
        #: In: the core's id as a publisher of the hardware-mapped topic.
        self.own_hmt = Signal(ADDRESS_BITS)
        self.words = Signal(32)  #: In: of every message, without its id.
        self.call_valid = Signal()  #: Out: OSIF: a call stands at `call`.
        self.call_ready = Signal()  #: In: OSIF: it is taken.
        self.call = Signal(2)  #: Out: OSIF: a `Call`.
        self.answer_valid = Signal()  #: In: OSIF: an answer stands at `answer`.
        self.answer_ready = Signal()  #: Out: OSIF: it is taken.
        self.answer = Signal(2)  #: In: OSIF: an `Answer`.
        #: In: OSIF: of the output message or of the message taken.
        self.answer_address = Signal(ADDRESS_BITS)
        #: In: OSIF: id of the writer of the message taken.
        self.answer_publisher = Signal(ADDRESS_BITS)
        self._publisher = Signal(ADDRESS_BITS)

    @property
    def wires(self) -> list[Any]:
        """The ports of the exported module."""
        osif = [
            self.call_valid,
            self.call_ready,
            self.call,
            self.answer_valid,
            self.answer_ready,
            self.answer,
        ]
        streams = [wire for stream in (self.node, *self.ports) for wire in stream.wires]
        given = [self.own_smt, self.own_hmt, self.words, self.answer_address, self.answer_publisher]
        return [*osif, *given, *streams, *vars(self.mover.master.port).values()]

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m = Module()
        m.submodules.control = self.control
        m.submodules.mover = self.mover
        turns = self._topic(m)
        self._osif(m)
        self._inputs(m, turns)
        self._drives(m, turns)
        return m

    def _topic(self, m: Any) -> Turns:
        """Join senders, topic and ports."""
        topic = Stream("topic")
        turns = Turns(self.mover.sent, self.node, topic)
        m.submodules.turns = turns
        m.submodules.broadcast = Broadcast(topic, [self.mover.port, *self.ports])
        return turns

    def _osif(self, m: Any) -> None:
        """Call the delegate and listen to it; keep the publisher's id of the message it gave."""
        does = self.control.does
        m.d.comb += self.answer_ready.eq(does(Drive.LISTEN_OSIF))
        for drive, call in _CALLS.items():
            with m.If(does(drive)):
                m.d.comb += [self.call_valid.eq(1), self.call.eq(call)]
        with m.If(self.answer_valid & self.answer_ready & (self.answer == Answer.ANSWERED)):
            m.d.sync += self._publisher.eq(self.answer_publisher)

    def _inputs(self, m: Any, turns: Turns) -> None:
        """Say what is there, by what the core looks at."""
        does, port, answered = self.control.does, self.mover.port, self.answer_valid
        listens, peeks = does(Drive.LISTEN_OSIF), does(Drive.PEEK_HMT)
        held, at_port = does(Drive.COMPARE_HELD), does(Drive.COMPARE_PORT)
        own = Mux(held, self._publisher == self.own_smt, port.data == self.own_hmt)
        there = {
            given: listens & answered & (self.answer == kind) for kind, given in _ANSWERS.items()
        }
        there |= {
            Input.SENT: self.call_valid & self.call_ready,
            Input.EMPTY: (listens & ~answered) | (peeks & ~port.valid),
            Input.OFFERED: (peeks | does(Drive.CLAIM_HMT)) & port.valid,
            Input.GRANTED: turns.grant,
            Input.OWN: (held | at_port) & own,
            Input.FOREIGN: (held | at_port) & ~own,
            Input.DONE: self.mover.done,
        }
        m.d.comb += [self.control.given[code(given)].eq(wire) for given, wire in there.items()]
        m.d.comb += self.control.value.eq(self.answer_address)

    def _drives(self, m: Any, turns: Turns) -> None:
        """Let the topic and the data path do what the core says."""
        does, mover = self.control.does, self.mover
        m.d.comb += [
            turns.claim.eq(does(Drive.CLAIM_HMT)),
            mover.send.eq(does(Drive.MEMORY_TO_HMT)),
            mover.store.eq(does(Drive.HMT_TO_MEMORY)),
            mover.drop.eq(does(Drive.HMT_TO_NOWHERE)),
            mover.source.eq(self.control.held),
            mover.target.eq(self.control.output),
            mover.words.eq(self.words),
            mover.own_id.eq(self.own_hmt),
        ]

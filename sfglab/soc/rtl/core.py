# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""The module `core` has a gateway in hardware (paper C, Fig. 3): control, data path, hardware-mapped topic and ports.

The class `Control` generates its logic from the core's transition table, so that only the table defines the order of
events. The class `Gateway` connects the table to the wires: the wires set the table's inputs, and the
table's action drives the wires.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Any

from amaranth import Elaboratable, Module, Mux, Signal

from sfglab.soc.gateway import TABLE, Action, Input, Register, State, Table
from sfglab.soc.rtl.memory_port import COUNT_BITS, WORD_BITS
from sfglab.soc.rtl.mover import Mover
from sfglab.soc.rtl.topic import Broadcast, Stream, TopicArbiter


def code(member: State | Input | Action) -> int:
    """Return the value of a state in the state register, or the number of the bit of an input or an action."""
    return list(type(member)).index(member)


class Control(Elaboratable):
    """A `Control` has the state register and the transitions of a table, and ignores inputs without a transition."""

    def __init__(self, table: Table = TABLE) -> None:
        #: In: one bit per input, set while the input is present. If several inputs are present, the first input in the
        #: table's row counts.
        self.given = Signal(len(Input))
        self.value = Signal(WORD_BITS)  #: In: address that comes with the input.
        self.state = Signal(range(len(State)), init=code(State.START))  #: Out: code of the state.
        #: Out: one bit per action; the bit of the present state's action is set.
        self.action = Signal(len(Action))
        self.output = Signal(WORD_BITS)  #: Out: address of the output message.
        self.held = Signal(WORD_BITS)  #: Out: address of the held message.
        self._table = table

    def does(self, action: Action) -> Any:
        """Return the bit that is set while the control does an action."""
        return self.action[code(action)]

    def elaborate(self, _platform: object) -> Any:
        """Return the logic of the control as a module of Amaranth."""
        m = Module()
        registers = {Register.OUTPUT: self.output, Register.HELD: self.held}
        with m.Switch(self.state):
            for state, row in self._table.items():
                with m.Case(code(state)):
                    m.d.comb += self.does(row.action).eq(1)
                    for place, (given, transition) in enumerate(row.transitions.items()):
                        present = self.given[code(given)]
                        with m.If(present) if place == 0 else m.Elif(present):
                            m.d.sync += self.state.eq(code(transition.target))
                            if transition.loads is not None:
                                m.d.sync += registers[transition.loads].eq(self.value)
        return m


class Call(IntEnum):
    """A `Call` is the code of a call of the core to its delegate."""

    TAKE = 0
    CANCEL = 1
    PUBLISH = 2


class Answer(IntEnum):
    """An `Answer` is the code of an answer of the delegate."""

    LOCATED = 0  #: Answer with the address of the output message.
    ANSWERED = 1  #: Answer with the address and publisher ID of a message.
    CANCELLED = 2
    PUBLISHED = 3


class Gateway(Elaboratable):
    """A `Gateway` has one hardware publisher and any number of hardware subscribers."""

    def __init__(self, subscribers: int) -> None:
        self.control = Control()
        self.mover = Mover()  #: Data path; `mover.master.port` is the memory interface.
        self.node = Stream("node")  #: In: stream of the hardware publisher.
        #: Out: streams of the hardware subscribers.
        self.ports = [Stream(f"port{i}") for i in range(subscribers)]
        self.own_smt = Signal(WORD_BITS)  #: In: the core's publisher ID on the SMT.
        self.own_hmt = Signal(WORD_BITS)  #: In: the core's publisher ID on the HMT.
        self.words = Signal(COUNT_BITS)  #: In: number of words of each message, without its ID.
        self.call_valid = Signal()  #: Out: OSIF: `call` is valid.
        self.call_ready = Signal()  #: In: OSIF: the delegate takes the call in this cycle.
        self.call = Signal(2)  #: Out: OSIF: code of the call, a `Call`.
        self.answer_valid = Signal()  #: In: OSIF: `answer` is valid.
        self.answer_ready = Signal()  #: Out: OSIF: the core takes the answer in this cycle.
        self.answer = Signal(2)  #: In: OSIF: code of the answer, an `Answer`.
        self.answer_address = Signal(WORD_BITS)  #: In: OSIF: address of a message.
        self.answer_publisher = Signal(WORD_BITS)  #: In: OSIF: publisher ID of a message.
        self._held_publisher = Signal(WORD_BITS)

    @property
    def wires(self) -> list[Any]:
        """Return the ports of the exported Verilog module."""
        held = self._held_publisher
        own = [
            wire for wire in vars(self).values() if isinstance(wire, Signal) and wire is not held
        ]
        streams = [wire for stream in (self.node, *self.ports) for wire in stream.wires]
        return [*own, *streams, *vars(self.mover.master.port).values()]

    def elaborate(self, _platform: object) -> Any:
        """Return the logic of the gateway as a module of Amaranth."""
        m = Module()
        topic = Stream("topic")
        arbiter = TopicArbiter(self.mover.sent, self.node, topic)
        m.submodules.control = self.control
        m.submodules.mover = self.mover
        m.submodules.arbiter = arbiter
        m.submodules.broadcast = Broadcast(topic, [self.mover.port, *self.ports])
        self._connect_inputs(m, arbiter.grant)
        self._connect_calls(m)
        self._connect_mover(m)
        m.d.comb += arbiter.claim.eq(self.control.does(Action.CLAIM_HMT))
        return m

    def _connect_inputs(self, m: Any, grant: Any) -> None:
        """Set the control's inputs from the wires that the control's action observes."""
        does = self.control.does
        port = self.mover.port
        listens = does(Action.LISTEN_OSIF)
        peeks = does(Action.PEEK_HMT)
        compares = does(Action.COMPARE_HELD) | does(Action.COMPARE_PORT)
        held_is_own = self._held_publisher == self.own_smt
        is_own = Mux(does(Action.COMPARE_HELD), held_is_own, port.data == self.own_hmt)
        present = {
            Input.SENT: self.call_valid & self.call_ready,
            Input.EMPTY: (listens & ~self.answer_valid) | (peeks & ~port.valid),
            Input.OFFERED: (peeks | does(Action.CLAIM_HMT)) & port.valid,
            Input.GRANTED: grant,
            Input.OWN: compares & is_own,
            Input.FOREIGN: compares & ~is_own,
            Input.DONE: self.mover.done,
        }
        for answer in Answer:
            present[Input[answer.name]] = (
                self.answer_ready & self.answer_valid & (self.answer == answer)
            )
        for given, bit in present.items():
            m.d.comb += self.control.given[code(given)].eq(bit)
        m.d.comb += self.answer_ready.eq(listens)
        m.d.comb += self.control.value.eq(self.answer_address)
        with m.If(present[Input.ANSWERED]):
            m.d.sync += self._held_publisher.eq(self.answer_publisher)

    def _connect_calls(self, m: Any) -> None:
        """Connect the control's action to the wires that call the delegate."""
        for call in Call:
            with m.If(self.control.does(Action[f"CALL_{call.name}"])):
                m.d.comb += [self.call_valid.eq(1), self.call.eq(call)]

    def _connect_mover(self, m: Any) -> None:
        """Connect the control's action to the commands of the data path."""
        control = self.control
        mover = self.mover
        m.d.comb += [
            mover.send.eq(control.does(Action.MEMORY_TO_HMT)),
            mover.store.eq(control.does(Action.HMT_TO_MEMORY)),
            mover.drop.eq(control.does(Action.HMT_TO_NOWHERE)),
            mover.source.eq(control.held),
            mover.target.eq(control.output),
            mover.words.eq(self.words),
            mover.own_id.eq(self.own_hmt),
        ]

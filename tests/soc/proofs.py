"""Proofs of the core's control and of the arbiter, by k-induction over the hardware with Yosys.

A watcher beside the control counts what the delegate owes, another beside the arbiter remembers who was served
while one waits. Assumed of the surroundings: the delegate answers only what it was asked; a master waits until
it is served. Liveness of the control is the exploration's (`sfglab.soc.exploration`).
"""

from amaranth import Cat, Elaboratable, Module, Signal
from amaranth.hdl import Assert, Assume

from sfglab.soc.gateway import TABLE, Drive, Input, State
from sfglab.soc.rtl.core import Control, code
from sfglab.soc.rtl.data_path import MemoryPort
from sfglab.soc.rtl.readers import Arbiter
from sfglab.soc.rtl.synthesis import is_proved

_BEFORE = (State.POLL_OSIF, State.POLL_HMT, State.FILTER_HMT, State.DROP_HMT, State.TO_MEMORY)
_REQUESTED = (*_BEFORE, State.CANCEL, State.CANCEL_WAIT)
_PUBLISHING = (State.PUBLISH_WAIT, State.PUBLISH_WAIT_HOLDING)
_STORED = (State.CANCEL, State.CANCEL_WAIT, State.PUBLISH, State.PUBLISH_HOLDING, *_PUBLISHING)
_HELD = (
    State.FILTER_SMT,
    State.CLAIM,
    State.TO_HMT,
    *(s for s in State if s.name.endswith("_HOLDING")),
)


class _Watched(Elaboratable):
    """The control with a watcher, and what is assumed and asserted of them."""

    def __init__(self, table):
        self.control = Control(table)
        self._requested, self._stored, self._held = Signal(), Signal(), Signal()
        self._cancelling, self._publishing = Signal(), Signal()

    def elaborate(self, _platform):
        """Return the logic."""
        m = Module()
        m.submodules.control = control = self.control
        does = control.does
        listens = does(Drive.LISTEN_OSIF)
        there = {item: control.given[code(item)] for item in Input}
        answered = listens & there[Input.ANSWERED]
        cancelled = listens & there[Input.CANCELLED]
        sent, done = there[Input.SENT], there[Input.DONE]
        self._watch(m, self._requested, does(Drive.CALL_TAKE) & sent, answered | cancelled)
        published = listens & there[Input.PUBLISHED]
        self._watch(m, self._cancelling, does(Drive.CALL_CANCEL) & sent, answered | cancelled)
        self._watch(m, self._publishing, does(Drive.CALL_PUBLISH) & sent, published)
        self._watch(m, self._stored, does(Drive.HMT_TO_MEMORY) & done, published)
        dropped = does(Drive.COMPARE_HELD) & there[Input.OWN]
        self._watch(m, self._held, answered, (does(Drive.MEMORY_TO_HMT) & done) | dropped)
        m.d.comb += Assume((control.given & (control.given - 1)) == 0)
        for answer, asked in (
            (answered, self._requested),
            (cancelled, self._cancelling),
            (published, self._publishing),
        ):
            m.d.comb += Assume(~answer | asked)
        self._claims(m)
        return m

    @staticmethod
    def _watch(m, flag, rises, falls):
        with m.If(rises):
            m.d.sync += flag.eq(1)
        with m.Elif(falls):
            m.d.sync += flag.eq(0)

    def _claims(self, m):
        """Assert the properties, and for induction what each state says of the watcher."""
        control, does = self.control, self.control.does
        requested, stored, held = self._requested, self._stored, self._held
        m.d.comb += Assert(control.state < len(State))
        for drive, holds in (
            (Drive.CALL_TAKE, ~requested),
            (Drive.CALL_PUBLISH, ~requested & stored),
            (Drive.HMT_TO_MEMORY, ~stored),
            (Drive.MEMORY_TO_HMT, held),
        ):
            with m.If(does(drive)):
                m.d.comb += Assert(holds)
        for flag, states in (
            (requested, _REQUESTED),
            (stored, _STORED),
            (held, _HELD),
            (self._cancelling, (State.CANCEL_WAIT,)),
            (self._publishing, _PUBLISHING),
        ):
            inside = Signal()
            with m.Switch(control.state), m.Case(*(code(state) for state in states)):
                m.d.comb += inside.eq(1)
            m.d.comb += Assert(flag == inside)


def control_is_safe(table=TABLE, depth=4):
    """Prove for every sequence of inputs, however long, what the core's control must never break.

    The state register holds a state. The core asks for a message, and publishes, only if no request is
    outstanding; it publishes only a message that it has stored, stores one only if the last is published, and
    sends only a message that it holds.
    """
    watched = _Watched(table)
    return is_proved(
        watched, [watched.control.given, watched.control.value, watched.control.state], depth
    )


class _WatchedArbiter(Elaboratable):
    """The arbiter with a watcher, and what is assumed and asserted of them."""

    def __init__(self, arbiter):
        self.arbiter = arbiter
        count = len(arbiter.masters)
        self._waited, self._under = Signal(count), Signal(count)
        self._passed = [Signal(count, name=f"passed{place}") for place in range(count)]

    def elaborate(self, _platform):
        """Return the logic."""
        m = Module()
        m.submodules.arbiter = arbiter = self.arbiter
        request, grant, complete = (
            Cat(getattr(port, name) for port in arbiter.masters)
            for name in ("request", "grant", "complete")
        )
        m.d.comb += Assume((self._waited & ~request) == 0)
        m.d.sync += [
            self._waited.eq(request & ~grant),
            self._under.eq((self._under & ~complete) | grant),
        ]
        for place, passed in enumerate(self._passed):
            m.d.sync += passed.eq(
                (passed | grant) & (request & ~grant)[place].replicate(len(grant))
            )
            m.d.comb += Assert((passed & grant) == 0)
        free = ~self._under.any() & arbiter.memory.grant
        m.d.comb += [
            Assert((grant & ~request) == 0),
            Assert((grant & (grant - 1)) == 0),
            Assert(grant.any() == (free & request.any())),
        ]
        self._claims(m)
        return m

    def _claims(self, m):
        """Assert for induction what the turn says: those served stand between who waits and the turn."""
        count, arbiter = len(self._passed), self.arbiter
        m.d.comb += Assert(self._under == arbiter.turn & arbiter.busy.replicate(count))
        with m.Switch(arbiter.turn):
            for turn in range(count):
                with m.Case(1 << turn):
                    for place, passed in enumerate(self._passed):
                        reach = (turn - place) % count
                        beyond = [
                            j for j in range(count) if (j - place) % count > reach or j == place
                        ]
                        m.d.comb += Assert(~Cat(passed[j] for j in beyond).any())
                        m.d.comb += Assert(self._waited[place] | ~passed.any())
            with m.Default():
                m.d.comb += Assert(0)


def arbiter_is_fair(masters, depth=4):
    """Prove for every sequence of requests, however long, what the arbiter must never break.

    Only a master that waits is granted, one at a time, and nothing while a request is under way. Whenever the
    interface is free and a master waits, one is granted; while a master waits, no other is granted twice.
    """
    arbiter = Arbiter([MemoryPort() for _ in range(masters)])
    return is_proved(_WatchedArbiter(arbiter), arbiter.wires, depth)

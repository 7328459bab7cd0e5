# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""The hardware-mapped topic: who may send, and a stream that goes to every port.

One message at a time holds the topic. A beat is through when every port has taken it, so the stream is as slow
as its slowest port, and after a message's last beat nothing of it stands anywhere. Knows beats; refuses to know
what they mean.
"""

from __future__ import annotations

from typing import Any

from amaranth import Cat, Elaboratable, Module, Mux, Signal

from sfglab.soc.rtl.control import ADDRESS_BITS


class Stream:
    """The wires of a stream; (f) who sends drives, (t) who receives.

    Args:
        name: Prefix of the wires' names.

    Attributes:
        valid: (f) A beat stands here, and stays until it is taken.
        ready: (t) The beat is taken in this cycle if it is there.
        data: (f) The word.
        last: (f) It is a message's last.
    """

    def __init__(self, name: str) -> None:
        self.valid = Signal(name=f"{name}_valid")
        self.ready = Signal(name=f"{name}_ready")
        self.data = Signal(ADDRESS_BITS, name=f"{name}_data")
        self.last = Signal(name=f"{name}_last")

    @property
    def passes(self) -> Any:
        """A beat changes hands in this cycle."""
        return self.valid & self.ready

    @property
    def wires(self) -> list[Any]:
        """All four."""
        return [self.valid, self.ready, self.data, self.last]


class Broadcast(Elaboratable):
    """Sends each beat to every port; a port that took it does not see it again.

    Args:
        source: Where beats come from.
        ports: Where they go.
    """

    def __init__(self, source: Stream, ports: list[Stream]) -> None:
        self.source = source
        self.ports = ports

    def elaborate(self, _platform: object) -> Any:
        """Return the logic: no register stage, so that done means done everywhere."""
        m, source = Module(), self.source
        taken = Signal(len(self.ports))
        now = Cat(taken[i] | port.ready for i, port in enumerate(self.ports))
        for i, port in enumerate(self.ports):
            m.d.comb += [
                port.valid.eq(source.valid & ~taken[i]),
                port.data.eq(source.data),
                port.last.eq(source.last),
            ]
        m.d.comb += source.ready.eq(now.all())
        with m.If(source.valid):
            m.d.sync += taken.eq(Mux(now.all(), 0, now))
        return m


class Turns(Elaboratable):
    """Decides whose message holds the topic: the core's or a hardware node's.

    The node's goes first, but a core that had to wait is owed the next turn: else a busy node could keep it
    waiting for ever. That cannot lock up, because a core that holds a message always comes back to its claim.

    Args:
        core: The core's beats.
        node: The node's beats.
        topic: The topic's source.

    Attributes:
        claim: In: the core wants the topic.
        grant: Out: the topic is the core's from the next cycle to its message's last beat.
    """

    def __init__(self, core: Stream, node: Stream, topic: Stream) -> None:
        self.core, self.node, self.topic = core, node, topic
        self.claim = Signal()
        self.grant = Signal()

    def elaborate(self, _platform: object) -> Any:
        """Return the logic."""
        m, topic = Module(), self.topic
        owed = Signal()
        with m.FSM():
            with m.State("FREE"):
                with m.If(self.node.valid & ~owed):
                    m.next = "NODE"
                with m.Elif(self.claim):
                    m.d.comb += self.grant.eq(1)
                    m.d.sync += owed.eq(0)
                    m.next = "CORE"
            for name, sender in (("NODE", self.node), ("CORE", self.core)):
                with m.State(name):
                    m.d.comb += [
                        topic.valid.eq(sender.valid),
                        topic.data.eq(sender.data),
                        topic.last.eq(sender.last),
                        sender.ready.eq(topic.ready),
                    ]
                    with m.If(topic.passes & topic.last):
                        m.next = "FREE"
        with m.If(self.claim & ~self.grant):
            m.d.sync += owed.eq(1)
        return m

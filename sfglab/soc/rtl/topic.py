# mypy: allow-subclassing-any, disable-error-code="import-not-found,import-untyped"
"""The module `topic` has the hardware-mapped topic (HMT): streams, a broadcast to all subscribers, and an arbiter.

A stream carries the publisher's ID of a message, then the message's words. One message at a time occupies the HMT. A
word has passed when all ports have taken the word. After the last word the topic no longer has words of the message.
"""

from __future__ import annotations

from typing import Any

from amaranth import Cat, Elaboratable, Module, Mux, Signal

from sfglab.soc.rtl.memory_port import WORD_BITS


class Stream:
    """A `Stream` has the wires of a stream; the sender drives the wires marked (s), the receiver those marked (r)."""

    def __init__(self, name: str) -> None:
        #: (s) A word is on `data`; the word stays there until the receiver takes the word.
        self.valid = Signal(name=f"{name}_valid")
        self.ready = Signal(name=f"{name}_ready")  #: (r) The receiver takes a word in this cycle.
        self.data = Signal(WORD_BITS, name=f"{name}_data")  #: (s) Word of the stream.
        #: (s) Whether the word is the last word of a message.
        self.last = Signal(name=f"{name}_last")

    @property
    def passes(self) -> Any:
        """Return whether a word passes from sender to receiver in this cycle."""
        return self.valid & self.ready

    @property
    def wires(self) -> list[Any]:
        """Return all four signals of the stream."""
        return list(vars(self).values())


class Broadcast(Elaboratable):
    """A `Broadcast` sends each word of a source to all ports, and to each port only once."""

    def __init__(self, source: Stream, ports: list[Stream]) -> None:
        self.source = source
        self.ports = ports

    def elaborate(self, _platform: object) -> Any:
        """Return the logic of the broadcast. A broadcast stores no word, so a passed word has reached all ports."""
        m = Module()
        source = self.source
        taken = Signal(len(self.ports))
        taken_now = Cat(taken[i] | port.ready for i, port in enumerate(self.ports))
        for i, port in enumerate(self.ports):
            m.d.comb += [
                port.valid.eq(source.valid & ~taken[i]),
                port.data.eq(source.data),
                port.last.eq(source.last),
            ]
        m.d.comb += source.ready.eq(taken_now.all())
        with m.If(source.valid):
            m.d.sync += taken.eq(Mux(taken_now.all(), 0, taken_now))
        return m


class TopicArbiter(Elaboratable):
    """A `TopicArbiter` reserves the topic for one message of the hardware publisher or of the core.

    The hardware publisher has priority. A core whose claim the arbiter refused is next, so that a busy publisher
    cannot starve the core. The topic may then wait for the core while the core serves the message at its port. The
    wait cannot deadlock, because a core that holds a message always claims the topic again.
    """

    def __init__(self, core: Stream, node: Stream, topic: Stream) -> None:
        self.core = core
        self.node = node
        self.topic = topic
        self.claim = Signal()  #: In: the core claims the topic.
        #: Out: the core has the topic from the next cycle until the last word of the core's message.
        self.grant = Signal()

    def elaborate(self, _platform: object) -> Any:
        """Return the logic of the topic arbiter as a module of Amaranth."""
        m = Module()
        topic = self.topic
        core_is_next = Signal()
        with m.FSM():
            with m.State("FREE"):
                with m.If(self.node.valid & ~core_is_next):
                    m.next = "NODE"
                with m.Elif(self.claim):
                    m.d.comb += self.grant.eq(1)
                    m.d.sync += core_is_next.eq(0)
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
            m.d.sync += core_is_next.eq(1)
        return m

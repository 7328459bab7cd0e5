"""The whole gateway in hardware, among random surroundings: it follows the table and loses nothing."""

from __future__ import annotations

import random

import pytest
from walked_core import Core

from sfglab.soc.gateway import Input, State

rtl = pytest.importorskip("sfglab.soc.rtl", reason="needs the extra `rtl` (amaranth)")

OWN_SMT, OWN_HMT, WRITER, NODE = 0x51, 0x41, 0x77, 0x33
SLOT_WORDS = 64
SLOTS = 16


class Surroundings:
    """A delegate, a publishing node and subscribers that do everything at random moments."""

    def __init__(self, ctx, gateway, memory, seed, words, messages):
        self.ctx, self.gateway, self.memory, self.words = ctx, gateway, memory.content.data, words
        self.dice = random.Random(seed)
        self.to_send = {"software": messages, "hardware": messages}
        self.reader, self.answers = [], [(rtl.core.Answer.LOCATED, 0, 0)]
        self.outstanding = False
        self.shown = False
        self.beats, self.offered = [], False
        self.sent_software, self.sent_hardware, self.echoes = [], [], 0
        self.published, self.requests, self.given_answers = [], 0, 0
        self.received = [[] for _ in gateway.ports]

    def put(self):
        """Set the wires of this cycle."""
        ctx, gateway, dice = self.ctx, self.gateway, self.dice
        self.arrive()
        self.shown = self.shown or (bool(self.answers) and dice.random() < 0.3)
        ctx.set(gateway.answer_valid, self.shown)
        if self.shown:
            kind, address, publisher = self.answers[0]
            ctx.set(gateway.answer, kind)
            ctx.set(gateway.answer_address, address)
            ctx.set(gateway.answer_publisher, publisher)
        ctx.set(gateway.call_ready, dice.random() < 0.5)
        if not self.beats and self.to_send["hardware"] and dice.random() < 0.02:
            self.publish_in_hardware()
        self.offered = bool(self.beats) and (self.offered or dice.random() < 0.7)
        ctx.set(gateway.node.valid, self.offered)
        if self.offered:
            ctx.set(gateway.node.data, self.beats[0])
            ctx.set(gateway.node.last, len(self.beats) == 1)
        for port in gateway.ports:
            ctx.set(port.ready, dice.random() < 0.7)

    def arrive(self):
        """Let the software send, and the delegate answer a request with what came."""
        if self.to_send["software"] and len(self.reader) < 4 and self.dice.random() < 0.02:
            self.to_send["software"] -= 1
            place = SLOT_WORDS * (1 + len(self.sent_software) % (SLOTS - 2))
            message = [self.dice.getrandbits(64) for _ in range(self.words)]
            for i, word in enumerate(message):
                self.ctx.set(self.memory[place + i], word)
            self.sent_software.append(message)
            self.reader.append((8 * place, WRITER))
        if self.outstanding and self.reader and self.dice.random() < 0.2:
            self.outstanding = False
            self.answers.append((rtl.core.Answer.ANSWERED, *self.reader.pop(0)))

    def publish_in_hardware(self):
        self.to_send["hardware"] -= 1
        publisher = OWN_HMT if self.dice.random() < 0.2 else NODE
        self.beats = [publisher, *(self.dice.getrandbits(64) for _ in range(self.words))]
        self.sent_hardware.append(list(self.beats))

    def take(self):
        """See what changes hands at the end of this cycle."""
        ctx, gateway = self.ctx, self.gateway
        if ctx.get(gateway.answer_valid) and ctx.get(gateway.answer_ready):
            kind = self.answers.pop(0)[0]
            self.given_answers += kind in {rtl.core.Answer.ANSWERED, rtl.core.Answer.CANCELLED}
            self.shown = False
        if ctx.get(gateway.call_valid) and ctx.get(gateway.call_ready):
            self.called(rtl.core.Call(ctx.get(gateway.call)))
        if self.offered and ctx.get(gateway.node.ready):
            self.beats.pop(0)
            self.offered = False
        for port, received in zip(gateway.ports, self.received, strict=True):
            if ctx.get(port.valid) and ctx.get(port.ready):
                received.append((ctx.get(port.data), ctx.get(port.last)))

    def called(self, call):
        if call is rtl.core.Call.TAKE:
            assert not self.outstanding, "two requests"
            self.outstanding = True
            self.requests += 1
        elif call is rtl.core.Call.CANCEL:
            if self.outstanding:
                self.answers.append((rtl.core.Answer.CANCELLED, 0, 0))
            self.outstanding = False
        else:
            assert not self.outstanding, "published while a request is outstanding"
            self.published.append([self.ctx.get(self.memory[i]) for i in range(self.words)])
            self.answers.append((rtl.core.Answer.PUBLISHED, 0, 0))
            self.echo()

    def echo(self):
        """Return what the core published to its own reader."""
        self.echoes += 1
        self.reader.append((8 * SLOT_WORDS * (SLOTS - 1), OWN_SMT))

    @property
    def quiet(self):
        pending = self.reader or self.beats or self.answers or any(self.to_send.values())
        return not pending and self.outstanding

    def messages(self, port):
        """What a subscriber got, message by message."""
        found, message = [], []
        for word, last in self.received[port]:
            message.append(word)
            if last:
                found.append(message)
                message = []
        assert not message
        return found


def run(seed, words, subscribers, messages=6, limit=12_000, seen=None):
    from amaranth import Module
    from amaranth.sim import Simulator

    m = Module()
    m.submodules.gateway = gateway = rtl.core.Gateway(subscribers)
    delays = rtl.Delays(read=3, write=2)
    m.submodules.memory = memory = rtl.cycles.SlowMemory(
        gateway.mover.master.port, [0] * SLOT_WORDS * SLOTS, delays
    )
    simulator = Simulator(m)
    simulator.add_clock(1e-8)
    ends, core = [], Core()
    visited = set() if seen is None else seen

    async def surround(ctx):
        around = Surroundings(ctx, gateway, memory, seed, words, messages)
        ctx.set(gateway.own_smt, OWN_SMT)
        ctx.set(gateway.own_hmt, OWN_HMT)
        ctx.set(gateway.words, words)
        quiet = 0
        for _ in range(limit):
            around.put()
            visited.add(core.state)
            follow(ctx, gateway.control, core)
            around.take()
            await ctx.tick()
            assert ctx.get(gateway.control.state) == rtl.core.code(core.state)
            quiet = quiet + 1 if around.quiet else 0
            if quiet > 30:
                ends.append(around)
                return

    simulator.add_testbench(surround)
    simulator.run()
    assert ends, f"not through after {limit} cycles; the core stands in {core.state}"
    return ends[0]


def follow(ctx, control, core):
    """Feed the table's core with what the hardware says is there."""
    bits = ctx.get(control.given)
    given = [item for item in Input if bits >> rtl.core.code(item) & 1]
    assert len(given) <= 1
    assert ctx.get(control.drive) == 1 << rtl.core.code(core.drive)
    assert (ctx.get(control.held), ctx.get(control.output)) == (core.held, core.output)
    if given:
        core.feed(given[0], ctx.get(control.value))


@pytest.mark.parametrize(("seed", "words", "subscribers"), [(1, 3, 2), (2, 1, 4), (3, 33, 2), (4, 40, 1)])
def test_gateway_follows_the_table_and_loses_doubles_and_echoes_nothing(seed, words, subscribers):
    ended = run(seed, words, subscribers)
    foreign = [message[1:] for message in ended.sent_hardware if message[0] != OWN_HMT]
    assert ended.published == foreign
    assert ended.echoes == len(foreign)
    assert ended.requests == ended.given_answers + 1
    forwarded = [[OWN_HMT, *message] for message in ended.sent_software]
    for port in range(subscribers):
        got = ended.messages(port)
        assert [message for message in got if message in forwarded] == forwarded
        assert [message for message in got if message not in forwarded] == ended.sent_hardware


def test_random_surroundings_lead_the_hardware_through_every_state_of_the_table():
    seen = set()
    for seed, words in ((10, 33), (11, 33), (12, 2), (13, 2), (14, 2)):
        run(seed, words, 2, messages=12, seen=seen)
    assert seen == set(State)

"""The whole gateway in hardware, in random surroundings; `test_rtl_yosys` has the proof of its control."""

import random
from functools import partial

import pytest

from sfglab.soc.gateway import transitions

pytest.importorskip("amaranth", reason="needs the extra `rtl` (amaranth)")
from amaranth import Module
from amaranth.sim import Simulator

from sfglab.soc.rtl.bench import Delays, SlowMemory, new_memory
from sfglab.soc.rtl.core import Answer, Call, Gateway, code

OWN_SMT = 0x51
OWN_HMT = 0x41
SLOT_WORDS = 64  # Room in memory for the output message, and for each message of the software.
MESSAGES = 8


class Surroundings:
    """Delegate, software, a hardware publisher and subscribers, which act at random moments."""

    def __init__(self, seed, words, subscribers):
        self.dice = random.Random(seed)
        content = self.random_words(SLOT_WORDS * (1 + MESSAGES))
        self.words = words
        self.memory = new_memory(len(content), content)
        *places, self.output = range(0, len(content), SLOT_WORDS)
        self.from_software = [[OWN_HMT, *content[place : place + words]] for place in places]
        publishers = self.dice.choices([0x33, OWN_HMT], k=MESSAGES)
        self.from_hardware = [[publisher, *self.random_words(words)] for publisher in publishers]
        self.to_publish = [words for own, *words in self.from_hardware if own != OWN_HMT]
        self.gateway = Gateway(subscribers)
        self.smt_queue = [(Answer.ANSWERED, 8 * place, 0x77) for place in places]
        self.answers = [(Answer.LOCATED, 8 * self.output, 0)]
        self.requested = False
        self.published = []
        self.received = [[] for _ in self.gateway.ports]
        self.changes = set()

    def random_words(self, count):
        return [self.dice.getrandbits(64) for _ in range(count)]

    async def publish_in_hardware(self, ctx):
        node = self.gateway.node
        for message in self.from_hardware:
            for place, word in enumerate(message):
                for _ in range(self.dice.randrange(3 if place else 150)):
                    await ctx.tick()
                ctx.set(node.data, word)
                ctx.set(node.last, place == self.words)
                ctx.set(node.valid, 1)
                await ctx.tick().until(node.ready)
                ctx.set(node.valid, 0)

    async def subscribe(self, port, messages, ctx):
        message = []
        while True:
            ctx.set(port.ready, self.dice.random() < 0.7)
            *_, passes, word, last = await ctx.tick().sample(port.passes, port.data, port.last)
            if passes:
                message.append(word)
            if passes and last:
                messages.append(message)
                message = []

    async def be_delegate(self, ctx):
        """Take calls, and send answers, which may be delayed."""
        gateway = self.gateway
        called = gateway.call_valid & gateway.call_ready
        answered = gateway.answer_valid & gateway.answer_ready
        signals = gateway.answer, gateway.answer_address, gateway.answer_publisher
        while True:
            ctx.set(gateway.call_ready, self.dice.random() < 0.5)
            if self.answers and self.dice.random() < 0.3:
                for signal, value in zip(signals, self.answers[0], strict=True):
                    ctx.set(signal, value)
                ctx.set(gateway.answer_valid, 1)
            taken = ctx.tick().sample(answered, called, gateway.call)
            *_, is_answered, is_called, call = await taken
            if is_answered:
                del self.answers[0]
                ctx.set(gateway.answer_valid, 0)
            if is_called:
                self.obey(ctx, Call(call))
            if self.requested and self.smt_queue and self.dice.random() < 0.03:
                self.requested = False
                self.answers.append(self.smt_queue.pop(0))

    def obey(self, ctx, call):
        was_requested, self.requested = self.requested, call is Call.TAKE
        if call is Call.CANCEL:
            if was_requested:
                self.answers.append((Answer.CANCELLED, 0, 0))
            return
        assert not was_requested
        if call is Call.PUBLISH:
            places = range(self.output, self.output + self.words)
            self.published.append([ctx.get(self.memory.data[place]) for place in places])
            self.answers.append((Answer.PUBLISHED, 0, 0))
            place = self.dice.randrange(len(self.smt_queue) + 1)
            self.smt_queue.insert(place, (Answer.ANSWERED, 0, OWN_SMT))

    async def watch(self, ctx):
        """Note the states of the control until all messages have arrived."""
        gateway = self.gateway
        ctx.set(gateway.own_smt, OWN_SMT)
        ctx.set(gateway.own_hmt, OWN_HMT)
        ctx.set(gateway.words, self.words)
        while min(map(len, self.received)) < 2 * MESSAGES or self.smt_queue or not self.requested:
            before = ctx.get(gateway.control.state)
            await ctx.tick()
            self.changes.add((before, ctx.get(gateway.control.state)))
        await ctx.tick().repeat(100)

    def run(self):
        m = Module()
        m.submodules.gateway = self.gateway
        port = self.gateway.mover.master.port
        m.submodules.memory = SlowMemory(port, self.memory, Delays(read=3, write=2))
        processes = [self.publish_in_hardware, self.be_delegate]
        ends = zip(self.gateway.ports, self.received, strict=True)
        processes += [partial(self.subscribe, *each) for each in ends]
        simulator = Simulator(m)
        simulator.add_clock(1e-8)
        for process in processes:
            simulator.add_testbench(process, background=True)
        simulator.add_testbench(self.watch)
        simulator.run()


def test_gateway_takes_the_table_s_transitions_and_loses_doubles_and_echoes_nothing():
    changes = {(code(state), code(target)) for (state, _), target in transitions().items()}
    found = set()
    for seed, words, subscribers in ((1, 3, 2), (2, 1, 4), (3, 33, 2), (4, 40, 1), (5, 2, 2)):
        around = Surroundings(seed, words, subscribers)
        around.run()
        assert around.published == around.to_publish
        for messages in around.received:
            assert [m for m in messages if m in around.from_software] == around.from_software
            assert [m for m in messages if m not in around.from_software] == around.from_hardware
        found |= around.changes
    assert {(before, after) for before, after in found if before != after} == changes

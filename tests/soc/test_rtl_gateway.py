"""The gateway in hardware: its control in every state, and the whole gateway in random surroundings."""

import random
from functools import partial

import pytest
from walked_core import Core, simulate

from sfglab.soc.gateway import TABLE, Input, State

pytest.importorskip("amaranth", reason="needs the extra `rtl` (amaranth)")
from amaranth import Module

from sfglab.soc.rtl.bench import Delays, SlowMemory, new_memory
from sfglab.soc.rtl.core import Answer, Call, Control, Gateway, code


def test_control_and_table_agree_on_every_input_in_every_state():
    control, core = Control(), Core()
    seen = set()
    dice = random.Random(1)

    async def bench(ctx):
        while len(seen) < len(State) * len(Input):
            allowed = list(TABLE[core.state].transitions)
            new = [given for given in Input if (core.state, given) not in seen]
            ignored = [given for given in new if given not in allowed]
            given = dice.choice(ignored or allowed)
            value = dice.getrandbits(64)
            seen.add((core.state, given))
            ctx.set(control.given, 1 << code(given))
            ctx.set(control.value, value)
            await ctx.tick()
            core.feed(given, value)
            assert ctx.get(control.state) == code(core.state)
            assert ctx.get(control.action) == 1 << code(TABLE[core.state].action)
            assert (ctx.get(control.output), ctx.get(control.held)) == (core.output, core.held)

    simulate(control, bench)


OWN_SMT = 0x51
OWN_HMT = 0x41
SLOT_WORDS = 64  # Room in memory for the output message, and for each message of the software.
MESSAGES = 12


class Surroundings:
    """Delegate, software, a hardware publisher and subscribers, which act at random moments."""

    def __init__(self, seed, words, subscribers):
        self.dice = random.Random(seed)
        content = self.random_words(SLOT_WORDS * (1 + MESSAGES))
        self.words = words
        self.memory = new_memory(len(content), content)
        places = range(SLOT_WORDS, len(content), SLOT_WORDS)
        self.from_software = [[OWN_HMT, *content[place : place + words]] for place in places]
        publishers = self.dice.choices([0x33, OWN_HMT], k=MESSAGES)
        self.from_hardware = [[publisher, *self.random_words(words)] for publisher in publishers]
        self.to_publish = [words for own, *words in self.from_hardware if own != OWN_HMT]
        self.gateway = Gateway(subscribers)
        self.smt_queue = [(Answer.ANSWERED, 8 * place, 0x77) for place in places]
        self.answers = [(Answer.LOCATED, 0, 0)]
        self.requested = False
        self.published = []
        self.received = [[] for _ in self.gateway.ports]
        self.visited = set()

    def random_words(self, count):
        return [self.dice.getrandbits(64) for _ in range(count)]

    async def pause(self, ctx, longest):
        for _ in range(self.dice.randrange(longest)):
            await ctx.tick()

    async def publish_in_hardware(self, ctx):
        node = self.gateway.node
        for message in self.from_hardware:
            await self.pause(ctx, 150)
            for place, word in enumerate(message, start=1):
                await self.pause(ctx, 3)
                ctx.set(node.data, word)
                ctx.set(node.last, place == len(message))
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
        assert not was_requested, f"{call.name} while a request is outstanding"
        if call is Call.PUBLISH:
            self.published.append([ctx.get(self.memory.data[i]) for i in range(self.words)])
            self.answers.append((Answer.PUBLISHED, 0, 0))
            place = self.dice.randrange(len(self.smt_queue) + 1)
            self.smt_queue.insert(place, (Answer.ANSWERED, 0, OWN_SMT))

    async def watch(self, ctx):
        """Note the states of the control until all messages have arrived."""
        gateway = self.gateway
        ctx.set(gateway.own_smt, OWN_SMT)
        ctx.set(gateway.own_hmt, OWN_HMT)
        ctx.set(gateway.words, self.words)
        cycles_after_end = 0
        while cycles_after_end < 100:
            self.visited.add(ctx.get(gateway.control.state))
            await ctx.tick()
            cycles_after_end += self.is_complete()

    def is_complete(self):
        arrived = all(len(messages) >= 2 * MESSAGES for messages in self.received)
        return arrived and len(self.published) >= len(self.to_publish) and self.requested

    def run(self):
        m = Module()
        m.submodules.gateway = self.gateway
        port = self.gateway.mover.master.port
        m.submodules.memory = SlowMemory(port, self.memory, Delays(read=3, write=2))
        processes = [self.publish_in_hardware, self.be_delegate]
        ends = zip(self.gateway.ports, self.received, strict=True)
        processes += [partial(self.subscribe, *each) for each in ends]
        simulate(m, self.watch, processes)


def test_gateway_visits_every_state_and_loses_doubles_and_echoes_nothing():
    visited = set()
    for seed, words, subscribers in ((1, 3, 2), (2, 1, 4), (3, 33, 2), (4, 40, 1), (5, 2, 2)):
        around = Surroundings(seed, words, subscribers)
        around.run()
        assert around.published == around.to_publish
        for messages in around.received:
            assert [m for m in messages if m in around.from_software] == around.from_software
            assert [m for m in messages if m not in around.from_software] == around.from_hardware
        visited |= around.visited
    assert visited == {code(state) for state in State}

"""The gateway in hardware: its control in every state, and the whole gateway in random surroundings."""

import random

import pytest
from walked_core import Core, simulate

from sfglab.soc.gateway import TABLE, Input, State

pytest.importorskip("amaranth", reason="needs the extra `rtl` (amaranth)")
from amaranth import Module
from amaranth.sim import Simulator

from sfglab.soc.rtl.bench import Delays, SlowMemory, new_memory
from sfglab.soc.rtl.core import Answer, Call, Control, Gateway, code


def test_control_and_table_agree_on_every_input_in_every_state():
    control = Control()
    core = Core()
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


class Surroundings:
    """Delegate, software, a hardware publisher and subscribers, which act at random moments."""

    def __init__(self, seed, words, subscribers, messages=12):
        self.words = words
        self.dice = random.Random(seed)
        content = [self.dice.getrandbits(64) for _ in range(SLOT_WORDS * (1 + messages))]
        self.memory = new_memory(len(content), content)
        self.places = range(SLOT_WORDS, len(content), SLOT_WORDS)
        self.to_forward = [[OWN_HMT, *content[place : place + words]] for place in self.places]
        self.from_hardware = []
        for _ in range(messages):
            publisher = self.dice.choice([0x33, 0x33, OWN_HMT])
            words_of_message = [self.dice.getrandbits(64) for _ in range(words)]
            self.from_hardware.append([publisher, *words_of_message])
        self.to_publish = [words for own, *words in self.from_hardware if own != OWN_HMT]
        self.gateway = Gateway(subscribers)
        self.smt_queue = []
        self.answers = [(Answer.LOCATED, 0, 0)]
        self.requested = False
        self.published = []
        self.received = [[] for _ in self.gateway.ports]
        self.visited = set()

    async def pause(self, ctx, longest):
        for _ in range(self.dice.randrange(longest)):
            await ctx.tick()

    async def publish_in_software(self, ctx):
        for place in self.places:
            await self.pause(ctx, 150)
            self.smt_queue.append((Answer.ANSWERED, 8 * place, 0x77))

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

    def subscriber(self, place):
        port = self.gateway.ports[place]

        async def subscribe(ctx):
            message = []
            while True:
                ctx.set(port.ready, self.dice.random() < 0.7)
                *_, passes, word, last = await ctx.tick().sample(port.passes, port.data, port.last)
                if passes:
                    message.append(word)
                if passes and last:
                    self.received[place].append(message)
                    message = []

        return subscribe

    async def take_calls(self, ctx):
        gateway = self.gateway
        called = gateway.call_valid & gateway.call_ready
        while True:
            ctx.set(gateway.call_ready, self.dice.random() < 0.5)
            *_, is_called, call = await ctx.tick().sample(called, gateway.call)
            if is_called:
                self.obey(ctx, Call(call))
            if self.requested and self.smt_queue and self.dice.random() < 0.2:
                self.requested = False
                self.answers.append(self.smt_queue.pop(0))

    def obey(self, ctx, call):
        if call is Call.CANCEL:
            if self.requested:
                self.answers.append((Answer.CANCELLED, 0, 0))
            self.requested = False
            return
        assert not self.requested, f"{call.name} while a request is outstanding"
        if call is Call.TAKE:
            self.requested = True
            return
        self.published.append([ctx.get(self.memory.data[i]) for i in range(self.words)])
        self.answers.append((Answer.PUBLISHED, 0, 0))
        self.smt_queue.append((Answer.ANSWERED, 0, OWN_SMT))

    async def send_answers(self, ctx):
        gateway = self.gateway
        while True:
            await self.pause(ctx, 6)
            if not self.answers:
                await ctx.tick()
                continue
            answer, address, publisher = self.answers.pop(0)
            ctx.set(gateway.answer, answer)
            ctx.set(gateway.answer_address, address)
            ctx.set(gateway.answer_publisher, publisher)
            ctx.set(gateway.answer_valid, 1)
            await ctx.tick().until(gateway.answer_ready)
            ctx.set(gateway.answer_valid, 0)

    async def follow(self, ctx):
        """Compare the control with the table in every cycle, until all messages have arrived."""
        control = self.gateway.control
        ctx.set(self.gateway.own_smt, OWN_SMT)
        ctx.set(self.gateway.own_hmt, OWN_HMT)
        ctx.set(self.gateway.words, self.words)
        shown = (control.given, control.value, control.action, control.held, control.output)
        core = Core()
        cycles_after_end = 0
        while cycles_after_end < 100:
            *_, given, value, action, held, output = await ctx.tick().sample(*shown)
            self.visited.add(core.state)
            assert action == 1 << code(TABLE[core.state].action)
            assert (held, output) == (core.held, core.output)
            present = [item for item in Input if given >> code(item) & 1]
            assert len(present) <= 1
            if present:
                core.feed(present[0], value)
            assert ctx.get(control.state) == code(core.state)
            cycles_after_end += self.is_complete()

    def is_complete(self):
        sent = len(self.to_forward) + len(self.from_hardware)
        arrived = all(len(messages) >= sent for messages in self.received)
        return arrived and len(self.published) >= len(self.to_publish) and self.requested

    def run(self):
        m = Module()
        m.submodules.gateway = self.gateway
        port = self.gateway.mover.master.port
        m.submodules.memory = SlowMemory(port, self.memory, Delays(read=3, write=2))
        simulator = Simulator(m)
        simulator.add_clock(1e-8)
        subscribers = [self.subscriber(place) for place in range(len(self.received))]
        publishers = [self.publish_in_software, self.publish_in_hardware]
        for process in (self.take_calls, self.send_answers, *publishers, *subscribers):
            simulator.add_testbench(process, background=True)
        simulator.add_testbench(self.follow)
        simulator.run()


def test_gateway_follows_the_table_through_every_state_and_loses_doubles_and_echoes_nothing():
    visited = set()
    for seed, words, subscribers in ((1, 3, 2), (2, 1, 4), (3, 33, 2), (4, 40, 1), (5, 2, 2)):
        around = Surroundings(seed, words, subscribers)
        around.run()
        assert around.published == around.to_publish
        for messages in around.received:
            assert [m for m in messages if m in around.to_forward] == around.to_forward
            assert [m for m in messages if m not in around.to_forward] == around.from_hardware
        visited |= around.visited
    assert visited == set(State)

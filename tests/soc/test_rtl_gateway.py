"""The gateway in hardware: its control in every state, and the whole gateway in random surroundings."""

import random
from collections import deque

import pytest
from walked_core import Core, simulate

from sfglab.soc.gateway import TABLE, Input, State

pytest.importorskip("amaranth", reason="needs the extra `rtl` (amaranth)")
from amaranth import Module
from amaranth.sim import Simulator

from sfglab.soc.rtl.bench import Delays, SlowMemory, new_memory
from sfglab.soc.rtl.core import Answer, Call, Control, Gateway, code


def inputs_to(goal):
    """A shortest sequence of inputs from the start to a state."""
    found = {State.START: []}
    waiting = deque(found)
    while goal not in found:
        state = waiting.popleft()
        for given, transition in TABLE[state].transitions.items():
            if transition.target not in found:
                found[transition.target] = [*found[state], given]
                waiting.append(transition.target)
    return found[goal]


@pytest.mark.parametrize("state", State)
def test_control_and_table_agree_on_every_input_in_a_state(state):
    for given in Input:
        control = Control()
        core = Core()

        async def bench(ctx, control=control, core=core, given=given):
            for value, item in enumerate([*inputs_to(state), given], start=2**64 - 50):
                ctx.set(control.given, 1 << code(item))
                ctx.set(control.value, value)
                await ctx.tick()
                core.feed(item, value)
            assert ctx.get(control.state) == code(core.state)
            assert ctx.get(control.action) == 1 << code(TABLE[core.state].action)
            assert (ctx.get(control.output), ctx.get(control.held)) == (core.output, core.held)

        simulate(control, bench)


OWN_SMT = 0x51
OWN_HMT = 0x41
SLOT_WORDS = 64  # Room in memory for the output message, and for each message of the software.


class Surroundings:
    """Delegate, software, a hardware publisher and subscribers, which act at random moments."""

    def __init__(self, seed, words, subscribers, messages):
        self.words = words
        self.dice = random.Random(seed)
        self.content = [self.dice.getrandbits(64) for _ in range(SLOT_WORDS * (1 + messages))]
        self.addresses = [8 * SLOT_WORDS * number for number in range(1, 1 + messages)]
        self.from_hardware = []
        for _ in range(messages):
            publisher = self.dice.choice([0x33, 0x33, OWN_HMT])
            message = [self.dice.getrandbits(64) for _ in range(words)]
            self.from_hardware.append([publisher, *message])
        self.gateway = Gateway(subscribers)
        self.memory = new_memory(len(self.content), self.content)
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
        for address in self.addresses:
            await self.pause(ctx, 150)
            self.smt_queue.append((Answer.ANSWERED, address, 0x77))

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
        sent = len(self.addresses) + len(self.from_hardware)
        arrived = all(len(messages) >= sent for messages in self.received)
        return arrived and len(self.published) >= len(self.foreign()) and self.requested

    def foreign(self):
        """The hardware messages that the core itself did not publish, without their publisher ID."""
        return [message[1:] for message in self.from_hardware if message[0] != OWN_HMT]

    def forwarded(self):
        """The software messages as the core must forward them."""
        starts = [address // 8 for address in self.addresses]
        return [[OWN_HMT, *self.content[start : start + self.words]] for start in starts]

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
        around = Surroundings(seed, words, subscribers, messages=12)
        around.run()
        assert around.published == around.foreign()
        for messages in around.received:
            forwarded = [message for message in messages if message in around.forwarded()]
            others = [message for message in messages if message not in forwarded]
            assert forwarded == around.forwarded()
            assert others == around.from_hardware
        visited |= around.visited
    assert visited == set(State)

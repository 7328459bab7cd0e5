"""The gateway in hardware: its control in every cycle, and the whole among random surroundings."""

import random

import pytest
from walked_core import Core, simulate

from sfglab.soc.gateway import TABLE, Input, State

rtl = pytest.importorskip("sfglab.soc.rtl", reason="needs the extra `rtl` (amaranth)")

# The control: state, registers and drive of the table in every cycle


def clocked(steps):
    """Give the control (input, value) cycle by cycle and return what it shows after each, beside the core."""
    control, core, seen = rtl.core.Control(), Core(), []

    async def feed(ctx):
        for given, value in steps(core):
            ctx.set(control.given, 0 if given is None else 1 << rtl.core.code(given))
            ctx.set(control.value, value)
            await ctx.tick()
            if given is not None:
                core.feed(given, value)
            shown = [
                ctx.get(wire)
                for wire in (control.state, control.drive, control.output, control.held)
            ]
            wanted = [
                rtl.core.code(core.state),
                1 << rtl.core.code(core.drive),
                core.output,
                core.held,
            ]
            seen.append((shown, wanted))

    simulate(control, feed)
    return seen


def way(start, goal):
    """A shortest sequence of inputs from one state to another."""
    found, front = {start: []}, [start]
    while goal not in found:
        state = front.pop(0)
        for given, move in TABLE[state].moves.items():
            if move.to not in found:
                found[move.to] = [*found[state], given]
                front.append(move.to)
    return found[goal]


def test_control_and_table_agree_on_every_input_in_every_state():
    reached = set()

    def steps(core):
        # START is left for good by its one input, so that input comes last there.
        for given in [*(item for item in Input if item is not Input.LOCATED), Input.LOCATED]:
            reached.add((core.state, given))
            yield given, 5
        for state in set(State) - {State.START}:
            for given in Input:
                for item in way(core.state, state):
                    yield item, 7
                reached.add((core.state, given))
                yield None, 8
                yield given, 2**64 - 9

    seen = clocked(steps)
    assert [shown for shown, _ in seen] == [wanted for _, wanted in seen]
    assert len(reached) == len(State) * len(Input)


# The whole gateway

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

    m = Module()
    m.submodules.gateway = gateway = rtl.core.Gateway(subscribers)
    delays = rtl.Delays(read=3, write=2)
    port, empty = gateway.mover.master.port, [0] * SLOT_WORDS * SLOTS
    m.submodules.memory = memory = rtl.cycles.SlowMemory(port, empty, delays)
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

    simulate(m, surround)
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


@pytest.mark.parametrize(
    ("seed", "words", "subscribers"), [(1, 3, 2), (2, 1, 4), (3, 33, 2), (4, 40, 1)]
)
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

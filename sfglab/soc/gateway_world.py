"""The module `gateway_world` models a gateway core with its surroundings: worlds, and the steps between worlds.

A `World` is one global state of the core and its surroundings. Paper C, Fig. 3, shows the surroundings of the core.
The model moves a message as a whole, not word by word:

- The software-mapped topic (SMT) is reliable. The SMT delivers a published message at once to all software
  subscribers, and to a queue from which the delegate serves the core's requests.
- The delegate takes the core's calls from one short queue, and puts the answers to the calls into another queue (OSIF).
- The hardware-mapped topic (HMT) carries one message at a time. A message occupies the HMT until all hardware
  subscribers, and the core's own port, have taken the message.

Each step is one action of one process; all interleavings of such steps are possible. A step that violates a
property leads to a `Fault` instead of a world. The module `sfglab.soc.exploration` follows the steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from sfglab.soc.gateway import Action, Input, Register, State, Table, Transition

if TYPE_CHECKING:
    from collections.abc import Iterator

#: Publisher ID of the core; the core writes this ID into each message that the core forwards.
GATEWAY_ID = -1
SOFTWARE = 0  #: Index of all software subscribers together; hardware subscribers have 1, 2, ...
#: Number of the core's port among the receivers that have yet to take the HMT's message.
CORE_PORT = -1
#: Number of the core's transfer to the HMT; the HMT is free only after the transfer has ended.
CORE_TRANSFER = -2


@dataclass(frozen=True, slots=True, kw_only=True)
class Bound:
    """A `Bound` has the numbers of messages and processes of an exploration, and properties of the surroundings."""

    software: tuple[int, ...] = (2,)  #: Number of messages of each software publisher.
    hardware: tuple[int, ...] = (2,)  #: Number of messages of each hardware publisher.
    subscribers: int = 1  #: Number of hardware subscribers besides the core.
    calls: int = 1  #: Number of calls to the delegate that may wait.
    echoes: bool = True  #: Whether both topics return the core's own messages to the core.
    #: Whether the delegate accepts calls while the delegate waits for a message, as our core requires.
    listens_while_blocked: bool = True
    #: Whether the delegate answers once per request, as our core requires; else also once per cancel.
    answers_once: bool = True
    #: Number of whole messages that the core's port can store; 0 for a stream without storage.
    port_messages: int = 0

    @property
    def totals(self) -> tuple[int, ...]:
        """Return the number of messages of each publisher, software publishers first."""
        return self.software + self.hardware

    def is_software(self, publisher: int) -> bool:
        """Return whether a publisher, an index of `totals`, runs in software."""
        return publisher < len(self.software)


class Message(NamedTuple):
    """A `Message` is a message between its publisher and a subscriber."""

    publisher: int  #: Original publisher, an index of `Bound.totals`.
    number: int  #: Place of the message among the messages of its publisher, from 0.
    #: Publisher ID that the message carries: the original publisher's ID, or `GATEWAY_ID`.
    publisher_id: int

    def __str__(self) -> str:
        suffix = "'" if self.publisher_id == GATEWAY_ID else ""
        return f"{self.publisher}.{self.number}{suffix}"


class Transmission(NamedTuple):
    """A `Transmission` is the message that occupies the HMT, with the receivers that have yet to take the message."""

    message: Message
    #: Hardware subscribers, `CORE_PORT` and `CORE_TRANSFER`, until each is done with the message.
    pending: frozenset[int]


class Answer(NamedTuple):
    """An `Answer` is an answer of the delegate that the core has not taken."""

    input: Input
    message: Message | None = None  #: Message whose address the answer holds.


class World(NamedTuple):
    """A `World` is the global state of the core and its surroundings at one moment."""

    state: State  #: State of the core.
    held: Message | None  #: Message that the core holds for the HMT.
    output: Message | None  #: Output message in memory, not yet published.
    calls: tuple[Action, ...]  #: Calls that the delegate has not taken.
    answers: tuple[Answer, ...]  #: Answers that the core has not taken.
    blocked: bool  #: Whether the delegate waits for a message of the SMT.
    smt_queue: tuple[Message, ...]  #: Messages of the SMT that the delegate has not taken.
    sent: tuple[int, ...]  #: Number of messages that each publisher has sent.
    hmt: Transmission | None  #: Message that occupies the HMT.
    port_queue: tuple[Message, ...]  #: Messages that the core's port stores.
    #: Number of messages that each subscriber has received from each publisher.
    received: tuple[tuple[int, ...], ...]


class Fault(NamedTuple):
    """A `Fault` is a violated property; a step that violates a property has a `Fault` in place of a world."""

    text: str


class Step(NamedTuple):
    """A `Step` is one action of one process."""

    actor: str  #: Process that does the step.
    what: str  #: Description of the step.
    after: World | Fault  #: World after the step, or the property that the step violates.


class Event(NamedTuple):
    """An `Event` is an input that the core can receive now."""

    input: Input
    #: World after the input; the state of the core is the same as before the input.
    after: World | Fault
    message: Message | None = None  #: Message whose address the input carries.


def first_world(bound: Bound) -> World:
    """Return the first world: the output message is located, and no publisher has sent a message."""
    nothing = (0,) * len(bound.totals)
    return World(
        state=State.START,
        held=None,
        output=None,
        calls=(),
        answers=(Answer(Input.LOCATED),),
        blocked=False,
        smt_queue=(),
        sent=nothing,
        hmt=None,
        port_queue=(),
        received=(nothing,) * (1 + bound.subscribers),
    )


def is_finished(world: World, bound: Bound) -> bool:
    """Return whether all subscribers have received all messages, and no message is in flight."""
    counts = {world.sent, *world.received}
    return counts == {bound.totals} and not in_flight(world)


def in_flight(world: World) -> list[Message]:
    """Return the messages that are between their publisher and a subscriber."""
    found = [*world.smt_queue, *world.port_queue]
    answered = [answer.message for answer in world.answers]
    occupying = world.hmt.message if world.hmt is not None else None
    maybe = [*answered, world.held, world.output, occupying]
    found.extend(message for message in maybe if message is not None)
    return found


def steps(world: World, bound: Bound, table: Table) -> Iterator[Step]:
    """Yield all steps that are possible in a world with a core that follows a table."""
    yield from _publisher_steps(world, bound)
    yield from _port_steps(world, bound)
    yield from _subscriber_steps(world, bound)
    yield from _delegate_steps(world, bound)
    yield from _core_steps(world, bound, table)


def _publisher_steps(world: World, bound: Bound) -> Iterator[Step]:
    """Yield the publications; software can publish at any time, hardware can publish while the HMT is free."""
    for publisher, number in enumerate(world.sent):
        if number == bound.totals[publisher]:
            continue
        message = Message(publisher, number, publisher_id=publisher)
        after = world._replace(sent=_incremented(world.sent, publisher))
        if bound.is_software(publisher):
            after = after._replace(smt_queue=(*world.smt_queue, message))
            delivered = _delivered(after, bound, message, SOFTWARE)
            yield Step(f"software publisher {publisher}", f"publishes {message}", delivered)
        elif world.hmt is None:
            pending = frozenset([CORE_PORT, *_hardware_subscribers(bound)])
            after = after._replace(hmt=Transmission(message, pending))
            yield Step(f"hardware publisher {publisher}", f"offers {message}", after)


def _port_steps(world: World, bound: Bound) -> Iterator[Step]:
    """Yield the step in which the core's port stores a message, if the port can store messages."""
    if world.hmt is None or CORE_PORT not in world.hmt.pending:
        return
    if len(world.port_queue) < bound.port_messages:
        message = world.hmt.message
        after = world._replace(port_queue=(*world.port_queue, message))
        yield Step("gateway's port", f"stores {message}", _taken_from_hmt(after, CORE_PORT))


def _subscriber_steps(world: World, bound: Bound) -> Iterator[Step]:
    """Yield the steps in which a hardware subscriber takes the message on the HMT."""
    if world.hmt is None:
        return
    message, pending = world.hmt
    for subscriber in _hardware_subscribers(bound):
        if subscriber in pending:
            after = _delivered(_taken_from_hmt(world, subscriber), bound, message, subscriber)
            yield Step(f"hardware subscriber {subscriber - 1}", f"takes {message}", after)


def _delegate_steps(world: World, bound: Bound) -> Iterator[Step]:
    """Yield the steps in which the delegate answers the request or takes the next call."""
    if world.blocked and world.smt_queue:
        message, *rest = world.smt_queue
        answers = (*world.answers, Answer(Input.ANSWERED, message))
        after = world._replace(blocked=False, smt_queue=tuple(rest), answers=answers)
        yield Step("delegate", f"answers with {message}", after)
    if world.calls and (bound.listens_while_blocked or not world.blocked):
        call, *later = world.calls
        after = world._replace(calls=tuple(later))
        if call is Action.CALL_TAKE:
            yield _take(after)
        elif call is Action.CALL_CANCEL:
            yield _cancel(after, bound)
        else:
            yield _publish(after, bound)


def _take(world: World) -> Step:
    """Return the delegate's step for a request."""
    if world.blocked:
        fault = Fault("asked for a message while a request is outstanding")
        return Step("delegate", "is asked", fault)
    return Step("delegate", "waits for a message", world._replace(blocked=True))


def _cancel(world: World, bound: Bound) -> Step:
    """Return the delegate's step for a cancel; the delegate does not answer an answered request a second time."""
    if bound.answers_once and not world.blocked:
        return Step("delegate", "ignores the cancel, having answered", world)
    answers = (*world.answers, Answer(Input.CANCELLED))
    return Step("delegate", "confirms the cancel", world._replace(blocked=False, answers=answers))


def _publish(world: World, bound: Bound) -> Step:
    """Return the delegate's step for a publication of the output message."""
    if world.output is None:
        return Step("delegate", "publishes", Fault("publishes an output message that nobody wrote"))
    message = world.output._replace(publisher_id=GATEWAY_ID)
    after = world._replace(
        output=None,
        answers=(*world.answers, Answer(Input.PUBLISHED)),
        smt_queue=(*world.smt_queue, message) if bound.echoes else world.smt_queue,
    )
    delivered = _delivered(after, bound, message, SOFTWARE)
    return Step("delegate", f"publishes {message}", delivered)


def _core_steps(world: World, bound: Bound, table: Table) -> Iterator[Step]:
    """Yield the core's transitions for all inputs that the core can receive now."""
    row = table[world.state]
    for event in _events(world, bound, row.action):
        transition = row.transitions.get(event.input)
        if transition is not None:
            yield _transition_step(world, event, transition)
        elif event.input is not Input.EMPTY:
            name = event.input.name
            fault = Fault(f"{world.state.name} has no transition for {name}")
            yield Step("gateway", f"{world.state.name} --{name}--> ?", fault)
    # A table without `CLAIM` enters `TO_HMT` before the HMT is reserved, and begins to send once the HMT is free.
    if row.action is Action.MEMORY_TO_HMT and world.hmt is None:
        yield Step("gateway", f"begins to send {world.held}", _reserved_for_core(world, bound))


def _transition_step(world: World, event: Event, transition: Transition) -> Step:
    """Return the core's step for an input, with the register that the transition loads."""
    after = event.after
    if transition.loads is Register.HELD and world.held is not None:
        after = Fault(
            f"holds {event.message} in place of {world.held}, which is not forwarded: lost"
        )
    if isinstance(after, World):
        held = event.message if transition.loads is Register.HELD else after.held
        after = after._replace(state=transition.target, held=held)
    what = f"{world.state.name} --{event.input.name}--> {transition.target.name}"
    return Step("gateway", what, after)


def _events(world: World, bound: Bound, action: Action) -> Iterator[Event]:
    """Yield the inputs that the core can receive in a world during an action."""
    at_port = _at_port(world, bound)
    match action:
        case Action.LISTEN_OSIF:
            answer = world.answers[0] if world.answers else Answer(Input.EMPTY)
            after = world._replace(answers=world.answers[1:])
            yield Event(answer.input, after, answer.message)
        case Action.CALL_TAKE | Action.CALL_CANCEL | Action.CALL_PUBLISH:
            if len(world.calls) < bound.calls:
                yield Event(Input.SENT, _called(world, action))
        case Action.COMPARE_HELD:
            yield _compared(world, world.held)
        case Action.COMPARE_PORT:
            yield _compared(world, at_port)
        case Action.PEEK_HMT:
            yield Event(Input.EMPTY if at_port is None else Input.OFFERED, world)
        case _:
            yield from _hmt_events(world, bound, action, at_port)


def _hmt_events(
    world: World, bound: Bound, action: Action, at_port: Message | None
) -> Iterator[Event]:
    """Yield the inputs that the core can receive while the core claims the HMT, sends to it or takes from it."""
    match action:
        case Action.CLAIM_HMT:
            if at_port is not None:
                yield Event(Input.OFFERED, world)
            if world.hmt is None:
                yield Event(Input.GRANTED, _reserved_for_core(world, bound))
        case Action.MEMORY_TO_HMT:
            if world.hmt is not None and world.hmt.pending - {CORE_PORT} == {CORE_TRANSFER}:
                yield Event(Input.DONE, _taken_from_hmt(world._replace(held=None), CORE_TRANSFER))
        case Action.HMT_TO_MEMORY if at_port is not None:
            yield Event(Input.DONE, _stored(world, at_port))
        case Action.HMT_TO_NOWHERE if at_port is not None:
            yield Event(Input.DONE, _taken_from_port(world))


def _at_port(world: World, bound: Bound) -> Message | None:
    """Return the message whose first word is at the core's port."""
    if bound.port_messages:
        return world.port_queue[0] if world.port_queue else None
    if world.hmt is not None and CORE_PORT in world.hmt.pending:
        return world.hmt.message
    return None


def _called(world: World, call: Action) -> World | Fault:
    """Return the world after a call; a request frees the memory of the held message."""
    after = world._replace(calls=(*world.calls, call))
    if call is not Action.CALL_TAKE or world.held is None:
        return after
    if world.held.publisher_id != GATEWAY_ID:
        return Fault(f"asks for the next message before {world.held} is forwarded: lost")
    return after._replace(held=None)


def _compared(world: World, message: Message | None) -> Event:
    """Return the result of a filter, which compares a message's publisher ID with the core's own."""
    if message is None:
        return Event(Input.FOREIGN, Fault("filters a message that it has not got"))
    is_own = message.publisher_id == GATEWAY_ID
    return Event(Input.OWN if is_own else Input.FOREIGN, world)


def _reserved_for_core(world: World, bound: Bound) -> World | Fault:
    """Return the world in which the held message occupies the HMT, with the core's ID.

    An echo of the core's own message stays at the core's port until the core's filter drops the echo.
    """
    if world.held is None:
        return Fault("sends without a message")
    pending = {CORE_TRANSFER, *_hardware_subscribers(bound)}
    if bound.echoes:
        pending.add(CORE_PORT)
    message = world.held._replace(publisher_id=GATEWAY_ID)
    return world._replace(hmt=Transmission(message, frozenset(pending)))


def _stored(world: World, message: Message) -> World | Fault:
    """Return the world after the core has copied a message at its port to the output message."""
    if world.output is not None:
        return Fault(f"overwrites {world.output} before it is published")
    return _taken_from_port(world)._replace(output=message)


def _taken_from_port(world: World) -> World:
    """Return the world after the core has taken the message at its port."""
    if world.port_queue:
        return world._replace(port_queue=world.port_queue[1:])
    return _taken_from_hmt(world, CORE_PORT)


def _taken_from_hmt(world: World, receiver: int) -> World:
    """Return the world after one receiver of `Transmission.pending` has taken the HMT's message."""
    if world.hmt is None:
        return world
    pending = world.hmt.pending - {receiver}
    return world._replace(hmt=world.hmt._replace(pending=pending) if pending else None)


def _delivered(world: World, bound: Bound, message: Message, subscriber: int) -> World | Fault:
    """Return the world after a subscriber has received a message, or the violated property."""
    from_software = bound.is_software(message.publisher)
    to_software = subscriber == SOFTWARE
    if message.publisher_id == GATEWAY_ID and from_software == to_software:
        return Fault(f"{message} is echoed to the side that it came from")
    received = list(world.received)
    expected = received[subscriber][message.publisher]
    if message.number < expected:
        return Fault(f"{message} is delivered twice")
    if message.number > expected:
        return Fault(f"{message} is delivered before {expected}: lost or overtaken")
    received[subscriber] = _incremented(received[subscriber], message.publisher)
    return world._replace(received=tuple(received))


def _hardware_subscribers(bound: Bound) -> range:
    """Return the indices of the hardware subscribers in `World.received`."""
    return range(SOFTWARE + 1, SOFTWARE + 1 + bound.subscribers)


def _incremented(counts: tuple[int, ...], index: int) -> tuple[int, ...]:
    return (*counts[:index], counts[index] + 1, *counts[index + 1 :])

"""A moment of a gateway core and what surrounds it, everything that can happen next, and the bound of it all.

Whole messages move, not beats. The software-mapped topic (SMT) is reliable and reaches all software
subscribers at once; the core's reader on it is a queue, served by a delegate thread through two short queues
(OSIF). The hardware-mapped topic (HMT) is a stream: one message at a time, occupied until every subscriber,
the core included, has taken it or stored it. Refuses to know in which order moments are explored.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from sfglab.soc.gateway import Drive, Input, Latch, State, Table

if TYPE_CHECKING:
    from collections.abc import Iterator

GATEWAY = -1  #: The publisher id under which the core forwards.
OWN_PORT = 1  #: The bit of the core's own port among those that have yet to take the HMT's message.
SENDING = 2  #: The bit of the core as the sender, until its transfer is done.
FIRST_PORT = 4  #: The bit of the first hardware subscriber.


@dataclass(frozen=True, slots=True, kw_only=True)
class Bound:
    """How much happens in an exploration, and what the surroundings are like."""

    software: tuple[int, ...] = (2,)  #: How many messages each software publisher sends.
    hardware: tuple[int, ...] = (2,)  #: How many messages each hardware publisher sends.
    subscribers: int = 1  #: Hardware subscribers besides the core.
    calls: int = 1  #: How many calls to the delegate may wait.
    #: Both topics return the core's own messages to it, so that its filters have to work.
    echoes: bool = True
    #: The delegate hears a cancel while it waits for a message, as it must.
    listens_while_blocked: bool = True
    #: The delegate answers once per request, as it must; else also once per cancel.
    answers_once: bool = True
    #: Whole messages that the core's port of the HMT can store; 0: it is a stream.
    port_messages: int = 0

    @property
    def totals(self) -> tuple[int, ...]:
        """Messages of every publisher, software first."""
        return self.software + self.hardware

    def is_software(self, publisher: int) -> bool:
        """Return whether a publisher runs in software."""
        return publisher < len(self.software)


class Message(NamedTuple):
    """A message under way."""

    publisher: int  #: Index in `Bound.totals` of who made it.
    number: int  #: Its place among that publisher's messages.
    carrier: int  #: The publisher id that it carries: its maker's, or `GATEWAY`.

    def __str__(self) -> str:
        suffix = "'" if self.carrier == GATEWAY else ""
        return f"{self.publisher}.{self.number}{suffix}"


class Broadcast(NamedTuple):
    """A message on the HMT and who (bits) has yet to be done with it."""

    message: Message
    pending: int


class World(NamedTuple):
    """One moment."""

    state: State  #: Of the core.
    held: Message | None  #: What the core holds for the HMT.
    output: Message | None  #: What stands in the output message, not yet published.
    calls: tuple[Drive, ...]  #: Calls that the delegate has not read.
    #: What the delegate said and the core has not read.
    answers: tuple[tuple[Input, Message | None], ...]
    blocked: bool  #: The delegate waits for a message of the SMT.
    reader: tuple[Message, ...]  #: What the core's reader on the SMT has received.
    sent: tuple[int, ...]  #: Messages sent by each publisher.
    topic: Broadcast | None  #: What occupies the HMT.
    port: tuple[Message, ...]  #: What the core's port has stored.
    smt_seen: tuple[int, ...]  #: Messages of each publisher that the software subscribers have.
    hmt_seen: tuple[tuple[int, ...], ...]  #: The same for each hardware subscriber.


def first_world(bound: Bound) -> World:
    """Return the moment before anything happens: the delegate has said where the output message lies."""
    none = (0,) * len(bound.totals)
    return World(
        state=State.START,
        held=None,
        output=None,
        calls=(),
        answers=((Input.LOCATED, None),),
        blocked=False,
        reader=(),
        sent=none,
        topic=None,
        port=(),
        smt_seen=none,
        hmt_seen=(none,) * bound.subscribers,
    )


def is_finished(world: World, bound: Bound) -> bool:
    """Return whether everything was sent, everybody has everything, and nothing is under way."""
    done = bound.totals
    return (
        world.sent == done
        and world.smt_seen == done
        and all(seen == done for seen in world.hmt_seen)
        and not in_flight(world)
    )


def in_flight(world: World) -> list[Message]:
    """Return the messages that stand somewhere between their publisher and a subscriber."""
    found = [
        *world.reader,
        *world.port,
        *(message for _, message in world.answers if message is not None),
    ]
    found += [message for message in (world.held, world.output) if message is not None]
    return found if world.topic is None else [*found, world.topic.message]


class Fault(NamedTuple):
    """Something that must not happen, in place of the world it leads to."""

    text: str


class Step(NamedTuple):
    """One thing that can happen."""

    actor: str  #: Who does it.
    what: str  #: In words.
    after: World | Fault  #: The world it leads to, or what is wrong with it.


def steps(world: World, bound: Bound, table: Table) -> Iterator[Step]:
    """Yield everything that can happen next in surroundings and with a core's behaviour."""
    yield from _publishers(world, bound)
    yield from _subscribers(world, bound)
    if world.blocked and world.reader:
        message, *rest = world.reader
        answers = (*world.answers, (Input.ANSWERED, message))
        after = world._replace(blocked=False, reader=tuple(rest), answers=answers)
        yield Step("delegate", f"answers with {message}", after)
    if world.calls and (not world.blocked or bound.listens_while_blocked):
        yield _obeyed(world, bound)
    yield from _core(world, bound, table)


def _publishers(world: World, bound: Bound) -> Iterator[Step]:
    for publisher, number in enumerate(world.sent):
        if number == bound.totals[publisher]:
            continue
        message = Message(publisher, number, publisher)
        sent = _counted(world.sent, publisher)
        if bound.is_software(publisher):
            after = world._replace(
                sent=sent,
                reader=(*world.reader, message),
                smt_seen=_counted(world.smt_seen, publisher),
            )
            yield Step(f"software publisher {publisher}", f"publishes {message}", after)
        elif world.topic is None:
            after = world._replace(sent=sent, topic=Broadcast(message, _ports(bound) | OWN_PORT))
            yield Step(f"hardware publisher {publisher}", f"offers {message}", after)


def _subscribers(world: World, bound: Bound) -> Iterator[Step]:
    if world.topic is None:
        return
    message, pending = world.topic
    if pending & OWN_PORT and len(world.port) < bound.port_messages:
        after = _without(world._replace(port=(*world.port, message)), OWN_PORT)
        yield Step("gateway's port", f"stores {message}", after)
    for index, seen in enumerate(world.hmt_seen):
        port = FIRST_PORT << index
        if not pending & port:
            continue
        actor, what = f"hardware subscriber {index}", f"takes {message}"
        if wrong := _wrong(message, seen, hardware=True, bound=bound):
            yield Step(actor, what, Fault(wrong))
            continue
        taken = (
            *world.hmt_seen[:index],
            _counted(seen, message.publisher),
            *world.hmt_seen[index + 1 :],
        )
        yield Step(actor, what, _without(world._replace(hmt_seen=taken), port))


def _obeyed(world: World, bound: Bound) -> Step:
    """Return what the delegate makes of the first call that waits."""
    call, *rest = world.calls
    later = world._replace(calls=tuple(rest))
    if call is Drive.CALL_TAKE:
        if world.blocked:
            return Step(
                "delegate", "is asked", Fault("asked for a message while a request is outstanding")
            )
        return Step("delegate", "waits for a message", later._replace(blocked=True))
    if call is Drive.CALL_PUBLISH:
        return _published(later, bound)
    if world.blocked or not bound.answers_once:
        answers = (*world.answers, (Input.CANCELLED, None))
        return Step(
            "delegate", "confirms the cancel", later._replace(blocked=False, answers=answers)
        )
    return Step("delegate", "ignores the cancel, having answered", later)


def _published(world: World, bound: Bound) -> Step:
    if world.output is None:
        return Step("delegate", "publishes", Fault("publishes an output message that nobody wrote"))
    message = world.output._replace(carrier=GATEWAY)
    if wrong := _wrong(message, world.smt_seen, hardware=False, bound=bound):
        return Step("delegate", f"publishes {message}", Fault(wrong))
    after = world._replace(
        output=None,
        answers=(*world.answers, (Input.PUBLISHED, None)),
        reader=(*world.reader, message) if bound.echoes else world.reader,
        smt_seen=_counted(world.smt_seen, message.publisher),
    )
    return Step("delegate", f"publishes {message}", after)


def _core(world: World, bound: Bound, table: Table) -> Iterator[Step]:
    """Yield the moves of the core: the input that its drive meets, if there is one."""
    row = table[world.state]
    for given, message, after in _inputs(world, bound, row.drive):
        move = row.moves.get(given)
        what = f"{world.state.name} --{given.name}--> "
        if move is None:
            if given is not Input.EMPTY:
                yield Step(
                    "gateway",
                    what + "?",
                    Fault(f"{given.name} comes unexpected in {world.state.name}"),
                )
            continue
        what += move.to.name
        if move.latch is Latch.HELD and world.held is not None:
            lost = Fault(f"holds {message} in place of {world.held}, which is not forwarded: lost")
            yield Step("gateway", what, lost)
            continue
        if isinstance(after, Fault):
            yield Step("gateway", what, after)
            continue
        held = message if move.latch is Latch.HELD else after.held
        yield Step("gateway", what, after._replace(state=move.to, held=held))
    if row.drive is Drive.MEMORY_TO_HMT and world.topic is None:
        yield Step("gateway", f"begins to send {world.held}", _sending(world, bound))


def _inputs(
    world: World, bound: Bound, drive: Drive
) -> Iterator[tuple[Input, Message | None, World | Fault]]:
    """Yield the inputs that a drive meets, the message beside each, and the world they leave."""
    offered = _at_port(world, bound)
    if drive is Drive.LISTEN_OSIF:
        given, message = world.answers[0] if world.answers else (Input.EMPTY, None)
        yield given, message, world._replace(answers=world.answers[1:])
    elif drive in {Drive.CALL_TAKE, Drive.CALL_CANCEL, Drive.CALL_PUBLISH}:
        if len(world.calls) < bound.calls:
            yield Input.SENT, None, _called(world, drive)
    elif drive is Drive.PEEK_HMT:
        yield Input.OFFERED if offered is not None else Input.EMPTY, None, world
    elif drive is Drive.CLAIM_HMT:
        if offered is not None:
            yield Input.OFFERED, None, world
        if world.topic is None:
            yield Input.GRANTED, None, _sending(world, bound)
    elif drive in {Drive.COMPARE_HELD, Drive.COMPARE_PORT}:
        message = world.held if drive is Drive.COMPARE_HELD else offered
        if message is None:
            yield Input.FOREIGN, None, Fault("filters a message that it has not got")
        else:
            yield Input.OWN if message.carrier == GATEWAY else Input.FOREIGN, None, world
    else:
        yield from _transferred(world, drive, offered)


def _at_port(world: World, bound: Bound) -> Message | None:
    """Return the message whose first word the core sees on the HMT."""
    if world.port:
        return world.port[0]
    streams = not bound.port_messages and world.topic is not None and world.topic.pending & OWN_PORT
    return world.topic.message if world.topic is not None and streams else None


def _called(world: World, call: Drive) -> World | Fault:
    """Return the world after a call: with a request, the delegate may reuse the memory of its last message."""
    after = world._replace(calls=(*world.calls, call))
    if call is not Drive.CALL_TAKE or world.held is None:
        return after
    if world.held.carrier != GATEWAY:
        return Fault(f"asks for the next message before {world.held} is forwarded: lost")
    return after._replace(held=None)


def _transferred(
    world: World, drive: Drive, offered: Message | None
) -> Iterator[tuple[Input, Message | None, World | Fault]]:
    if drive is Drive.MEMORY_TO_HMT:
        if world.topic is not None and world.topic.pending & ~OWN_PORT == SENDING:
            yield Input.DONE, None, _without(world._replace(held=None), SENDING)
    elif offered is not None:
        after = world._replace(port=world.port[1:]) if world.port else _without(world, OWN_PORT)
        if drive is Drive.HMT_TO_NOWHERE:
            yield Input.DONE, None, after
        elif world.output is not None:
            yield Input.DONE, None, Fault(f"overwrites {world.output} before it is published")
        else:
            yield Input.DONE, None, after._replace(output=offered)


def _sending(world: World, bound: Bound) -> World | Fault:
    if world.held is None:
        return Fault("sends a message that it has not got")
    pending = _ports(bound) | SENDING | (OWN_PORT if bound.echoes else 0)
    return world._replace(topic=Broadcast(world.held._replace(carrier=GATEWAY), pending))


def _without(world: World, who: int) -> World:
    """Return the world after somebody is done with the HMT's message."""
    if world.topic is None:
        return world
    pending = world.topic.pending & ~who
    return world._replace(topic=world.topic._replace(pending=pending) if pending else None)


def _wrong(message: Message, seen: tuple[int, ...], *, hardware: bool, bound: Bound) -> str:
    """Return what is wrong with a delivery; nothing: an empty text."""
    if message.carrier == GATEWAY and bound.is_software(message.publisher) is not hardware:
        return f"{message} is echoed to the side that it came from"
    expected = seen[message.publisher]
    if message.number < expected:
        return f"{message} is delivered twice"
    return (
        f"{message} is delivered before {expected}: lost or overtaken"
        if message.number > expected
        else ""
    )


def _ports(bound: Bound) -> int:
    return ((1 << bound.subscribers) - 1) * FIRST_PORT


def _counted(counts: tuple[int, ...], index: int) -> tuple[int, ...]:
    return (*counts[:index], counts[index] + 1, *counts[index + 1 :])

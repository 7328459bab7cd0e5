"""Everything that can happen next around a gateway core, in whatever order the sides run.

Publishers, subscribers, the delegate and the core each have their steps; a step that must not happen leads to a
fault instead of a world. Knows what is lost, doubled, out of order or echoed when it happens; refuses to know
how worlds are searched.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

from sfglab.soc.gateway.core import Drive, Input, Latch, filtered
from sfglab.soc.gateway.world import FIRST_PORT, GATEWAY, OWN_PORT, SENDING, Broadcast, Message, World

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.soc.gateway.core import Table
    from sfglab.soc.gateway.world import Bound


class Fault(NamedTuple):
    """Something that must not happen, in place of the world it leads to."""

    text: str


class Step(NamedTuple):
    """One thing that can happen.

    Attributes:
        actor: Who does it.
        what: In words.
        after: The world it leads to, or what is wrong with it.
    """

    actor: str
    what: str
    after: World | Fault


def steps(world: World, bound: Bound, table: Table) -> Iterator[Step]:
    """Yield everything that can happen next.

    Args:
        world: The moment.
        bound: What the surroundings are like.
        table: The core's behaviour.
    """
    yield from _publishers(world, bound)
    yield from _subscribers(world, bound)
    yield from _delegate(world, bound)
    yield from _core(world, bound, table)


def _publishers(world: World, bound: Bound) -> Iterator[Step]:
    for publisher, number in enumerate(world.sent):
        if number == bound.totals[publisher]:
            continue
        message = Message(publisher, number, publisher)
        sent = _counted(world.sent, publisher)
        if bound.is_software(publisher):
            after = world._replace(
                sent=sent, reader=(*world.reader, message), smt_seen=_counted(world.smt_seen, publisher)
            )
            yield Step(f"software publisher {publisher}", f"publishes {message}", after)
        elif world.topic is None:
            broadcast = Broadcast(message, _ports(bound) | OWN_PORT)
            after = world._replace(sent=sent, topic=broadcast)
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
        taken = (*world.hmt_seen[:index], _counted(seen, message.publisher), *world.hmt_seen[index + 1 :])
        yield Step(actor, what, _without(world._replace(hmt_seen=taken), port))


def _delegate(world: World, bound: Bound) -> Iterator[Step]:
    if world.blocked and world.reader:
        message, *rest = world.reader
        answers = (*world.answers, (Input.ANSWERED, message))
        yield Step(
            "delegate",
            f"answers with {message}",
            world._replace(blocked=False, reader=tuple(rest), answers=answers),
        )
    if world.calls and (not world.blocked or bound.listens_while_blocked):
        yield _obeyed(world, bound)


def _obeyed(world: World, bound: Bound) -> Step:
    """Return what the delegate makes of the first call that waits."""
    call, *rest = world.calls
    later = world._replace(calls=tuple(rest))
    if call is Drive.CALL_TAKE:
        if world.blocked:
            return Step("delegate", "is asked", Fault("asked for a message while a request is outstanding"))
        return Step("delegate", "waits for a message", later._replace(blocked=True))
    if call is Drive.CALL_PUBLISH:
        return _published(later, bound)
    if world.blocked or not bound.answers_once:
        answers = (*world.answers, (Input.CANCELLED, None))
        return Step("delegate", "confirms the cancel", later._replace(blocked=False, answers=answers))
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
                yield Step("gateway", what + "?", Fault(f"{given.name} comes unexpected in {world.state.name}"))
            continue
        what += move.to.name
        if move.latch is Latch.HELD and world.held is not None:
            yield Step(
                "gateway",
                what,
                Fault(f"holds {message} in place of {world.held}, which is not forwarded: lost"),
            )
            continue
        if isinstance(after, Fault):
            yield Step("gateway", what, after)
            continue
        held = message if move.latch is Latch.HELD else after.held
        yield Step("gateway", what, after._replace(state=move.to, held=held))
    if row.drive is Drive.MEMORY_TO_HMT and world.topic is None:
        yield Step("gateway", f"begins to send {world.held}", _sending(world, bound))


def _inputs(world: World, bound: Bound, drive: Drive) -> Iterator[tuple[Input, Message | None, World | Fault]]:
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
            yield filtered(message.carrier, GATEWAY), None, world
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
    return f"{message} is delivered before {expected}: lost or overtaken" if message.number > expected else ""


def _ports(bound: Bound) -> int:
    return ((1 << bound.subscribers) - 1) * FIRST_PORT


def _counted(counts: tuple[int, ...], index: int) -> tuple[int, ...]:
    return (*counts[:index], counts[index] + 1, *counts[index + 1 :])

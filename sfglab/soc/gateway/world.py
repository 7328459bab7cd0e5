"""A moment of a gateway core and what surrounds it, and the bound of an exploration.

Whole messages move, not beats. The software-mapped topic (SMT) is reliable and reaches all software
subscribers at once; the core's reader on it is a queue, served by a delegate thread through two short queues
(OSIF). The hardware-mapped topic (HMT) is a stream: one message at a time, occupied until every subscriber,
the core included, has taken it or stored it. Knows what a moment holds; refuses to know what happens next.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from sfglab.soc.gateway.core import Input, State

if TYPE_CHECKING:
    from sfglab.soc.gateway.core import Drive


GATEWAY = -1
"""The publisher id under which the core forwards."""
OWN_PORT = 1
"""The bit of the core's own port among those that have yet to take the HMT's message."""
SENDING = 2
"""The bit of the core as the sender, until its transfer is done."""
FIRST_PORT = 4
"""The bit of the first hardware subscriber."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Bound:
    """How much happens in an exploration, and what the surroundings are like."""

    software: tuple[int, ...] = (2,)  #: How many messages each software publisher sends.
    hardware: tuple[int, ...] = (2,)  #: How many messages each hardware publisher sends.
    subscribers: int = 1  #: Hardware subscribers besides the core.
    calls: int = 1  #: How many calls to the delegate may wait.
    echoes: bool = True  #: Both topics return the core's own messages to it, so that its filters have to work.
    listens_while_blocked: bool = True  #: The delegate hears a cancel while it waits for a message, as it must.
    #: The delegate gives one answer per request, as it must; else also one per cancel.
    answers_once: bool = True
    port_messages: int = 0  #: Whole messages that the core's port of the HMT can store; 0: it is a stream.

    @property
    def totals(self) -> tuple[int, ...]:
        """Messages of every publisher, software first."""
        return self.software + self.hardware

    def is_software(self, publisher: int) -> bool:
        """Return whether a publisher runs in software."""
        return publisher < len(self.software)


class Message(NamedTuple):
    """A message under way.

    Attributes:
        publisher: Index in `Bound.totals` of who made it.
        number: Its place among that publisher's messages.
        carrier: The publisher id that it carries: its maker's, or `GATEWAY`.
    """

    publisher: int
    number: int
    carrier: int

    def __str__(self) -> str:
        suffix = "'" if self.carrier == GATEWAY else ""
        return f"{self.publisher}.{self.number}{suffix}"


class Broadcast(NamedTuple):
    """A message on the HMT and who (bits) has yet to be done with it."""

    message: Message
    pending: int


class World(NamedTuple):
    """One moment.

    Attributes:
        state: Of the core.
        held: What the core holds for the HMT.
        output: What stands in the output message, not yet published.
        calls: Calls that the delegate has not read.
        answers: What the delegate said and the core has not read.
        blocked: The delegate waits for a message of the SMT.
        reader: What the core's reader on the SMT has received.
        sent: Messages sent by each publisher.
        topic: What occupies the HMT.
        port: What the core's port has stored.
        smt_seen: Messages of each publisher that the software subscribers have.
        hmt_seen: The same for each hardware subscriber.
    """

    state: State
    held: Message | None
    output: Message | None
    calls: tuple[Drive, ...]
    answers: tuple[tuple[Input, Message | None], ...]
    blocked: bool
    reader: tuple[Message, ...]
    sent: tuple[int, ...]
    topic: Broadcast | None
    port: tuple[Message, ...]
    smt_seen: tuple[int, ...]
    hmt_seen: tuple[tuple[int, ...], ...]


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
    found = [*world.reader, *world.port, *(message for _, message in world.answers if message is not None)]
    found += [message for message in (world.held, world.output) if message is not None]
    return found if world.topic is None else [*found, world.topic.message]

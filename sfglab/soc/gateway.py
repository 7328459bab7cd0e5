"""The module `gateway` describes the gateway core of paper C, section 3, as one state-transition table (Fig. 4).

A gateway joins a topic in software to the same topic in hardware, so that a message crosses the memory interface
once instead of once per subscriber. A gateway has three parts (Fig. 3): the software-mapped topic (SMT), the
hardware-mapped topic (HMT), and the gateway core, which copies messages between both topics. The gateway core is a
hardware node. The core calls ROS 2 through its delegate, a software thread, over the interface OSIF.

The core requests the next message of the SMT from its delegate; a *request* is the call `CALL_TAKE`. The core then
polls OSIF and HMT in turn:

- Software to hardware: after the delegate has answered with a message, the core sends the message to the HMT and
  requests the next message.
- Hardware to software: after a message has reached the core's port of the HMT, the core copies the message to its
  output message in main memory. The core then cancels the request, and asks the delegate to publish the output message.
  If the delegate answered the request before the cancel arrived, the core sends the answered message to the HMT
  after the publication.
- Filters on both sides discard messages that the core itself published, so that no message circulates.

The paper leaves three points open. Our table decides each point, and the decisions add the seven states of
`ADDED_STATES`:

- The delegate answers each request exactly once. The delegate answers a cancelled request with `CANCELLED`, or with
  a message if the delegate received a message before the cancel. By the paper the core sends the message of a
  cancelled request to the HMT before the next request. The paper does not say whether the core publishes its output
  message before the message of the cancelled request. Our core publishes its output message first
    (`PUBLISH_HOLDING`, `PUBLISH_WAIT_HOLDING`).
- The core claims the HMT before the core sends a message (`CLAIM`). A message from a hardware node may occupy the
  HMT and wait until the core takes the message. The core then serves the hardware node's message first and keeps
  the message that the core holds (all states `..._HOLDING`). A core without the claim waits for the HMT, and the
  hardware node's message waits for the core, indefinitely.
- The core waits until a publication is complete (`PUBLISH_WAIT`), because the core has only one output message.

The module `sfglab.soc.exploration` checks the table exhaustively. The package `sfglab.soc.rtl` generates the
hardware's control from the table.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum, auto
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Mapping


class State(Enum):
    """A `State` is one of the core's states.

    In the states `..._HOLDING` the core serves or publishes another message while the core holds a message of the
    SMT. The core enters the states `..._HOLDING` from `CLAIM` with a message for the HMT. From `CANCEL_WAIT` the core
    enters `PUBLISH_HOLDING` with an answer of the delegate that no filter has compared. The answer may be the echo of
    the core's own message, so `FILTER_SMT` filters the held message after the publication.
    """

    START = auto()  #: Wait for the address of the output message.
    REQUEST = auto()  #: Request the next message of the SMT.
    POLL_OSIF = auto()  #: Check whether the delegate has answered the request.
    POLL_HMT = auto()  #: Check whether a message is at the core's port of the HMT.
    #: Compare the publisher ID of the held message with the core's own ID. The next request frees the
    #: memory of the core's own message.
    FILTER_SMT = auto()
    CLAIM = auto()  #: Wait until the HMT is reserved for the held message.
    TO_HMT = auto()  #: Copy the held message from memory to the HMT.
    #: Compare the publisher ID of the message at the port with the core's own ID.
    FILTER_HMT = auto()
    DROP_HMT = auto()  #: Discard the message at the port.
    TO_MEMORY = auto()  #: Copy the message at the port to the output message in memory.
    CANCEL = auto()  #: Cancel the request.
    CANCEL_WAIT = auto()  #: Wait for the answer to the request: cancelled, or a message.
    PUBLISH = auto()  #: Ask the delegate to publish the output message on the SMT.
    PUBLISH_WAIT = auto()  #: Wait until the output message is published and may be overwritten.
    #: Compare publisher IDs as in `FILTER_HMT`, while the core holds a message.
    FILTER_HMT_HOLDING = auto()
    #: Discard the message at the port as in `DROP_HMT`, while the core holds a message.
    DROP_HMT_HOLDING = auto()
    #: Copy the message at the port as in `TO_MEMORY`, while the core holds a message.
    TO_MEMORY_HOLDING = auto()
    #: Ask the delegate to publish as in `PUBLISH`, while the core holds a message.
    PUBLISH_HOLDING = auto()
    #: Wait for the publication as in `PUBLISH_WAIT`, while the core holds a message.
    PUBLISH_WAIT_HOLDING = auto()


class Input(Enum):
    """An `Input` is an event that the core waits for; a state without a transition for `EMPTY` ignores `EMPTY`."""

    LOCATED = auto()  #: OSIF: address of the output message.
    SENT = auto()  #: OSIF: the delegate's call queue has accepted the call.
    EMPTY = auto()  #: OSIF or HMT: there is no answer or no message.
    ANSWERED = auto()  #: OSIF: address of the requested message.
    CANCELLED = auto()  #: OSIF: the request is cancelled; there is no message.
    PUBLISHED = auto()  #: OSIF: the publication is complete.
    OFFERED = auto()  #: HMT: the first word of a message is at the core's port.
    #: HMT: the arbiter has reserved the topic until the core has sent its message.
    GRANTED = auto()
    OWN = auto()  #: Filter: the core itself published the message.
    FOREIGN = auto()  #: Filter: another publisher published the message.
    DONE = auto()  #: Data path: the last word of the message is transferred.


class Action(Enum):
    """An `Action` is what the core does in a state; the control has one output signal for each action."""

    LISTEN_OSIF = auto()  #: Take the next answer of the delegate.
    CALL_TAKE = auto()  #: Call the delegate: request the next message of the SMT.
    CALL_CANCEL = auto()  #: Call the delegate: cancel the request.
    CALL_PUBLISH = auto()  #: Call the delegate: publish the output message on the SMT.
    PEEK_HMT = auto()  #: Look at the port of the HMT without taking a word.
    COMPARE_HELD = auto()  #: Compare the publisher ID of the held message with the core's own ID.
    #: Compare the publisher ID of the message at the port with the core's own ID.
    COMPARE_PORT = auto()
    #: Request the HMT from the arbiter of the HMT, and meanwhile look at the core's port.
    CLAIM_HMT = auto()
    #: Send the held message to the HMT. The echo of the held message then is at the port.
    MEMORY_TO_HMT = auto()
    #: Take the message at the port and write the message to the output message.
    HMT_TO_MEMORY = auto()
    HMT_TO_NOWHERE = auto()  #: Take the message at the port and discard the message.


class Register(Enum):
    """A `Register` is an address register of the core; a transition may load its input's address into a register."""

    OUTPUT = auto()  #: Address of the output message.
    HELD = auto()  #: Address of the held message: the delegate's latest answer.


@dataclass(frozen=True, slots=True)
class Transition:
    """A `Transition` is the effect of an input in a state."""

    target: State  #: Next state.
    #: Register that the transition loads; None if the transition loads no register.
    loads: Register | None = None


@dataclass(frozen=True, slots=True)
class Row:
    """A `Row` of the table describes one state."""

    action: Action  #: Action of the core in the state.
    transitions: Mapping[Input, Transition]  #: Transitions by input.


Table = dict[State, Row]  #: Behaviour of a gateway core.


def parse_table(text: str) -> Table:
    """Return the table that a text describes; the text has the form of `TABLE`.

    Args:
        text: Lines `STATE | ACTION | INPUT -> TARGET, ...`. A transition `INPUT -> TARGET / REGISTER` also loads
            a register. Empty lines and lines that begin with `#` are ignored.

    Raises:
        KeyError: A name in the text is unknown.
        ValueError: A line of the text has another form.
    """
    table = {}
    for line in text.splitlines():
        if not line.strip() or line.startswith("#"):
            continue
        state, action, listed = (part.strip() for part in line.split("|"))
        transitions = {}
        for transition in listed.split(","):
            given, effect = transition.split("->")
            target, _, register = effect.partition("/")
            loads = Register[register.strip()] if register else None
            transitions[Input[given.strip()]] = Transition(State[target.strip()], loads)
        table[State[state]] = Row(Action[action], transitions)
    return table


TABLE = parse_table("""
# state              | action         | input -> next state / loaded register, ...
START                | LISTEN_OSIF    | LOCATED -> REQUEST / OUTPUT
REQUEST              | CALL_TAKE      | SENT -> POLL_OSIF
POLL_OSIF            | LISTEN_OSIF    | ANSWERED -> FILTER_SMT / HELD, EMPTY -> POLL_HMT
POLL_HMT             | PEEK_HMT       | OFFERED -> FILTER_HMT, EMPTY -> POLL_OSIF

# Software to hardware.
FILTER_SMT           | COMPARE_HELD   | FOREIGN -> CLAIM, OWN -> REQUEST
CLAIM                | CLAIM_HMT      | GRANTED -> TO_HMT, OFFERED -> FILTER_HMT_HOLDING
TO_HMT               | MEMORY_TO_HMT  | DONE -> REQUEST

# Hardware to software. A request is outstanding and is cancelled before the publication.
FILTER_HMT           | COMPARE_PORT   | FOREIGN -> TO_MEMORY, OWN -> DROP_HMT
DROP_HMT             | HMT_TO_NOWHERE | DONE -> POLL_OSIF
TO_MEMORY            | HMT_TO_MEMORY  | DONE -> CANCEL
CANCEL               | CALL_CANCEL    | SENT -> CANCEL_WAIT
CANCEL_WAIT          | LISTEN_OSIF    | CANCELLED -> PUBLISH, ANSWERED -> PUBLISH_HOLDING / HELD
PUBLISH              | CALL_PUBLISH   | SENT -> PUBLISH_WAIT
PUBLISH_WAIT         | LISTEN_OSIF    | PUBLISHED -> REQUEST

# Hardware to software while a message is held: no request is outstanding, and the held message is sent afterwards.
FILTER_HMT_HOLDING   | COMPARE_PORT   | FOREIGN -> TO_MEMORY_HOLDING, OWN -> DROP_HMT_HOLDING
DROP_HMT_HOLDING     | HMT_TO_NOWHERE | DONE -> CLAIM
TO_MEMORY_HOLDING    | HMT_TO_MEMORY  | DONE -> PUBLISH_HOLDING
PUBLISH_HOLDING      | CALL_PUBLISH   | SENT -> PUBLISH_WAIT_HOLDING
PUBLISH_WAIT_HOLDING | LISTEN_OSIF    | PUBLISHED -> FILTER_SMT
""")
"""`TABLE` is the table of the gateway core (paper C, Fig. 4)."""

ADDED_STATES = {
    State.CLAIM,
    State.PUBLISH_WAIT,
    State.FILTER_HMT_HOLDING,
    State.DROP_HMT_HOLDING,
    State.TO_MEMORY_HOLDING,
    State.PUBLISH_HOLDING,
    State.PUBLISH_WAIT_HOLDING,
}
"""`ADDED_STATES` has the states that the paper's text does not mention."""


def transitions(table: Table = TABLE) -> dict[tuple[State, Input], State]:
    """Return the next state for each state and input, in the table's order, for `sfglab.machine.step`."""
    found = {}
    for state, row in table.items():
        for given, transition in row.transitions.items():
            found[state, given] = transition.target
    return found

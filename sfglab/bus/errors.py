"""Errors of the bus: each says what was given, what is allowed, and what to try.

```text
BusError
├── ClosedError                a node or endpoint was used after its end
├── DomainError                a DDS domain cannot be joined as asked
├── InvalidMessageError        bytes that are no message of the topic's type
├── MessageTooLargeError       a message above a shared-memory publisher's limit
├── PublishError               the middleware refused or could not send a message
├── ReceiveTimeoutError        nothing arrived in time
├── DiscoveryTimeoutError      an expected peer did not appear in time
├── ServiceTimeoutError        a service did not answer in time
├── WrongTypeError             a message of another type than the topic's
├── GoalRejectedError          an action's server does not take a goal
├── ActionServerGoneError      an action's server went away meanwhile
├── UnknownGoalError           an action's server knows no such goal
└── GoalTransitionError        something that a goal's status does not allow
```
"""

from __future__ import annotations

from sfglab.errors import SfglabError


class BusError(SfglabError):
    """The root of the bus's errors."""


class ClosedError(BusError, RuntimeError):
    """A node, subscription or publisher was used before its start or after its end."""

    def __init__(self, what: str) -> None:
        super().__init__(f"{what} is closed; create it again inside `async with Node(...)`")


class DomainError(BusError, ValueError):
    """A DDS domain cannot be joined as asked."""

    def __init__(self, domain_id: int, reason: str) -> None:
        super().__init__(f"DDS domain {domain_id}: {reason}")


class InvalidMessageError(BusError, ValueError):
    """Bytes that are not a serialized message of the topic's type."""

    def __init__(self, topic: str, type_: str, *, size_bytes: int, reason: str) -> None:
        self.size_bytes = size_bytes  #: How many bytes were given.
        super().__init__(
            f"topic {topic!r}: {size_bytes} bytes are not a CDR-encoded {type_} ({reason}); "
            f"serialize with sfglab.messages.serialize and check that both sides use the same type"
        )


class MessageTooLargeError(BusError, ValueError):
    """A message is larger than its shared-memory publisher allows."""

    def __init__(self, topic: str, *, size_bytes: int, limit_bytes: int) -> None:
        self.limit_bytes = limit_bytes  #: The publisher's limit.
        super().__init__(
            f"topic {topic!r}: a message of {size_bytes} bytes exceeds this publisher's limit of "
            f"{limit_bytes} bytes; raise max_message_bytes at create_publisher"
        )


class PublishError(BusError, RuntimeError):
    """The middleware refused a message, or its send buffer stayed full."""

    def __init__(self, topic: str, *, code: int, reason: str) -> None:
        super().__init__(f"topic {topic!r}: publishing failed with code {code} ({reason})")


class ReceiveTimeoutError(BusError, TimeoutError):
    """No message arrived in time."""

    def __init__(self, topic: str, *, timeout_s: float, publishers: int) -> None:
        super().__init__(
            f"topic {topic!r}: no message within {timeout_s} s; {publishers} matching publisher(s) known"
        )


class DiscoveryTimeoutError(BusError, TimeoutError):
    """An expected peer did not appear in time."""

    def __init__(self, what: str, *, timeout_s: float) -> None:
        super().__init__(
            f"{what} within {timeout_s} s did not happen; check that both sides use the same domain id, "
            f"network interface, topic, type and compatible QoS"
        )


class ServiceTimeoutError(BusError, TimeoutError):
    """A service did not answer in time."""

    def __init__(self, service: str, *, timeout_s: float, reason: str) -> None:
        super().__init__(f"service {service!r}: no answer within {timeout_s} s ({reason})")


class WrongTypeError(BusError, TypeError):
    """A message of another type than its topic's was given."""

    def __init__(self, topic: str, type_: str, *, given: str) -> None:
        super().__init__(f"{topic!r}: given a {given}, allowed is a {type_}")


class GoalRejectedError(BusError, RuntimeError):
    """A server does not take a goal."""

    def __init__(self, action: str) -> None:
        super().__init__(f"action {action!r}: the server rejected the goal, for reasons of its own")


class ActionServerGoneError(BusError, ConnectionError):
    """A server went away while something was expected from it."""

    def __init__(self, action: str, goal_id: bytes) -> None:
        super().__init__(f"action {action!r}: the server has gone with goal {goal_id.hex()} unfinished here")


class UnknownGoalError(BusError, LookupError):
    """A server knows no such goal: it never accepted it, or has forgotten it after its result timeout."""

    def __init__(self, action: str, goal_id: bytes) -> None:
        super().__init__(
            f"action {action!r}: goal {goal_id.hex()} is unknown to the server; "
            "it forgets goals once they have been over for its result timeout"
        )


class GoalTransitionError(BusError, RuntimeError):
    """Something that a goal's status does not allow."""

    def __init__(self, goal_id: bytes, *, status: str, event: str, allowed: tuple[str, ...]) -> None:
        choice = f"allowed are {', '.join(allowed)}" if allowed else "nothing is allowed any more"
        super().__init__(f"goal {goal_id.hex()} is {status}: given {event}, {choice}")

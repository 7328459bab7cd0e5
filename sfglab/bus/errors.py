"""Errors of the bus, each with the data that a caller needs to react.

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
└── WrongTypeError             a message of another type than the topic's
```

Actions have more of them, in `sfglab.bus.actions`.
"""

from __future__ import annotations

from sfglab.errors import SfglabError


class BusError(SfglabError):
    """The root of the bus's errors."""


class ClosedError(BusError, RuntimeError):
    """A node, subscription or publisher was used before its start or after its end.

    Attributes:
        what: The closed thing, e.g. "subscription '/chatter'".
    """

    def __init__(self, what: str) -> None:
        self.what = what
        super().__init__(f"{what} is closed; create it again inside `async with Node(...)`")


class DomainError(BusError, ValueError):
    """A DDS domain cannot be joined as asked.

    Attributes:
        domain_id: The DDS domain.
    """

    def __init__(self, domain_id: int, reason: str) -> None:
        self.domain_id = domain_id
        super().__init__(f"DDS domain {domain_id}: {reason}")


class InvalidMessageError(BusError, ValueError):
    """Bytes that are not a serialized message of the topic's type.

    Attributes:
        topic: The ROS topic.
        type: The ROS type, e.g. "std_msgs/msg/String".
        size_bytes: How many bytes were given.
    """

    def __init__(self, topic: str, type_: str, *, size_bytes: int, reason: str) -> None:
        self.topic = topic
        self.type = type_
        self.size_bytes = size_bytes
        super().__init__(
            f"topic {topic!r}: {size_bytes} bytes are not a CDR-encoded {type_} ({reason}); "
            f"serialize with sfglab.messages.serialize and check that both sides use the same type"
        )


class MessageTooLargeError(BusError, ValueError):
    """A message is larger than its shared-memory publisher allows.

    Attributes:
        topic: The ROS topic.
        size_bytes: The message's size.
        limit_bytes: The publisher's limit.
    """

    def __init__(self, topic: str, *, size_bytes: int, limit_bytes: int) -> None:
        self.topic = topic
        self.size_bytes = size_bytes
        self.limit_bytes = limit_bytes
        super().__init__(
            f"topic {topic!r}: a message of {size_bytes} bytes exceeds this publisher's limit of "
            f"{limit_bytes} bytes; raise max_message_bytes at create_publisher"
        )


class PublishError(BusError, RuntimeError):
    """The middleware refused a message, or its send buffer stayed full.

    Attributes:
        topic: The ROS topic.
        code: The middleware's return code.
    """

    def __init__(self, topic: str, *, code: int, reason: str) -> None:
        self.topic = topic
        self.code = code
        super().__init__(f"topic {topic!r}: publishing failed with code {code} ({reason})")


class ReceiveTimeoutError(BusError, TimeoutError):
    """No message arrived in time.

    Attributes:
        topic: The ROS topic.
        timeout_s: How long was waited, in seconds.
    """

    def __init__(self, topic: str, *, timeout_s: float, publishers: int) -> None:
        self.topic = topic
        self.timeout_s = timeout_s
        super().__init__(
            f"topic {topic!r}: no message within {timeout_s} s; {publishers} matching publisher(s) known"
        )


class DiscoveryTimeoutError(BusError, TimeoutError):
    """An expected peer did not appear in time.

    Attributes:
        what: What was waited for.
        timeout_s: How long was waited, in seconds.
    """

    def __init__(self, what: str, *, timeout_s: float) -> None:
        self.what = what
        self.timeout_s = timeout_s
        super().__init__(
            f"{what} within {timeout_s} s did not happen; check that both sides use the same domain id, "
            f"network interface, topic, type and compatible QoS"
        )


class ServiceTimeoutError(BusError, TimeoutError):
    """A service did not answer in time.

    Attributes:
        service: The ROS service name.
        timeout_s: How long was waited, in seconds.
    """

    def __init__(self, service: str, *, timeout_s: float, reason: str) -> None:
        self.service = service
        self.timeout_s = timeout_s
        super().__init__(f"service {service!r}: no answer within {timeout_s} s ({reason})")


class WrongTypeError(BusError, TypeError):
    """A message of another type than its topic's was given.

    Attributes:
        topic: The ROS topic or service.
        type: The type that is allowed.
        given: The type that was given.
    """

    def __init__(self, topic: str, type_: str, *, given: str) -> None:
        self.topic = topic
        self.type = type_
        self.given = given
        super().__init__(f"{topic!r}: given a {given}, allowed is a {type_}")


class GoalRejectedError(BusError, RuntimeError):
    """A server does not take a goal.

    Attributes:
        action: The ROS action.
    """

    def __init__(self, action: str) -> None:
        self.action = action
        super().__init__(f"action {action!r}: the server rejected the goal, for reasons of its own")


class ActionServerGoneError(BusError, ConnectionError):
    """A server went away while something was expected from it.

    Attributes:
        action: The ROS action.
        goal_id: The goal's 16 bytes.
    """

    def __init__(self, action: str, goal_id: bytes) -> None:
        self.action = action
        self.goal_id = goal_id
        super().__init__(f"action {action!r}: the server has gone with goal {goal_id.hex()} unfinished here")


class UnknownGoalError(BusError, LookupError):
    """A server knows no such goal: it never accepted it, or has forgotten it after its result timeout.

    Attributes:
        action: The ROS action.
        goal_id: The goal's 16 bytes.
    """

    def __init__(self, action: str, goal_id: bytes) -> None:
        self.action = action
        self.goal_id = goal_id
        super().__init__(
            f"action {action!r}: goal {goal_id.hex()} is unknown to the server; "
            "it forgets goals once they have been over for its result timeout"
        )


class GoalTransitionError(BusError, RuntimeError):
    """Something that a goal's status does not allow.

    Attributes:
        goal_id: The goal's 16 bytes.
        status: The goal's status.
        event: What was to happen.
    """

    def __init__(self, goal_id: bytes, *, status: str, event: str, allowed: tuple[str, ...]) -> None:
        self.goal_id = goal_id
        self.status = status
        self.event = event
        choice = f"allowed are {', '.join(allowed)}" if allowed else "nothing is allowed any more"
        super().__init__(f"goal {goal_id.hex()} is {status}: given {event}, {choice}")

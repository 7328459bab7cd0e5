"""Errors of the bus: each names the given value, the allowed values and a remedy."""

from __future__ import annotations

from sfglab.errors import SfglabError


class BusError(SfglabError):
    """Base class of the errors of the bus."""


class ClosedError(BusError, RuntimeError):
    """A node, subscription or publisher was used before its start or after its end."""

    def __init__(self, what: str) -> None:
        super().__init__(f"{what} is closed; create it again inside `async with Node(...)`")


class DomainError(BusError, ValueError):
    """A DDS domain cannot be joined with the given settings."""

    def __init__(self, domain_id: int | str, reason: str) -> None:
        super().__init__(f"DDS domain {domain_id}: {reason}")


class InvalidMessageError(BusError, ValueError):
    """A message does not fit its topic: it has another type, does not parse as that type, or is too large."""


class PublishError(BusError, RuntimeError):
    """The middleware refused a message, or its send buffer stayed full."""

    def __init__(self, topic: str, *, code: int, reason: str) -> None:
        super().__init__(f"topic {topic!r}: publishing failed with code {code} ({reason})")


class WriterBlockedError(PublishError):
    """A KEEP_ALL writer waits for slow readers; the message can be sent again."""


class BusTimeoutError(BusError, TimeoutError):
    """No message arrived, no peer appeared, or no service answered in time."""


class GoalRejectedError(BusError, RuntimeError):
    """An action server rejected a goal; raised by `ActionClient.send_goal`."""


def check_size(topic: str, size_bytes: int, limit_bytes: int) -> None:
    """Check a message against its shared-memory publisher's limit.

    Raises:
        InvalidMessageError: The message is larger.
    """
    if size_bytes > limit_bytes:
        raise InvalidMessageError(
            f"topic {topic!r}: a message of {size_bytes} bytes exceeds this publisher's limit of "
            f"{limit_bytes} bytes; raise max_message_bytes at create_publisher"
        )


def not_cdr_error(topic: str, type_: str, *, size_bytes: int, reason: str) -> InvalidMessageError:
    """Return the error for bytes that are not a serialized message of the topic's type."""
    return InvalidMessageError(
        f"topic {topic!r}: {size_bytes} bytes are not a CDR-encoded {type_} ({reason}); "
        "serialize with sfglab.messages.serialize and check that both sides use the same type"
    )


def discovery_timeout_error(what: str, timeout_s: float) -> BusTimeoutError:
    """Return the error for an expected peer that did not appear in time."""
    return BusTimeoutError(
        f"{what} did not appear within {timeout_s} s; check that both sides use the same domain id, "
        "network interface, topic, type and compatible QoS"
    )

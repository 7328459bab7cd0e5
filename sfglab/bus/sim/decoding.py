"""Decodes each message once, however many receivers take the same bytes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.messages import decoder

if TYPE_CHECKING:
    from collections.abc import Callable


_LIMIT_BYTES = 64 * 2**20
_OVERHEAD_BYTES = 1000
"""Of a kept message's Python objects, roughly, so that many small ones are bounded too."""


class SharedDecoder:
    """CDR to messages of one type; equal bytes give the same object while it is remembered.

    Args:
        type_: The ROS type.
    """

    def __init__(self, type_: str) -> None:
        self._decode: Callable[[bytes], Any] = decoder(type_)
        self._known: dict[bytes, Any] = {}
        self._size_bytes = 0

    def __call__(self, cdr: bytes) -> Any:
        """Return the message.

        Raises:
            CdrError: The bytes are no message of the type.
        """
        message = self._known.get(cdr)
        if message is None:
            message = self._decode(cdr)
            self._size_bytes += len(cdr) + _OVERHEAD_BYTES
            if self._size_bytes > _LIMIT_BYTES:
                self._known.clear()
                self._size_bytes = len(cdr) + _OVERHEAD_BYTES
            self._known[cdr] = message
        return message

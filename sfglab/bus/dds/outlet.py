"""A raw writer that samples are handed to as they were taken; see `forwarder`.

Lives in the forwarder's thread. Samples of less than a packet wait for `flush`, so that what was taken together
is sent together.
"""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING

from sfglab.bus.dds.clib import RETCODE_ERROR, RETCODE_TIMEOUT, error_text, library
from sfglab.bus.dds.endpoints import delete_writer, entity_guid
from sfglab.bus.dds.samples import sertype_of

if TYPE_CHECKING:
    from collections.abc import Callable


MAX_BLOCKING_NS = 5_000_000
"""How long a KEEP_ALL writer may block on slow readers, nanoseconds: meanwhile no other topic is served."""

_log = logging.getLogger("sfglab.bus")
# Measured for 64 bytes at full speed: sent together they cost the router a third less system time.
_PACKET_BYTES = 1024


class DdsOutlet:
    """A raw writer in the target's domain.

    Args:
        handle: The C handle of the writer, which batches.
        order: Has a function called in the forwarder's thread.
        keeps_all: Whether it may block, because it must not lose what is not acknowledged yet.

    Attributes:
        gid: Its 16-byte GUID.
        sertype: What new samples for it are made with.
        closed: Whether it was deleted.
    """

    def __init__(self, handle: int, order: Callable[[Callable[[], None]], None], *, keeps_all: bool) -> None:
        self.gid = entity_guid(handle)
        self.sertype = sertype_of(handle)
        self.closed = False
        self._handle = handle
        self._order = order
        self._keeps_all = keeps_all
        self._unsent = False
        self._failed = False

    def close(self) -> None:
        """Delete the writer once every order given so far is carried out; again is harmless."""
        self._order(self._end)

    def hand_on(self, serdata: int, size: int) -> int:
        """Send a sample, with its next packet or at once.

        Args:
            serdata: The sample; its reference passes over, unless it has to wait.
            size: Its CDR's length in bytes.

        Returns:
            0; or `RETCODE_TIMEOUT`, when slow readers have to catch up first: the sample is still the caller's;
            or another negative code: the sample is lost.
        """
        lib = library()
        if self._keeps_all:
            lib.ddsi_serdata_ref(serdata)
        code: int = lib.dds_forwardcdr(self._handle, serdata)  # consumes a reference, also on failure
        if self._keeps_all and code != RETCODE_TIMEOUT:
            lib.ddsi_serdata_unref(serdata)
        if code < 0:
            return self._refused(code)
        self._unsent = True
        if size >= _PACKET_BYTES:
            self.flush()
        return 0

    def flush(self) -> None:
        """Send what waits for a packet to be full."""
        if self._unsent:
            self._unsent = False
            library().dds_write_flush(self._handle)

    def _end(self) -> None:
        if not self.closed:
            self.flush()
            self.closed = True
            delete_writer(self._handle)

    def _refused(self, code: int) -> int:
        if self._keeps_all and code == RETCODE_TIMEOUT:
            return code
        if not self._failed:
            self._failed = True
            _log.warning("forwarding: a sample was not sent on (%s); more are only counted", error_text(code))
        return RETCODE_ERROR

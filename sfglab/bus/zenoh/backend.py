"""Backend of a node over Zenoh, in the layout of rmw_zenoh_cpp."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.bus.zenoh.endpoints import ZenohReader, ZenohWriter
from sfglab.bus.zenoh.participant import ZenohParticipant
from sfglab.bus.zenoh.services import ReplyReader, RequestReader, ServiceWriter

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.api import RawEndpoint
    from sfglab.bus.endpoints import Inbox, Reader, Writer


class ZenohBackend(ZenohParticipant):
    """Backend with a Zenoh session; it has no shared memory.

    Raises:
        MissingExtraError: Zenoh is not installed.
        BusError: Zenoh refuses the configuration, or the process was forked from one with sessions.
    """

    def open_writer(self, endpoint: RawEndpoint, notify: Callable[[], None]) -> Writer:
        """Return a new writer of a topic, or of a service's requests or replies."""
        return (ServiceWriter if endpoint.is_service else ZenohWriter)(self, endpoint, notify)

    def open_reader(
        self, endpoint: RawEndpoint, notify: Callable[[], None], inbox: Inbox
    ) -> Reader:
        """Return a new reader of a topic, or of a service's requests or replies."""
        service = RequestReader if endpoint.dds_topic.startswith("rq/") else ReplyReader
        return (service if endpoint.is_service else ZenohReader)(self, endpoint, notify, inbox)

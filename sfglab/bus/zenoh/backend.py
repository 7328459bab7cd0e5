"""Backend of a node over Zenoh, in the layout of rmw_zenoh_cpp."""

from __future__ import annotations

import secrets
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

from sfglab.bus.api import SHM_KEY, user_data
from sfglab.bus.backend import Backend
from sfglab.bus.loop import nothing
from sfglab.bus.zenoh.endpoints import LatchedReader, ZenohReader, ZenohWriter
from sfglab.bus.zenoh.layout import PUBLISHER, SUBSCRIPTION
from sfglab.bus.zenoh.participant import Announcement, ZenohParticipant
from sfglab.bus.zenoh.services import Services
from sfglab.qos import Durability

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.api import RawEndpoint
    from sfglab.bus.endpoints import Inbox, Reader, Writer
    from sfglab.bus.zenoh.session import ZenohConfig


class ZenohBackend(Backend):
    """Backend with a Zenoh session.

    Raises:
        MissingExtraError: Zenoh is not installed.
        BusError: Zenoh refuses the configuration, or the process was forked from one with sessions.
    """

    kind = "zenoh"

    def __init__(self, config: ZenohConfig, name: str) -> None:
        super().__init__()
        self.participant = ZenohParticipant(config, name, self.bridge)
        self.guid = self.participant.guid
        self.graph = self.participant.graph
        self._services = Services(self.participant)

    def open_writer(self, endpoint: RawEndpoint, notify: Callable[[], None]) -> Writer:
        """Return a new writer over Zenoh or shared memory."""
        if endpoint.transport == "shm":
            from sfglab.bus.shm.writer import ShmWriter

            address = f"sfglab/zenoh/{secrets.token_hex(8)}"
            announce = partial(self._announce, endpoint, address, PUBLISHER)
            return ShmWriter(
                self.bridge, endpoint, address=address, announce=announce, notify=notify
            )
        if endpoint.is_service:
            return self._services.open(endpoint, notify, None)
        return ZenohWriter(self.participant, endpoint, notify)

    def open_reader(
        self, endpoint: RawEndpoint, notify: Callable[[], None], inbox: Inbox
    ) -> Reader:
        """Return a new reader over Zenoh or shared memory."""
        if endpoint.transport == "shm":
            from sfglab.bus.shm.reader import ShmReader

            announce = partial(self._announce, endpoint, "", SUBSCRIPTION)
            shared = ShmReader(self.bridge, endpoint, announce=announce, inbox=inbox, notify=notify)
            shared.follow(self.graph)
            return shared
        if endpoint.is_service:
            return self._services.open(endpoint, notify, inbox)
        is_latched = endpoint.qos.durability is Durability.TRANSIENT_LOCAL
        return (LatchedReader if is_latched else ZenohReader)(
            self.participant, endpoint, notify, inbox
        )

    def leave(self) -> None:
        """Close the session."""
        self.participant.session.close()

    def _announce(self, endpoint: RawEndpoint, address: str, kind: str) -> Announcement:
        """Announce a shared-memory endpoint, on whose key nothing is sent, as `DdsBackend` does."""
        shown = replace(endpoint, user_data=user_data({SHM_KEY: address}))
        announcement = Announcement(self.participant, shown, kind, nothing)
        announcement.open()
        announcement.show()
        return announcement

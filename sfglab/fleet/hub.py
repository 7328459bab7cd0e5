"""Hub of a fleet over Zenoh: a Zenoh session in router mode, of which the agents' routers are clients.

A client receives only what it subscribes to. Two hubs that are joined serve one fleet: clients of either reach
each other, and a client that names both continues with the other one when its hub fails.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.bus.zenoh.address import certificate, check_certificate, endpoint
from sfglab.bus.zenoh.session import Session, ZenohConfig

if TYPE_CHECKING:
    from sfglab.component import Report, Reporter


@dataclass(frozen=True, slots=True, kw_only=True)
class HubConfig:
    """Configuration of a hub; see `sfglab.bus.zenoh.address` for places.

    Raises:
        InvalidValueError: A place is none, or its link is not allowed.
    """

    listen: str = ""  #: Place at which agents connect; empty for port 7447 of all interfaces.
    hubs: tuple[str, ...] = ()  #: Places of other hubs that it joins.
    certificates: str = (
        ""  #: Folder with ``ca.pem``, ``NAME.pem`` and ``NAME.key``; empty without encryption.
    )
    name: str = "hub"  #: Name of its certificate.

    def __post_init__(self) -> None:
        self.config()

    def config(self) -> ZenohConfig:
        """Return the configuration of the hub's session; with certificates it accepts QUIC and TLS."""
        secure = bool(self.certificates)
        links = ("quic/", "tls/") if secure and "/" not in self.listen else ("",)
        return ZenohConfig(
            mode="router",
            connect=tuple(endpoint(place, secure=secure) for place in self.hubs),
            listen=tuple(endpoint(link + self.listen, secure=secure) for link in links),
            certificate=certificate(self.certificates, self.name),
        )


class HubNarrator:
    """Lines about the other hubs of a hub."""

    def lines(self, status: Report) -> list[str]:
        """Return a line about another hub that has come or gone."""
        return [f"hub {status['hub'][:8]} {'joined' if status['joined'] else 'lost'}"]


async def run_hub(config: HubConfig, report: Reporter) -> None:
    """Run a hub until cancelled; it reports ``ready``, and ``{"is": "status", "hub", "joined"}`` about other hubs.

    If it cannot listen at its place, it logs this and tries again. Zenoh joins other hubs whenever they respond.

    Raises:
        MissingExtraError: Zenoh is not installed.
        InvalidValueError: A file of the certificates is missing.
        BusError: Zenoh refuses the configuration.
    """
    settings = config.config()
    check_certificate(settings.certificate)
    loop = asyncio.get_running_loop()
    listeners: list[Any] = []

    def on_transport(event: Any) -> None:
        if str(event.transport.whatami) == "router":
            is_joined = str(event.kind) == "SampleKind.PUT"
            status = {"is": "status", "hub": str(event.transport.zid), "joined": is_joined}
            loop.call_soon_threadsafe(report, status)

    def on_open(opened: Any) -> None:
        listener = opened.info.declare_transport_events_listener(on_transport, history=True)
        listeners.append(listener)
        loop.call_soon_threadsafe(report, {"is": "ready"})

    session = Session(settings, "hub")
    session.order(on_open)
    try:
        await asyncio.Event().wait()
    finally:
        session.close()

"""Addresses of nodes over Zenoh, as values that travel between processes.

The module does not load Zenoh, so that configurations load fast.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError

if TYPE_CHECKING:
    from collections.abc import Iterable

    from sfglab.bus.zenoh.session import ZenohConfig

PORT = 7447  #: Port of a hub or peer if none is given, as in Zenoh.
MAX_HUBS = 2
_PLACE = re.compile(
    r"(?:(?P<link>\w+)/)?(?P<host>\[[0-9a-fA-F:.%\w]+\]|[\w.-]+)?(?::(?P<port>\d{1,5}))?", re.ASCII
)
_ALL_INTERFACES = "[::]"


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenohAddress:
    """Address of a node over Zenoh, a client of hubs or a peer; `options` returns the keyword arguments of `Node`.

    Places have the form HOST[:PORT], see `endpoint`.

    Raises:
        InvalidValueError: A place or its link is not allowed, there are more than two hubs, or hubs and peers.
    """

    #: Places of one or two hubs: the node is a client of the first that responds. Without hubs it is a peer.
    hubs: tuple[str, ...]
    domain_id: int = 0  #: ROS domain, 0 to 232; the first part of every key.
    #: Places of other peers, which make further ones known. A peer receives all declarations of all others, hence
    #: for up to 20 nodes. A place without HOST is the one at which the node itself accepts connections.
    peers: tuple[str, ...] = ()
    #: Folder with ``ca.pem``, ``NAME.pem`` and ``NAME.key``; empty without encryption.
    certificates: str = ""
    name: str = ""  #: Name of the certificate, that of the agent.

    def __post_init__(self) -> None:
        if len(self.hubs) > MAX_HUBS or (self.hubs and self.peers):
            given = ", ".join(self.hubs + self.peers)
            raise InvalidValueError("Zenoh, hubs and peers", given, "one or two hubs, or peers")
        self.config()

    def config(self) -> ZenohConfig:
        """Return the configuration of the node's session."""
        from sfglab.bus.zenoh.session import ZenohConfig

        secure = bool(self.certificates)
        own = [place for place in self.peers if place.startswith(":")]
        others = self.hubs + tuple(place for place in self.peers if place not in own)
        listen = () if self.hubs else own or [""]
        return ZenohConfig(
            domain_id=self.domain_id,
            mode="client" if self.hubs else "peer",
            connect=remote_endpoints(others, secure=secure),
            listen=tuple(endpoint(place, secure=secure) for place in listen),
            certificate=certificate(self.certificates, self.name),
        )

    def options(self) -> dict[str, Any]:
        """Return the address as keyword arguments of a node."""
        from sfglab.bus.zenoh.backend import ZenohBackend

        return {"join": partial(ZenohBackend, self.config())}


def endpoint(place: str, *, secure: bool) -> str:
    """Return Zenoh's endpoint of a place, [LINK/][HOST][:PORT]; without HOST that of all interfaces.

    Without certificates the link is TCP. With certificates it is QUIC, or TLS if the place begins with ``tls/``.

    Raises:
        InvalidValueError: The text is no place, or the link is not allowed.
    """
    links = ("quic", "tls") if secure else ("tcp",)
    found = _PLACE.fullmatch(place)
    if found is None or not 0 < int(found["port"] or PORT) <= 0xFFFF:
        raise InvalidValueError("Zenoh, place", place, "HOST, HOST:PORT or :PORT")
    link = found["link"] or links[0]
    if link not in links:
        allowed = f"{' and '.join(links)} {'with' if secure else 'without'} certificates"
        allowed += "; udp loses samples" * (link == "udp")
        raise InvalidValueError(f"Zenoh, link of {place!r}", link, allowed)
    return f"{link}/{found['host'] or _ALL_INTERFACES}:{found['port'] or PORT}"


def remote_endpoints(places: Iterable[str], *, secure: bool) -> tuple[str, ...]:
    """Return the endpoints of hubs or peers to connect to.

    Raises:
        InvalidValueError: A text is no place or has no host, or the link is not allowed.
    """
    endpoints = []
    for place in places:
        endpoints.append(endpoint(place, secure=secure))
        if f"/{_ALL_INTERFACES}:" in endpoints[-1]:
            raise InvalidValueError("Zenoh, place to connect to", place, "HOST or HOST:PORT")
    return tuple(endpoints)


def host(place: str) -> str:
    """Return the host of a place, as a certificate names it.

    Raises:
        InvalidValueError: The text is no place with certificates.
    """
    return endpoint(place, secure=True).partition("/")[2].rpartition(":")[0].strip("[]")


def certificate(folder: str, name: str) -> str:
    """Return the path of a certificate in a folder of certificates; empty without a folder."""
    return str(Path(folder) / f"{name}.pem") if folder else ""

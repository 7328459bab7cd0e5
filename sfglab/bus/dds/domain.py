"""DDS domains of this process, each joined once, and how: a comparable value, and Cyclone DDS's configuration.

Knows Cyclone's configuration elements. Cyclone allows one configuration per domain and process; the registry
makes a second, different one an error instead of a surprise.
"""

from __future__ import annotations

import os
import socket
import threading
from dataclasses import dataclass
from typing import Any, Literal, TypedDict, get_args
from xml.sax.saxutils import quoteattr

from sfglab.bus.dds.clib import error_text, library
from sfglab.bus.errors import DomainError

Multicast = Literal["default", "spdp", "true", "false"]

# RTPS 2.5, clause 9.6.1.1: ports are 7400 + 250 * domain id (+ offsets), so 233 leaves the 16-bit range.
_MAX_DOMAIN_ID = 232
# Loopback carries 64 KiB datagrams whole; measured against 1344-byte fragments this halves the latency of
# a 691 kB image. Real links keep Cyclone's default, which fits an Ethernet frame.
_LOOPBACK_SIZES = "<MaxMessageSize>65500B</MaxMessageSize><FragmentSize>64000B</FragmentSize>"


class DomainOptions(TypedDict, total=False):
    """Keyword arguments of a node that configure its DDS domain; see `DomainConfig`."""

    interface: str | None
    multicast: Multicast
    lease_s: float
    external_domain_id: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class DomainConfig:
    """How one process takes part in one DDS domain; all its nodes of that domain share it."""

    domain_id: int = 0  #: 0 to 232.
    interface: str | None = None  #: The network interface, e.g. "lo" or "eth0"; None lets Cyclone choose.
    #: Cyclone's AllowMulticast: "spdp" only finds participants by multicast, "false" never uses it and finds
    #: participants on this host only.
    multicast: Multicast = "default"
    lease_s: float = 10.0  #: After how many silent seconds others declare this process dead; at least 0.1.
    #: The domain that is joined on the network, 0 to 232; None is `domain_id`. Cyclone keeps one set of sockets
    #: and threads for each `domain_id`, so several of them with one external id are, for everybody else, as
    #: many processes in one domain.
    external_domain_id: int | None = None

    @property
    def wire_id(self) -> int:
        """The domain's id on the network, which decides its UDP ports."""
        return self.domain_id if self.external_domain_id is None else self.external_domain_id

    def __post_init__(self) -> None:
        for domain_id in (self.domain_id, self.wire_id):
            _check_id(domain_id)
        if self.multicast not in get_args(Multicast):
            raise DomainError(
                self.domain_id, f"multicast={self.multicast!r}; allowed are {', '.join(get_args(Multicast))}"
            )
        if not self.lease_s >= 0.1:
            raise DomainError(self.domain_id, f"lease_s={self.lease_s}; allowed are 0.1 s and more")


def _check_id(domain_id: Any) -> None:
    if isinstance(domain_id, bool) or not isinstance(domain_id, int):
        raise DomainError(domain_id, "the id is no whole number; allowed are 0 to 232")
    if not 0 <= domain_id <= _MAX_DOMAIN_ID:
        raise DomainError(domain_id, "allowed ids are 0 to 232: the UDP ports of higher ones do not exist")


def check_interface(config: DomainConfig) -> None:
    """Refuse an interface that this host does not have.

    Raises:
        DomainError: The interface does not exist; the message names those that do.
    """
    existing = [name for _, name in socket.if_nameindex()]
    if config.interface is not None and config.interface not in existing:
        raise DomainError(
            config.domain_id,
            f"there is no network interface {config.interface!r} here; there are {', '.join(sorted(existing))}",
        )


def domain_xml(config: DomainConfig) -> str:
    """Return Cyclone's configuration for a domain; CYCLONEDDS_URI, if set, comes first and is overridden."""
    own = f'<CycloneDDS><Domain Id="any">{_general(config)}{_discovery(config)}</Domain></CycloneDDS>'
    environment = os.environ.get("CYCLONEDDS_URI", "")
    return f"{environment},{own}" if environment else own


def _general(config: DomainConfig) -> str:
    parts = [f"<AllowMulticast>{config.multicast}</AllowMulticast>"]
    if config.interface is not None:
        parts.insert(0, f"<Interfaces><NetworkInterface name={quoteattr(config.interface)}/></Interfaces>")
    if config.interface == "lo":
        parts.append(_LOOPBACK_SIZES)
    return f"<General>{''.join(parts)}</General>"


def _discovery(config: DomainConfig) -> str:
    parts = [f"<LeaseDuration>{round(config.lease_s * 1e3)}ms</LeaseDuration>"]
    if config.external_domain_id is not None:
        parts.append(f"<ExternalDomainId>{config.external_domain_id}</ExternalDomainId>")
    if config.multicast == "false":
        parts.append("<ParticipantIndex>auto</ParticipantIndex><Peers><Peer Address='localhost'/></Peers>")
    return f"<Discovery>{''.join(parts)}</Discovery>"


@dataclass(slots=True)
class _Joined:
    config: DomainConfig
    handle: int
    users: int = 0


_joined: dict[int, _Joined] = {}
_lock = threading.Lock()


def join(config: DomainConfig) -> None:
    """Join a domain, or count one more user of it.

    Raises:
        DomainError: Another configuration of the domain is in use here, the interface does not exist or
            cannot be used, or its ports are taken.
    """
    with _lock:
        entry = _joined.get(config.domain_id)
        if entry is None:
            entry = _joined[config.domain_id] = _Joined(config, _create(config))
        elif entry.config != config:
            raise DomainError(
                config.domain_id,
                f"this process already joined it as {entry.config}, now asked for {config}; "
                f"close the other nodes first or use the same settings",
            )
        entry.users += 1


def leave(domain_id: int) -> None:
    """Count one user less; the last one leaves the domain and frees its sockets and threads."""
    with _lock:
        entry = _joined[domain_id]
        entry.users -= 1
        if entry.users == 0:
            del _joined[domain_id]
            library().dds_delete(entry.handle)


def _create(config: DomainConfig) -> int:
    check_interface(config)
    handle: int = library().dds_create_domain(config.domain_id, domain_xml(config).encode())
    if handle < 0:
        raise DomainError(
            config.domain_id,
            f"Cyclone DDS cannot start on interface {config.interface or '(automatic)'}: {error_text(handle)}; "
            f"check that the interface is up and has an address, that UDP port "
            f"{7400 + 250 * config.wire_id} is not taken (ids above 101 lie among Linux's "
            f"ephemeral ports), and that nothing else in this process joined the domain",
        )
    return handle

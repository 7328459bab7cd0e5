"""The DDS domains this process has joined, each once, counted by its users.

Cyclone allows one configuration per domain and process; this registry makes a second, different one an
error instead of a surprise.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

from sfglab.bus.dds.clib import error_text, library
from sfglab.bus.dds.config import DomainConfig, check_interface, domain_xml
from sfglab.bus.errors import DomainError


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

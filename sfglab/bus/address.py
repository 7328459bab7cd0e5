"""Addresses of nodes on the bus, as values that travel between processes."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class BusAddress:
    """Where on the bus a node stands; `options` are the keyword arguments of `sfglab.bus.Node`."""

    domain_id: int  #: DDS domain, 0 to 232.
    interface: str | None = None  #: Network interface by name; None leaves the choice to DDS.
    #: How far multicast is used: ``default``, or ``spdp`` for discovery only; see `DomainConfig`.
    multicast: str = "default"

    def options(self) -> dict[str, Any]:
        """Return the address as keyword arguments of a node."""
        return asdict(self)

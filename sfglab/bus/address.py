"""Addresses of nodes on the bus, as values that travel between processes."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True, slots=True, kw_only=True)
class BusAddress:
    """Address of a node: domain, interface and multicast; `options` returns the keyword arguments of `Node`."""

    domain_id: int  #: DDS domain, 0 to 232.
    interface: str | None = None  #: Network interface by name; None lets DDS choose.
    #: Use of multicast: ``default``, or ``spdp`` for discovery only; see `DomainConfig`.
    multicast: str = "default"

    def options(self) -> dict[str, Any]:
        """Return the address as keyword arguments of a node."""
        return asdict(self)

"""Where on the bus a component's node stands, as a value that travels between processes."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

__all__ = ["BusAddress"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BusAddress:
    """Where on the bus a node stands; `options` are the keyword arguments of `sfglab.bus.Node`.

    Attributes:
        domain_id: DDS domain, 0 to 232.
        interface: Network interface by name; None leaves the choice to DDS.
        multicast: How far multicast is used: ``default``, or ``spdp`` for discovery only.
    """

    domain_id: int
    interface: str | None = None
    multicast: str = "default"

    def options(self) -> dict[str, Any]:
        """Return the address as keyword arguments of a node."""
        return asdict(self)

"""Hub of a fleet over Zenoh: a Zenoh session in router mode, of which the agents' routers are clients.

A client receives only what it subscribes to. Two hubs that are joined serve one fleet: clients of either reach
each other, and a client that names both continues with the other one when its hub fails. The module runs as
``python -m sfglab.fleet.hub CONFIG``, see `sfglab.component`; `sfglab hub` runs it in a terminal.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING

from sfglab.bus.zenoh.address import certificate, endpoint, remote_endpoints
from sfglab.bus.zenoh.session import Session, ZenohConfig
from sfglab.component import run_component

if TYPE_CHECKING:
    from collections.abc import Sequence

    from sfglab.component import Reporter


def hub_config(
    listen: str = "", hubs: Sequence[str] = (), *, certificates: str = "", name: str = "hub"
) -> ZenohConfig:
    """Return the configuration of a hub's session.

    Args:
        listen: Place at which agents connect, see `endpoint`. With certificates it is that of both QUIC and TLS.
        hubs: Places of other hubs that it joins.
        certificates: Folder with ``ca.pem``, ``NAME.pem`` and ``NAME.key``; empty without encryption.
        name: Name of the hub's certificate.

    Raises:
        InvalidValueError: A place is none, or its link is not allowed.
    """
    secure = bool(certificates)
    links = ("quic/", "tls/") if secure and "/" not in listen else ("",)
    return ZenohConfig(
        mode="router",
        connect=remote_endpoints(hubs, secure=secure),
        listen=tuple(endpoint(link + listen, secure=secure) for link in links),
        certificate=certificate(certificates, name),
    )


async def run_hub(config: ZenohConfig, report: Reporter) -> None:
    """Run a hub until cancelled; it reports ``ready``.

    If it cannot listen at its place, it logs this and tries again. Zenoh joins other hubs whenever they respond.

    Raises:
        MissingExtraError: Zenoh is not installed.
        BusError: Zenoh refuses the configuration.
    """
    session = Session(config, "hub")
    _log_as_asked()
    session.order(lambda _: report({"is": "ready"}))
    try:
        await asyncio.Event().wait()
    finally:
        session.close()


def _log_as_asked() -> None:
    """Let Zenoh log to the terminal what the variable RUST_LOG names, for example what access control drops."""
    import zenoh

    zenoh.init_log_from_env_or("off")


if __name__ == "__main__":
    run_component(ZenohConfig, lambda config, report, _: run_hub(config, report))

"""Zenoh session of a node and the thread that uses it, because opening, declaring and sending may wait."""

from __future__ import annotations

import json
import logging
import os
import secrets
import threading
from dataclasses import dataclass
from functools import partial
from importlib.util import find_spec
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, Literal

from sfglab.bus.errors import BusError, DomainError
from sfglab.bus.loop import JOIN_S, call_logged, nothing
from sfglab.bus.zenoh.security import access_settings, certificate_fault, tls_settings
from sfglab.domains import MAX_DOMAIN
from sfglab.errors import MissingExtraError

if TYPE_CHECKING:
    from collections.abc import Callable

_log = logging.getLogger("sfglab.bus")
_LONGEST_PAUSE_S = 4.0
# Longest wait for one place, before a client tries the next one: a hub that has gone does not respond over QUIC.
_OPEN_S = 2.0


@dataclass(frozen=True, slots=True, kw_only=True)
class ZenohConfig:
    """Configuration of a node's Zenoh session."""

    domain_id: int = 0  #: ROS domain, 0 to 232; the first part of every key.
    #: Mode of the session. A client receives only what it subscribes to, through a router. Peers connect to each
    #: other and receive all declarations of each other.
    mode: Literal["client", "peer", "router"] = "client"
    #: Endpoints of routers or peers; a client uses the first that responds.
    connect: tuple[str, ...] = ("tcp/localhost:7447",)
    listen: tuple[str, ...] = ()  #: Endpoints at which a peer or router accepts connections.
    #: Lease, s: after this silence the other side closes a connection. Samples of a shorter outage arrive late,
    #: those of a longer one are lost.
    lease_s: float = 10.0
    #: Path of the certificate, NAME.pem, for QUIC and TLS; NAME.key and ca.pem are beside it, and for routers and
    #: peers the access control. The other side needs a certificate of the same authority. Empty for none.
    certificate: str = ""

    def __post_init__(self) -> None:
        if not 0 <= self.domain_id <= MAX_DOMAIN:
            raise DomainError(self.domain_id, "allowed ids are 0 to 232, as in DDS")

    def json(self, session: str) -> str:
        """Return Zenoh's configuration of the session with this id, which reads the files of certificates.

        Multicast would let other robots join unasked. By gossip, peers learn of each other from the one that they are
        connected to. Shared memory fails from a few hundred sessions on, because it locks memory. Caches of latched
        topics need time stamps.
        """
        settings: dict[str, Any] = {
            "id": session,
            "mode": self.mode,
            "connect": {"endpoints": self.connect},
            "listen": {"endpoints": self.listen},
            "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": True}},
            "timestamping": {"enabled": True},
            "transport": {
                "link": {"tx": {"lease": round(self.lease_s * 1e3)}},
                "unicast": {"open_timeout": round(_OPEN_S * 1e3)},
                "shared_memory": {"enabled": False},
            },
        }
        if self.certificate:
            path = Path(self.certificate)
            settings["transport"]["link"] |= tls_settings(path, verify_name=self.mode != "peer")
            if self.mode != "client":
                settings["access_control"] = access_settings(path)
        return json.dumps(settings)


class Session:
    """Zenoh session that a thread opens, again and again until a router responds.

    Raises:
        MissingExtraError: Zenoh is not installed.
        BusError: Zenoh refuses the configuration, or the process was forked from one with sessions.
    """

    _process: int | None = None  # the process that opened the first session

    def __init__(self, config: ZenohConfig, name: str) -> None:
        for library in ("zenoh", "xxhash"):
            if find_spec(library) is None:
                raise MissingExtraError(library, extra="zenoh", purpose="a node over Zenoh")
        Session._process = Session._process or os.getpid()
        if Session._process != os.getpid():
            raise BusError("a forked process cannot open a Zenoh session; start it with spawn")
        #: Id, hexadecimal digits; the first is not 0, because Zenoh leaves out zeros there.
        self.id = format(secrets.randbits(127) | 1 << 127, "x")
        self.is_open = False  #: Whether the session was opened.
        self._certificate = config.certificate
        state = "cannot be opened" if config.listen else "does not respond"
        self._state = f"Zenoh at {', '.join(config.listen or config.connect)} {state}"
        self._settings = _checked(config.json(self.id))
        self._zenoh: Any = None
        self._closing = threading.Event()
        self._orders: SimpleQueue[Callable[[Any], None] | None] = SimpleQueue()
        self._thread = threading.Thread(target=self._run, name=f"sfglab zenoh {name}", daemon=True)
        self._thread.start()

    def order(self, function: Callable[[Any], None]) -> None:
        """Call a function with the open Zenoh session in its thread, after those that were ordered before."""
        self._orders.put(function)

    def close(self) -> None:
        """Close the session with everything declared in it, and return when it is closed, after 5 s at most."""
        self._closing.set()
        self._orders.put(None)
        self._thread.join(JOIN_S)

    def _run(self) -> None:
        self._open()
        while self.is_open and (function := self._orders.get()) is not None:
            call_logged(partial(function, self._zenoh))
        if self.is_open:
            self._zenoh.close()

    def _open(self) -> None:
        import zenoh

        if self._certificate and (fault := certificate_fault(Path(self._certificate))):
            _log.warning("%s: others refuse this certificate: %s", self._certificate, fault)
        pause_s = 1.0
        while not self.is_open and not self._closing.is_set():
            try:
                self._zenoh = zenoh.open(self._settings)
                self.is_open = True
            except zenoh.ZError as error:
                reason = str(error).partition(" at /")[0]
                _log.warning("%s; next attempt in %.0f s: %s", self._state, pause_s, reason)
                self._closing.wait(pause_s)
                pause_s = min(2 * pause_s, _LONGEST_PAUSE_S)


def direct(callback: Callable[[Any], None], end: Callable[[], None] = nothing) -> Any:
    """Return a handler that calls functions in a thread of Zenoh.

    They must not wait: all subscriptions of the session would.
    """
    from zenoh.handlers import Callback

    return Callback(callback, end, indirect=False)


def _checked(settings: str) -> Any:
    import zenoh

    try:
        return zenoh.Config.from_json5(settings)
    except zenoh.ZError as error:
        raise BusError(f"Zenoh refuses the configuration: {error}") from error

"""Guard of the editor's server: who does not know its token, or comes from another page, is refused.

viser checks neither, and any page in a browser may open a WebSocket to loopback.
"""

from __future__ import annotations

import secrets
from contextlib import contextmanager
from importlib import import_module
from typing import TYPE_CHECKING, Any
from urllib.parse import urlsplit

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator


class Guard:
    """The token of one server, and the names by which it may be asked for.

    Args:
        hosts: What requests may name as their host, without port; empty: whatever leads here, as the proxy of a
            notebook's server, whose name nobody knows here.
    """

    def __init__(self, hosts: Collection[str]) -> None:
        self.token = secrets.token_urlsafe(16)  #: The first part of every path.
        self._hosts = hosts

    def refuses(self, path: str, host: str, origin: str | None) -> bool:
        """Return whether a request is refused, by its path and its headers ``Host`` and ``Origin``."""
        token = path.partition("?")[0].split("/")[1:2]
        known = bool(token) and secrets.compare_digest(token[0].encode(), self.token.encode())
        own = not self._hosts or (urlsplit(f"//{host}").hostname or "") in self._hosts
        return not (known and own and (origin is None or urlsplit(origin).netloc == host))

    @contextmanager
    def serving(self) -> Iterator[None]:
        """Have the server that is started meanwhile guarded."""
        server: Any = import_module("websockets.asyncio.server")
        serve = server.serve

        def guarded(*arguments: Any, process_request: Callable[[Any, Any], Any], **options: Any) -> Any:
            def judged(connection: Any, request: Any) -> Any:
                headers = request.headers
                if self.refuses(request.path, headers.get("Host", ""), headers.get("Origin")):
                    return connection.respond(403, "The address lacks its token, or another page asks.\n")
                request.path = request.path.removeprefix(f"/{self.token}") or "/"
                return process_request(connection, request)

            return serve(*arguments, process_request=judged, **options)

        server.serve = guarded
        try:
            yield
        finally:
            server.serve = serve

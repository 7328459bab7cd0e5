"""The editor in the browser: starts viser, puts the panels around the viewport, and reports changes to them.

All browsers that open the editor's address see and edit the same scene. The search for conflicts waits until the
scene has not changed for a moment, so that it does not delay a drag. `panels` has the edits.

Requests without the server's token, or from another page, are refused: viser checks neither, and any page in a
browser may open a WebSocket to loopback.
"""

from __future__ import annotations

import logging
import secrets
import socket
import threading
from contextlib import AbstractContextManager, contextmanager
from html import escape
from importlib import import_module
from typing import TYPE_CHECKING, Any, TypeVar
from urllib.parse import urlsplit

from sfglab.errors import SfglabError
from sfglab.view.planner.context import Context, JobQueue, Part, quiet, viser
from sfglab.view.planner.panels import Hierarchy, Inspector, Timeline, Warnings
from sfglab.view.planner.sending import Sender
from sfglab.view.planner.toolbar import Toolbar
from sfglab.view.planner.viewport import Viewport
from sfglab.view.widgets import LOOPBACK, address_of_port

if TYPE_CHECKING:
    from collections.abc import Callable, Collection, Iterator

    from sfglab.bus import Node
    from sfglab.spatial.scene.editor import Change, Editor


_log = logging.getLogger(__name__)
_LOCAL_NAMES = frozenset({LOOPBACK, "localhost"})
_T = TypeVar("_T")
_CELL_STYLE = "width:100%;height:700px;border:1px solid #ccc"
_LEFT_PX, _RIGHT_PX = 270, 330
_NOTE_S = 10.0
_QUIET_S = 0.25
#: Period at which `Planner.wait` looks for Ctrl-C, s.
_NOTICE_S = 1.0


class Planner(AbstractContextManager["Planner"]):
    """An editor that is served to browsers; a notebook's cell shows it.

    The editor belongs to the planner's own thread; other threads use `call`. Below JupyterLab, the editor's
    page has JupyterLab's address; otherwise the browser must reach this machine at 127.0.0.1.

    Args:
        editor: The editor.
        port: Port of loopback to serve; 0: any free one.
        node: Function that makes the node for sending trajectories; None: a node in the usual domain.

    Raises:
        MissingExtraError: viser is not installed.
        SfglabError: The port is taken.
    """

    def __init__(
        self,
        editor: Editor,
        *,
        port: int = 0,
        node: Callable[[], Node] | None = None,
    ) -> None:
        library = viser()
        _check_free(port)
        is_proxied = not address_of_port(0).startswith("http:")
        self._guard = Guard(() if is_proxied else _LOCAL_NAMES)
        with quiet(), self._guard.serving():
            self._server = library.ViserServer(host=LOOPBACK, port=port, verbose=False)
        self._closed = threading.Event()
        self._parts: list[Part] = []
        self._jobs = JobQueue(self._refused)
        self._sender = Sender(node or _usual_node, self._sent)
        self._context = Context(
            viser=library,
            server=self._server,
            editor=editor,
            jobs=self._jobs,
            sender=self._sender,
        )
        self._end_listening = editor.listen(self._changed)
        try:
            self._jobs.call(self._furnish)
        except BaseException:
            self.close()
            raise

    @property
    def url(self) -> str:
        """Address for a browser. The token in it gives access, so it must be kept private."""
        return f"http://{LOOPBACK}:{self._server.get_port()}/{self._guard.token}/"

    def call(self, job: Callable[[Editor], _T]) -> _T:
        """Call a function with the editor, in order with the browsers' actions, and return its result.

        Raises:
            SfglabError: The planner is closed.
        """
        return self._jobs.call(lambda: job(self._context.editor))

    def wait(self) -> None:
        """Wait until the planner is closed."""
        # Python runs the handler of Ctrl-C in the main thread. If another thread received the
        # signal, an endless wait would not notice it.
        while not self._closed.wait(_NOTICE_S):
            pass

    def close(self) -> None:
        """Cancel goals, run the remaining jobs and stop serving, without saving; further calls have no effect."""
        if self._closed.is_set():
            return
        self._closed.set()
        self._jobs.close(self._sender.close)
        self._end_listening()
        with quiet():
            self._server.stop()

    def __exit__(self, *_: object) -> None:
        self.close()

    def _repr_html_(self) -> str:
        if self._closed.is_set():
            return "<p>This scene editor is closed.</p>"
        address = address_of_port(self._server.get_port()).rstrip("/")
        source = escape(f"{address}/{self._guard.token}/")
        return f'<iframe src="{source}" style="{_CELL_STYLE}" title="scene editor"></iframe>'

    def _furnish(self) -> None:
        """Place the panels: hierarchy, conflicts and timeline left of the viewport, inspector right of it."""
        gui, icon, context = self._server.gui, self._context.viser.Icon, self._context
        gui.configure_theme(show_logo=False, show_share_button=False)
        left, below, bottom = gui.add_panel(), gui.add_panel(), gui.add_panel()
        self._viewport = Viewport(context)
        self._toolbar = Toolbar(context)
        self._inspector = Inspector(context)
        self._hierarchy = Hierarchy(context, left.add_tab("Scene", icon.HIERARCHY))
        self._warnings = Warnings(context, below.add_tab("Conflicts", icon.ALERT_TRIANGLE))
        with bottom.add_tab("Time", icon.CLOCK):
            self._timeline = Timeline(context)
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_RIGHT_PX)
        left.dock_left()
        left.set_width(_LEFT_PX)
        below.dock_below(left)
        bottom.dock_below(below)
        upper = [self._viewport, self._toolbar, self._inspector]
        self._parts = [*upper, self._hierarchy, self._timeline, self._warnings]
        self._check_later()

    def _changed(self, change: Change) -> None:
        for part in self._parts:
            try:
                part.show(change)
            except Exception:  # noqa: BLE001 - the edit is done, and the other parts show it
                _log.exception("the scene editor failed to show a change")
        if change.is_of_scene:
            self._check_later()

    def _check_later(self) -> None:
        """Search for conflicts once the scene has not changed for a moment, so that a drag is not delayed."""
        self._jobs.later("conflicts", self._check, delay_s=_QUIET_S, settles=False)

    def _check(self) -> None:
        try:
            found = self._context.editor.conflicts()
        except Exception:
            self._warnings.failed()
            raise
        self._warnings.found(found)
        self._viewport.found(found)

    def _refused(self, error: Exception) -> None:
        """Show why a job was refused, and the values of the scene again."""
        text = str(error)
        if not isinstance(error, SfglabError):
            text = f"an error of the editor itself: {error!r}"
        for client in self._server.get_clients().values():
            client.add_notification("Not done", text, color="red", auto_close_seconds=_NOTE_S)
        self._inspector.refresh()

    def _sent(self, id_: int) -> None:
        self._inspector.sent(id_)


def _usual_node() -> Node:
    """Return a node in the usual domain."""
    from sfglab.bus import Node

    return Node("planner")


def _check_free(port: int) -> None:
    """Check that a port can be served, because viser would otherwise use another one.

    Raises:
        SfglabError: The port cannot be served.
    """
    try:
        with socket.create_server((LOOPBACK, port)):
            pass
    except OSError as error:
        raise SfglabError(
            f"--port: given {port}, allowed: a free port, or 0 ({error.strerror})"
        ) from error


class Guard:
    """The token of a server, and the host names, without port, that requests may have.

    Without names, requests may have any host name, because the name of a notebook's proxy is unknown here.
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
        """Apply this guard to the server that viser starts within the context."""
        server: Any = import_module("websockets.asyncio.server")
        serve = server.serve

        def guarded(
            *arguments: Any, process_request: Callable[[Any, Any], Any], **options: Any
        ) -> Any:
            def judged(connection: Any, request: Any) -> Any:
                headers = request.headers
                if self.refuses(request.path, headers.get("Host", ""), headers.get("Origin")):
                    return connection.respond(
                        403, "The address lacks its token, or another page asks.\n"
                    )
                request.path = request.path.removeprefix(f"/{self.token}") or "/"
                return process_request(connection, request)

            return serve(*arguments, process_request=judged, **options)

        server.serve = guarded
        try:
            yield
        finally:
            server.serve = serve

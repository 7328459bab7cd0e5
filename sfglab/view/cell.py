"""Rerun's viewer in a cell of a notebook: its program from this machine, its data through the kernel.

The page chooses one of three ways. If the browser reaches this machine's loopback, a small server sends the viewer
(67 MB, once per page). If it does not, and the page has an address that browsers trust, the viewer comes through the
kernel's connection (23 MB). Otherwise the page shows a still image with a sentence. Nothing comes from the Internet:
the page blocks the viewer's request for newer releases. The module does not depend on the drawn data.
"""

from __future__ import annotations

import base64
import gzip
import json
import threading
from functools import cache
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.util import find_spec
from pathlib import Path
from secrets import token_urlsafe
from typing import TYPE_CHECKING, Any

from sfglab.errors import MissingExtraError
from sfglab.view.widgets import front_end

if TYPE_CHECKING:
    from collections.abc import Callable

WAITING_BYTES = 32 * 2**20
"""Largest number of bytes that wait for a page; further data is dropped until a page has loaded the viewer."""
#: Step of the times that the viewer reports, ns: it reports nanoseconds since 1970 as a float.
ROUNDED_NS = 256
PROGRAM, WASM = "widget.js", "re_viewer_bg.wasm"
_KINDS, _TOKEN = {PROGRAM: "text/javascript", WASM: "application/wasm"}, token_urlsafe()


class CellViewer:
    """A viewer for a cell of a notebook; the cell shows `widget`.

    Args:
        still: Image, PNG, for pages that cannot load the viewer.
        on_page: Called when a page has loaded the viewer; it shows all data that is sent from then on.
        on_time: Called with the time that the viewer shows, ns, whenever this time changes.

    Raises:
        MissingExtraError: Rerun's part for notebooks is not installed.
    """

    def __init__(
        self,
        *,
        still: bytes = b"",
        on_page: Callable[[], None] = lambda: None,
        on_time: Callable[[int], None] = lambda _: None,
    ) -> None:
        _files()
        self.widget = _widget_class()(
            _width="auto", _height=600, still=base64.b64encode(still).decode()
        )
        self.widget.on_msg(self._heard)
        self.widget.observe(lambda change: self._give(change["new"]), "wanted")
        self._on_page, self._on_time = on_page, on_time
        self._ready = self._opened = self._obeyed = False
        self._waiting: list[bytes] = []
        self._asked: tuple[str, int] | None = None

    def send(self, recording: bytes) -> None:
        """Show a part of a recording in the format of ``.rrd`` files; it waits until a page has loaded the viewer."""
        if self._ready:
            self.widget.send({"type": "rrd"}, buffers=[recording])
        elif sum(map(len, self._waiting)) + len(recording) <= WAITING_BYTES:
            self._waiting.append(recording)

    def go_to(self, timeline: str, at_ns: int) -> None:
        """Pause, and show a time, ns, of a timeline; an unknown timeline is shown as soon as the viewer knows it."""
        self._asked = timeline, at_ns
        if self._opened:
            order = {
                "type": "time_ctrl",
                "timeline": timeline,
                "timestamp_nanos": str(at_ns),
                "play": False,
                "sequence": None,
                "duration_nanos": None,
            }
            self.widget.send(order)

    def _heard(self, _: Any, content: Any, __: Any) -> None:
        if content == "ready":
            self._ready, self._obeyed = True, False
            waiting, self._waiting = self._waiting, []
            for part in waiting:
                self.send(part)
            self._on_page()
            return
        event = json.loads(content) if isinstance(content, str) else {}
        self._opened |= event.get("type") == "recording_open"
        if event.get("type") in ("time_update", "timeline_change"):
            shown_ns = round(event["time"])
            self._on_time(shown_ns)
            self._obeyed |= self._asked is not None and abs(shown_ns - self._asked[1]) <= ROUNDED_NS
        if self._asked and not self._obeyed:  # the viewer reports a refusal only to its page
            self.go_to(*self._asked)

    def _give(self, wanted: str) -> None:
        """Send the viewer's program to the page in the way that the page requests."""
        if wanted == "served":
            self.widget.address = _address()
        elif wanted == "inline":
            folder = _files()
            self.widget.program = (folder / PROGRAM).read_text("utf-8")
            self.widget.packed = gzip.compress((folder / WASM).read_bytes(), 6)


def _files() -> Path:
    """Return the folder with the viewer's program."""
    found = find_spec("rerun_notebook")
    if found is None or found.origin is None:
        raise MissingExtraError("rerun_notebook", extra="view", purpose="the view in a notebook")
    return Path(found.origin).parent / "static"


@cache
def _widget_class() -> Any:
    """Return the class of the front-end part; names with underscores are read by Rerun's program."""
    texts = dict.fromkeys(("_width", "wanted", "address", "program", "still", "mode"), "Unicode")
    return front_end(
        Path(__file__).with_name("cell.js"), texts | {"_height": "Int", "packed": "Bytes"}
    )


class _Handler(BaseHTTPRequestHandler):
    """Server of the viewer's two files, below a secret path."""

    def do_GET(self) -> None:  # the base's
        token, _, name = self.path.removeprefix("/").partition("/")
        if token != _TOKEN or name not in _KINDS:
            self.send_error(HTTPStatus.NOT_FOUND)
            return
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", _KINDS[name])
        self.send_header("Access-Control-Allow-Origin", "*")
        self.end_headers()
        self.wfile.write((_files() / name).read_bytes())

    def log_message(self, *_: Any) -> None:
        """Log nothing, because the log would be shown below the cell."""


@cache
def _address() -> str:
    """Return the URL at which this machine's browsers get the viewer's program, while the kernel runs."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), _Handler)
    threading.Thread(target=server.serve_forever, name="viewer's program", daemon=True).start()
    return f"http://127.0.0.1:{server.server_port}/{_TOKEN}"

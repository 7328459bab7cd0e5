"""A browser without a screen, for screenshots and for tests of what people see in one.

The engine is Chromium as PySide6-WebEngine has it (extra ``dev``), in a process of its own, steered over the
Chrome DevTools protocol. Draws 3D in software, so it needs no graphics card. Refuses to know any page.
"""

from __future__ import annotations

import base64
import itertools
import json
import os
import signal
import subprocess
import sys
import time
import urllib.request
from contextlib import suppress
from importlib import import_module
from typing import TYPE_CHECKING, Any

from sfglab.errors import MissingExtraError, SfglabError
from sfglab.lab.testbed import LOOPBACK, free_port

if TYPE_CHECKING:
    from pathlib import Path

_START_S = 90.0
_ANSWER_S = 60.0
_END_S = 1.0
_STILL_S = 0.25
_FLAGS = (
    "--use-gl=angle --use-angle=swiftshader --enable-unsafe-swiftshader --ignore-gpu-blocklist --lang=en-US "
    "--disable-background-timer-throttling --disable-renderer-backgrounding"
)
_FIND = """(() => {
  const seen = [...document.querySelectorAll(%s)].filter(
    e => (e.innerText || '').trim() === %s || e.getAttribute('aria-label') === %s);
  const shown = seen.map(e => e.getBoundingClientRect()).find(r => r.width > 0 && r.height > 0);
  return shown ? [shown.x + shown.width / 2, shown.y + shown.height / 2] : null;
})()"""


class BrowserError(SfglabError, RuntimeError):
    """The engine does not start, or a page does not do what was waited for."""


class Browser:
    """One page in an engine, of a width and height in pixels; to be closed.

    Raises:
        MissingExtraError: PySide6-WebEngine or websockets is not installed.
        BrowserError: The engine does not start, for example for want of a system library; says which.
    """

    def __init__(self, width: int = 1400, height: int = 800) -> None:
        client = _library("websockets.sync.client")
        _library("PySide6.QtWebEngineCore")
        self._ids = itertools.count(1)
        port = free_port()
        self._engine = _start(port, width, height)
        try:
            self._socket = client.connect(
                _address(self._engine, port), max_size=None, open_timeout=_START_S
            )
            screen = {"width": width, "height": height, "deviceScaleFactor": 1, "mobile": False}
            self.call("Emulation.setDeviceMetricsOverride", **screen)
        except BaseException:
            _stop(self._engine)
            raise

    def close(self) -> None:
        """End the engine with all its processes; again is harmless."""
        self._socket.close()
        _stop(self._engine)

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """Return the answer to a command of the DevTools protocol; raises `BrowserError` if it is refused."""
        id_ = next(self._ids)
        self._socket.send(json.dumps({"id": id_, "method": method, "params": parameters}))
        while True:
            answer: dict[str, Any] = json.loads(self._socket.recv(timeout=_ANSWER_S))
            if answer.get("id") == id_:
                break
        if "error" in answer:
            raise BrowserError(f"browser, {method}: {answer['error'].get('message')}")
        return answer.get("result", {})  # type: ignore[no-any-return]

    def open(self, url: str) -> None:
        """Show a page."""
        self.call("Page.navigate", url=url)

    def evaluate(self, script: str) -> Any:
        """Return the value of a JavaScript expression, None where it has none."""
        return self.call("Runtime.evaluate", expression=script, returnByValue=True)["result"].get(
            "value"
        )

    def wait_for(self, script: str, timeout_s: float = 15.0) -> Any:
        """Return the value of an expression as soon as it is truthy; `BrowserError` if it is not in time."""
        end = time.monotonic() + timeout_s
        while not (value := self.evaluate(script)):
            if time.monotonic() > end:
                raise BrowserError(f"browser: {script} did not become true within {timeout_s:g} s")
            time.sleep(0.05)
        return value

    def still(self, script: str, timeout_s: float = 15.0, what: str = "") -> Any:
        """Return the value of an expression, as a place, once it stays; else `BrowserError` says of what."""
        end = time.monotonic() + timeout_s
        since, last = time.monotonic(), None
        while time.monotonic() < end:
            value = self.evaluate(script)
            if value is None or value != last:
                since, last = time.monotonic(), value
            elif time.monotonic() - since > _STILL_S:
                return value
            time.sleep(0.05)
        raise BrowserError(f"browser: no {what or script} that stays within {timeout_s:g} s")

    def find(
        self, text: str, selector: str = "button", timeout_s: float = 15.0
    ) -> tuple[float, float]:
        """Return the middle of the first element with a text or label, once it stays; else `BrowserError`."""
        script = _FIND % (json.dumps(selector), json.dumps(text), json.dumps(text))
        x, y = self.still(script, timeout_s, f"{selector} {text!r}")
        return x, y

    def click(self, x: float, y: float) -> None:
        """Press and release the left button."""
        self._mouse("mouseMoved", x, y)
        self._mouse("mousePressed", x, y, button="left", buttons=1, clickCount=1)
        self._mouse("mouseReleased", x, y, button="left", clickCount=1)

    def press(self, text: str) -> None:
        """Click a button by its text or label."""
        self.click(*self.find(text))

    def drag(self, start: tuple[float, float], end: tuple[float, float], steps: int = 10) -> None:
        """Move the mouse with the left button held."""
        self._mouse("mouseMoved", *start)
        time.sleep(0.1)  # the page must see the pointer hover before it is pressed
        self._mouse("mousePressed", *start, button="left", buttons=1, clickCount=1)
        for i in range(1, steps + 1):
            x, y = (a + (b - a) * i / steps for a, b in zip(start, end, strict=True))
            self._mouse("mouseMoved", x, y, button="left", buttons=1)
            time.sleep(0.02)
        self._mouse("mouseReleased", *end, button="left", clickCount=1)

    def screenshot(self, file: Path) -> None:
        """Write what the page shows into a PNG file."""
        file.write_bytes(
            base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        )

    def _mouse(self, kind: str, x: float, y: float, **more: Any) -> None:
        self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, **more)


def _library(name: str) -> Any:
    try:
        return import_module(name)
    except ModuleNotFoundError as error:
        library = name.partition(".")[0]
        raise MissingExtraError(
            library, extra="dev", purpose="a browser without a screen"
        ) from error
    except ImportError as error:
        raise BrowserError(f"browser: the engine needs a system library: {error}") from error


def _start(port: int, width: int, height: int) -> subprocess.Popen[bytes]:
    environment = os.environ | {
        "QT_QPA_PLATFORM": "offscreen",
        "QTWEBENGINE_REMOTE_DEBUGGING": f"{LOOPBACK}:{port}",
        "QTWEBENGINE_DISABLE_SANDBOX": "1",
        "QTWEBENGINE_CHROMIUM_FLAGS": _FLAGS,
    }
    return subprocess.Popen(
        [sys.executable, __file__, str(width), str(height)],
        env=environment,
        stdin=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # so that its helpers can be ended with it
    )


def _address(engine: subprocess.Popen[bytes], port: int) -> str:
    """Return where the engine's page listens, once it does."""
    end = time.monotonic() + _START_S
    while time.monotonic() < end:
        if engine.poll() is not None:
            raise BrowserError(
                f"browser: the engine ended with status {engine.returncode} when it started"
            )
        with suppress(OSError, ValueError, LookupError):
            with urllib.request.urlopen(f"http://{LOOPBACK}:{port}/json", timeout=1) as answer:
                pages = json.load(answer)
            return str(pages[0]["webSocketDebuggerUrl"])
        time.sleep(0.05)
    raise BrowserError(f"browser: the engine does not listen within {_START_S:g} s")


def _stop(engine: subprocess.Popen[bytes]) -> None:
    """Let the engine end its helpers itself; end them all where it does not."""
    assert engine.stdin is not None
    with suppress(OSError):
        engine.stdin.close()
    with suppress(subprocess.TimeoutExpired):
        engine.wait(_END_S)
    with suppress(ProcessLookupError):
        os.killpg(engine.pid, signal.SIGKILL)
    engine.wait()


def _main(width: int, height: int) -> None:
    """Run the engine until standard input ends, as it does when the parent ends."""
    core, widgets, web = (
        _library(f"PySide6.{part}") for part in ("QtCore", "QtWidgets", "QtWebEngineWidgets")
    )
    app = widgets.QApplication(["browser"])
    view = web.QWebEngineView()
    view.resize(width, height)
    view.load(core.QUrl("about:blank"))
    view.show()
    ended = core.QSocketNotifier(0, core.QSocketNotifier.Type.Read)
    ended.activated.connect(app.quit)
    app.exec()


if __name__ == "__main__":
    _main(int(sys.argv[1]), int(sys.argv[2]))

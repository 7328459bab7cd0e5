"""Threads that compute the pictures of the newest setting and leave out those in between."""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.lab.pictures import Picture

if TYPE_CHECKING:
    from collections.abc import Callable

_log = logging.getLogger(__name__)
_PAUSE_S = 0.12  #: Time for a newer setting before a simulation refines its picture, s.


class Follower:
    """Computes the pictures of requested settings, one setting at a time.

    A closed form has one picture for a setting. A simulation has an iterator of pictures: coarse
    ones first, the whole one last. Its first picture is always shown, so that the figure follows a
    drag. After it the iterator is dropped as soon as there is a newer setting. None instead of a
    picture is only a place where that can happen. Each request has a thread, which first waits for
    the request before; it ends at once if there is a newer request by then.

    Args:
        function: Returns the picture of its arguments, or an iterator of pictures.
        show: Takes the number of a request, its setting, a picture, and whether this is the whole one.
        refuse: Takes the number of a request, and the reason why it has no picture.
    """

    def __init__(
        self,
        function: Callable[..., Any],
        show: Callable[[int, dict[str, Any], Picture, bool], None],
        refuse: Callable[[int, str], None],
    ) -> None:
        self._function = function
        self._show = show
        self._refuse = refuse
        self._request = 0
        self._is_stale = threading.Event()  # of the newest request
        self._thread = threading.Thread()
        self._turn = threading.Lock()

    def ask(self, setting: dict[str, Any]) -> int:
        """Request the pictures of a setting instead of those of earlier ones; return the request's number."""
        self._is_stale.set()
        self._is_stale = threading.Event()
        self._request += 1
        job = (self._request, setting, self._is_stale)
        self._thread = threading.Thread(target=self._run, args=job, name="explore", daemon=True)
        self._thread.start()
        return self._request

    def wait(self, timeout_s: float) -> bool:
        """Wait until the newest request is answered; return whether it is in time."""
        if self._request:
            self._thread.join(timeout_s)
        return not self._thread.is_alive()

    def _run(self, request: int, setting: dict[str, Any], is_stale: threading.Event) -> None:
        with self._turn:
            if is_stale.is_set():
                return
            try:
                self._answer(request, setting, is_stale)
            except SfglabError as error:
                self._refuse(request, str(error))
            except Exception as error:  # noqa: BLE001  # the figure says what cannot be drawn
                _log.exception("an explorer")
                self._refuse(request, f"it cannot be drawn: {error!r}")

    def _answer(self, request: int, setting: dict[str, Any], is_stale: threading.Event) -> None:
        computed = self._function(**setting)
        if isinstance(computed, Picture):
            self._show(request, setting, computed, True)
            return
        last = None
        for picture in computed:
            if picture is not None:
                last = picture
                self._show(request, setting, picture, False)
                is_stale.wait(_PAUSE_S)
            if last is not None and is_stale.is_set():
                return
        if last is not None:
            self._show(request, setting, last, True)

"""A thread that computes the pictures of the newest setting and leaves out those in between."""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.lab.pictures import Picture

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    Computed = Picture | Iterator[Picture | None]

_log = logging.getLogger(__name__)
_PAUSE_S = 0.12  #: Time for a newer setting before a simulation refines its picture, s.


class Follower:
    """A thread that computes pictures. Errors are reported and do not end it.

    A closed form has one picture for a setting. A simulation has an iterator of pictures: coarse
    ones first, the whole one last. Its first picture is always shown, so that the figure follows a
    drag. After it the iterator is dropped as soon as there is a newer setting. None instead of a
    picture is only a place where that can happen.

    Args:
        compute: Returns the picture, or the pictures, of a setting.
        show: Takes the number of a request, its setting, a picture, and whether this is the whole one.
        refuse: Takes the number of a request, and the reason why it has no picture.
    """

    def __init__(
        self,
        compute: Callable[[Any], Computed],
        show: Callable[[int, Any, Picture, bool], None],
        refuse: Callable[[int, str], None],
    ) -> None:
        self._compute = compute
        self._show = show
        self._refuse = refuse
        self._wanted: list[tuple[int, Any]] = []
        self._request = 0
        self._closed = False
        self._changed = threading.Condition()
        self._settled = threading.Event()
        self._settled.set()
        threading.Thread(target=self._run, name="explore", daemon=True).start()

    def ask(self, setting: Any) -> int:
        """Request the pictures of a setting instead of those that wait; return the request's number."""
        with self._changed:
            self._request += 1
            self._wanted = [(self._request, setting)]
            self._settled.clear()
            self._changed.notify()
            return self._request

    def wait(self, timeout_s: float) -> bool:
        """Wait until the newest request is answered; return whether it is in time."""
        return self._settled.wait(timeout_s)

    def close(self) -> None:
        """End the thread after the picture that it computes. Harmless when repeated."""
        with self._changed:
            self._closed = True
            self._changed.notify()

    def _run(self) -> None:
        while True:
            with self._changed:
                while not self._wanted and not self._closed:
                    self._settled.set()
                    self._changed.wait()
                if self._closed:
                    self._settled.set()
                    return
                request, setting = self._wanted.pop()
            try:
                self._answer(request, setting)
            except SfglabError as error:
                self._refuse(request, str(error))
            except Exception as error:  # noqa: BLE001  # what cannot be drawn must not end what comes after it
                _log.exception("an explorer")
                self._refuse(request, f"it cannot be drawn: {error!r}")

    def _answer(self, request: int, setting: Any) -> None:
        computed = self._compute(setting)
        if isinstance(computed, Picture):
            self._show(request, setting, computed, True)
            return
        last = None
        for picture in computed:
            if picture is not None:
                last = picture
                self._show(request, setting, picture, False)
                self._pause()
            if last is not None and (self._wanted or self._closed):
                return
        if last is not None:
            self._show(request, setting, last, True)

    def _pause(self) -> None:
        """Give a drag the time to change the setting again."""
        with self._changed:
            if not self._wanted and not self._closed:
                self._changed.wait(_PAUSE_S)

"""Checks of handling: displays added, tuned, rewired and removed while pictures come, and what changes."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any

from sfglab.bus import Node
from sfglab.errors import InvalidValueError
from sfglab.lab.checks import CheckRow, facts_row
from sfglab.lab.workers.sights import CAMERA_TOPIC
from sfglab.qos import DEFAULT, Reliability
from sfglab.view.bridge import Bridge
from sfglab.view.session import Display, Session

if TYPE_CHECKING:
    from collections.abc import Callable

    Requested = Callable[[], list[Reliability]]


_SOON_S = 5.0
_LIMIT_HZ = 5.0


class _Handled:
    """A session that is looked at while it changes, and a surface that keeps what is drawn on it."""

    def __init__(self, session: Session) -> None:
        self.session = session
        self.drawn: list[Any] = []

    def log(self, entity: str, *what: Any, static: bool = False) -> None:  # noqa: ARG002 - a canvas's signature
        """Keep it."""
        self.drawn += what

    def place(self, entity: str, frame: str) -> None:
        """Nothing is placed."""

    def at(self, *, stamp_ns: int, received_ns: int) -> None:
        """Times do not matter here."""

    def settle(self, size_bytes: int) -> None:
        """Nothing is on its way."""

    def close(self) -> None:
        """Nothing is open."""

    def opacity(self) -> float:
        """Return the opacity of the last picture."""
        return round(float(self.drawn[-1].opacity.as_arrow_array().to_pylist()[0]), 3)

    async def until(self, holds: Callable[[], bool]) -> bool:
        """Wait until something holds; return whether it did."""
        end_s = time.monotonic() + _SOON_S
        while not (held := holds()) and time.monotonic() < end_s:  # noqa: ASYNC110 - no event tells of it
            await asyncio.sleep(0.01)
        return held

    async def drawn_again(self) -> bool:
        """Wait for the next picture."""
        self.drawn.clear()
        return await self.until(lambda: bool(self.drawn))

    async def count(self, seconds: float) -> int:
        """Return how many pictures are drawn in a time."""
        self.drawn.clear()
        await asyncio.sleep(seconds)
        return len(self.drawn)


async def check_handling(domain_id: int, *, observed_s: float) -> list[CheckRow]:
    """Change a session at work in every way, while a camera sends pictures in a DDS domain.

    Where pictures are counted, it is for `observed_s` seconds.
    """
    session = Session()
    handled = _Handled(session)
    async with (
        Node("view", domain_id=domain_id, interface="lo") as node,
        Node("observer", domain_id=domain_id, interface="lo") as observer,
        Bridge(node, session, handled),
    ):

        def requested() -> list[Reliability]:
            """Return the reliability of each subscription that another node sees on the topic."""
            return [endpoint.qos.reliability for endpoint in observer.graph.subscriptions(CAMERA_TOPIC)]

        display = session.add("image", CAMERA_TOPIC)
        groups = {
            "added: its topic is subscribed to, and pictures come": {
                "drawn": await handled.drawn_again(),
                "subscribed": await handled.until(lambda: requested() == [Reliability.BEST_EFFORT]),
            },
            "a parameter counts from the next picture": await _tuned(handled, display),
            "a rate budget counts at once": await _limited(handled, display, observed_s),
            "a QoS profile is requested anew": await _rewired(handled, display, requested),
            "switched off and on again, and removed": await _removed(handled, display, requested),
        }
    return [facts_row(check, facts) for check, facts in groups.items()]


async def _tuned(handled: _Handled, display: Display) -> dict[str, bool]:
    before = handled.opacity()
    handled.session.tune(display.id, "opacity", 0.25)
    after = await handled.until(lambda: bool(handled.drawn) and handled.opacity() == 0.25)
    try:
        handled.session.tune(display.id, "opacity", 7.0)
        refused = False
    except InvalidValueError:
        refused = display.visualizer.settings["opacity"] == 0.25
    return {"before": before == 1.0, "after": after, "what is not allowed is refused": refused}


async def _limited(handled: _Handled, display: Display, seconds: float) -> dict[str, bool]:
    handled.session.limit(display.id, _LIMIT_HZ)
    await handled.drawn_again()
    limited = await handled.count(seconds)
    handled.session.limit(display.id, None)
    freed = await handled.count(seconds)
    expected = _LIMIT_HZ * seconds
    return {
        f"{limited} pictures in {seconds:g} s at {_LIMIT_HZ:g} Hz": abs(limited - expected) <= 2,
        f"{freed} without a limit": freed > 2 * limited,
    }


async def _rewired(handled: _Handled, display: Display, requested: Requested) -> dict[str, bool]:
    handled.session.rewire(display.id, qos={"image": DEFAULT})
    anew = await handled.until(lambda: requested() == [Reliability.RELIABLE])
    return {"requested": anew, "drawn": await handled.drawn_again()}


async def _removed(handled: _Handled, display: Display, requested: Requested) -> dict[str, bool]:
    session = handled.session
    session.enable(display.id, enabled=False)
    ended = await handled.until(lambda: not requested())
    silent = await handled.count(0.3)
    session.enable(display.id, enabled=True)
    again = await handled.drawn_again()
    session.remove(display.id)
    gone = await handled.until(lambda: not requested())
    return {
        "off: unsubscribed": ended,
        "off: nothing is drawn": silent == 0,
        "on: drawn again": again,
        "removed: unsubscribed": gone,
        "removed: nothing is drawn": await handled.count(0.3) == 0,
    }

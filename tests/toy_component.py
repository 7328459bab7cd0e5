"""A component that does as it is told: ``python -m toy_component CONFIG``."""

from __future__ import annotations

import os
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sfglab import component
from sfglab.component import Report, run_component
from sfglab.errors import SfglabError

if TYPE_CHECKING:
    import asyncio
    from collections.abc import Callable


@dataclass(frozen=True, slots=True, kw_only=True)
class ToyConfig:
    """How it begins and ends."""

    number: int = 0
    pairs: tuple[tuple[str, int], ...] = ()
    begins: str = "ready"
    farewell: str = ""  #: File to which its number is added when it ends.
    deaf: bool = False


async def serve(
    config: ToyConfig, report: Callable[[Report], None], orders: asyncio.Queue[Report]
) -> None:
    """Report what it was told and obey."""
    if config.begins == "broken":
        raise SfglabError("broken as told")
    sys.stdout.write("noise of a library")
    report({"is": config.begins, "number": config.number, "pairs": config.pairs})
    try:
        while True:
            obey(await orders.get(), report)
    finally:
        leave(config)


def leave(config: ToyConfig) -> None:
    """Leave a note, and not hear of anything any more."""
    if config.farewell:
        with Path(config.farewell).open("a") as file:
            file.write(f"{config.number}\n")
    if config.deaf:
        time.sleep(60)


def obey(order: dict[str, Any], report: Callable[[Report], None]) -> None:
    match order["do"]:
        case "die":
            os.kill(os.getpid(), signal.SIGKILL)
        case "fail":
            raise SfglabError("failed as told")
        case "exit":
            os._exit(7)
        case "babble":
            report({"no": "kind"})
        case "count":
            for n in range(order["to"]):
                report({"is": "count", "n": n})
            report({"is": "counted"})
        case "echo":
            report({"is": "echo", "order": order})


if __name__ == "__main__":
    component.END_LIMIT_S = 1
    run_component(ToyConfig, serve)

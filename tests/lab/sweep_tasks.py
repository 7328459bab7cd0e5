"""Tasks of the sweep's tests, in a module of their own so that every worker finds them."""

import math
import os
import signal
import time
from dataclasses import dataclass
from pathlib import Path
from random import Random
from uuid import uuid4


@dataclass(frozen=True, slots=True, kw_only=True)
class SpotPoint:
    number: int
    share: float = 0.1
    folder: str = ""  # where runs leave traces, and find orders


@dataclass(frozen=True, slots=True, kw_only=True)
class SpotRow:
    number: int
    seed: int
    value: float
    even: bool
    name: str


@dataclass(frozen=True, slots=True, kw_only=True)
class OtherRow:
    level: float


def quick(point, seed):
    value = Random(1000 * point.number + seed).random() / 3 * point.share
    if point.number == 1:
        value = (math.nan, math.inf, -math.inf, -0.0, 5e-324, 1e300)[seed % 6]
    return SpotRow(
        number=point.number, seed=seed, value=value, even=seed % 2 == 0, name=f"ä {point.number}\n"
    )


def several(point, seed):
    return quick(point, seed), OtherRow(level=seed / 7)


def uneven(point, seed):
    """Later points are quicker, so that they finish first."""
    sum(range(40_000 // (1 + point.number)))
    return quick(point, seed)


def large(point, seed):
    return {"number": point.number, "seed": seed, "name": "x" * 20_000_000}


def dying(point, seed):
    if (point.number, seed) == (2, 1) and not (Path(point.folder) / "healed").exists():
        os._exit(3)
    return quick(point, seed)


def failing(point, seed):
    if (point.number, seed) == (2, 1):
        raise ZeroDivisionError("by nothing")
    return quick(point, seed)


def _taken(order):
    """Take an order, which only one of those that run at once can remove; the others get none."""
    try:
        what = order.read_text()
        order.unlink()
    except FileNotFoundError:
        return ""
    return what


def _wait_for_results(journal):
    """Wait until the sweep has kept a result, so that there is something to continue."""
    end_s = time.monotonic() + 30
    while journal.read_bytes().count(b"\n") < 2 and time.monotonic() < end_s:
        time.sleep(0.01)


def obeying(point, seed):
    """Leave a trace; on the last point, do what the folder's file ``order`` says."""
    folder = Path(point.folder)
    order = folder / "order"
    if point.number == 3 and (what := _taken(order)):
        (folder / "pid").write_text(str(os.getpid()))
        if what == "kill":
            _wait_for_results(folder / "journal")
            os.kill(os.getppid(), signal.SIGKILL)
        if what == "ctrl-c":
            os.killpg(0, signal.SIGINT)
        signal.pause()  # until the end that was ordered
    (folder / f"run-{point.number}-{seed}-{uuid4().hex}").touch()
    return quick(point, seed)

"""Local cache and cache control on the readings of all seven sensors: what passes, what it saves, what holds.

Exact: the caches are the ones that run in live nodes, and time is the readings' own.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.arp.cache import CacheControl, Decision, LocalCache
from sfglab.arp.robots import SENSORS, cdr_bytes
from sfglab.lab.checks import CheckRow
from sfglab.lab.experiments.balancing.readings import readings
from sfglab.lab.experiments.balancing.rows import CacheRow
from sfglab.rtps import Flow, Medium, Scenario, Session

if TYPE_CHECKING:
    from sfglab.arp.robots import Sensor
    from sfglab.lab.experiments.balancing.config import Config


SILENCE_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Passage:
    """What became of a sensor's readings."""

    values: list[Any]  #: The readings.
    sent: list[bool]  #: For each, whether the local cache let it pass.
    refreshed: int  #: How many passed because of the silence.
    held_bytes: int  #: What the local cache says it saved.
    size_bytes: int  #: Size of one message.
    planned: list[bool]  #: For each, whether cache control let it pass, all readings being sent.
    planned_after: list[bool]  #: For each, whether it passed both.
    known: list[Any]  #: What planning works with after each reading, both caches in use.


@dataclass(slots=True)
class _Checks:
    """Counts properties over all passages."""

    rows: dict[str, list[Any]] = field(default_factory=dict)

    def note(self, check: str, holds: object, example: str) -> None:
        row = self.rows.setdefault(check, [0, 0, example])
        row[0] += 1
        row[1] += bool(holds)
        if not holds:
            row[2] = example

    def finished(self) -> list[CheckRow]:
        return [CheckRow(check=c, checked=n, held=h, example=e) for c, (n, h, e) in self.rows.items()]


def pass_through(sensor: Sensor, values: list[Any], *, rate_hz: float, silence_s: float) -> Passage:
    """Offer readings to the caches, and note what passes.

    Args:
        sensor: Whose readings.
        values: The readings.
        rate_hz: How often they were read.
        silence_s: Longest silence of the local cache; 0: none.
    """
    silence_ns = round(silence_s * 1e9) or None
    local, control, after = LocalCache(max_silence_ns=silence_ns), CacheControl(), CacheControl()
    size = cdr_bytes(sensor)
    sent, planned, planned_after, known = [], [], [], []
    for number, value in enumerate(values):
        now_ns = round(number / rate_hz * 1e9)
        sent.append(local.offer(sensor.name, value, now_ns=now_ns, size_bytes=size).passes)
        planned.append(control.offer(sensor.name, value, now_ns=now_ns).passes)
        planned_after.append(sent[-1] and after.offer(sensor.name, value, now_ns=now_ns) is Decision.CHANGED)
        known.append(after.current(sensor.name))
    return Passage(
        values=values,
        sent=sent,
        refreshed=local.counters.refreshed,
        held_bytes=local.counters.held_bytes,
        size_bytes=size,
        planned=planned,
        planned_after=planned_after,
        known=known,
    )


def cache_rows(config: Config) -> tuple[list[CacheRow], list[CheckRow]]:
    """Run every sensor at every rate, without and with a longest silence.

    Args:
        config: How long, and at which rates.

    Returns:
        What the caches saved, and the properties that were checked on the way.
    """
    rng = np.random.default_rng(config.seed)
    rows, checks = [], _Checks()
    for sensor in SENSORS.values():
        for rate_hz in config.rates_hz:
            values = readings(sensor, rate_hz=rate_hz, duration_s=config.readings_s, rng=rng)
            for silence_s in (0.0, SILENCE_S):
                passage = pass_through(sensor, values, rate_hz=rate_hz, silence_s=silence_s)
                _check(passage, checks, rate_hz, silence_s, f"{sensor.name} at {rate_hz} Hz")
                rows.append(_row(sensor, passage, rate_hz, silence_s))
            _check_compiled(passage, checks, rate_hz, f"{sensor.name} at {rate_hz} Hz")
    return rows, checks.finished()


def _check(passage: Passage, checks: _Checks, rate_hz: float, silence_s: float, place: str) -> None:
    values = passage.values
    changed = [True, *(b != a for a, b in pairwise(values))]
    gaps = np.diff([*np.flatnonzero(passage.sent), len(values)])
    if silence_s == 0:
        checks.note(
            "LC: what passes is the first value and every change, nothing else", passage.sent == changed, place
        )
    else:
        # A reading later than the silence at most.
        checks.note(
            "LC: no silence is longer than allowed", gaps.max() <= np.ceil(silence_s * rate_hz) + 1, place
        )
        all_changes = all(s for s, c in zip(passage.sent, changed, strict=True) if c)
        checks.note("LC: with a longest silence every change still passes at once", all_changes, place)
    checks.note("LC: the station always knows the sensor's value", passage.known == values, place)
    held = sum(not s for s in passage.sent)
    checks.note("LC: the counters say what was held", passage.held_bytes == held * passage.size_bytes, place)
    checks.note(
        "CC: planning gets the first value and every change, nothing else", passage.planned == changed, place
    )
    checks.note("CC: after a local cache planning gets the same", passage.planned_after == changed, place)


def _check_compiled(passage: Passage, checks: _Checks, rate_hz: float, place: str) -> None:
    """Give the same readings to the model's compiled local cache, on a link without losses."""
    flow = Flow(
        name="a", source="robot", target="station", rate_hz=rate_hz, cached=True, max_silence_s=SILENCE_S
    )
    duration_s = len(passage.values) / rate_hz
    session = Session(
        Scenario(flows=(flow,), medium=Medium(loss=0.0), duration_s=duration_s), seed=0, watched=()
    )
    number, last = 0, object()
    period_ns = round(1e9 / rate_hz)
    for i, value in enumerate(passage.values):
        number += value != last
        last = value
        session.set_value("a", number)
        session.advance((i + 1) * period_ns)
    # When the model published, as numbers of readings.
    session.advance((len(passage.values) + 1) * period_ns)
    passed = np.rint(session.outcome().flows["a"].published_ns / period_ns).astype(int)
    same = passed.tolist() == np.flatnonzero(passage.sent).tolist()
    checks.note("LC: the model's compiled cache lets the same readings pass", same, place)


def _row(sensor: Sensor, passage: Passage, rate_hz: int, silence_s: float) -> CacheRow:
    return CacheRow(
        sensor=sensor.name,
        rate_hz=rate_hz,
        silence_s=silence_s,
        offered=len(passage.values),
        sent=sum(passage.sent),
        refreshed=passage.refreshed,
        held_bytes=passage.held_bytes,
        planned=sum(passage.planned),
        planned_after=sum(passage.planned_after),
        join_wait_s=_join_wait_s(passage.sent, rate_hz),
    )


def _join_wait_s(sent: list[bool], rate_hz: float) -> float:
    """Return the mean wait for the next value that passes; the end counts as one, so this is a lower bound."""
    gaps = np.diff([*np.flatnonzero(sent), len(sent)]) / rate_hz
    return float((gaps**2).sum() / (2 * gaps.sum()))

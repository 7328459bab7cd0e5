"""The Pareto front of our own problem for paper B's topics, and the printed optimum judged alike."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sfglab.arp.plan import plan_as_printed
from sfglab.arp.programme import pareto_front
from sfglab.arp.topics import load_topics
from sfglab.lab.experiments.balancing.rows import FrontRow
from sfglab.lab.paths import find_project

if TYPE_CHECKING:
    from sfglab.arp.plan import Plan
    from sfglab.lab.experiments.balancing.config import Config


def front_rows(config: Config) -> list[FrontRow]:
    """Return the front and the printed optimum for every Rmax.

    Args:
        config: File of topics, rates, and how many points.
    """
    given = load_topics(find_project().data / config.topic_file)
    prices = tuple(float(price) for price in np.geomspace(0.1, 1000, config.weights))
    rows = []
    for rate in config.rates_hz:
        limited = given.limited_to(float(rate))
        points = pareto_front(limited.topics, limited.medium, limited.vendor, prices_hz=prices)
        best = max(points, key=lambda point: point.up_to_date)
        rows += [_row(point, rate, chosen=point is best) for point in points]
        rows.append(_row(plan_as_printed(limited), rate, chosen=False))
    return rows


def _row(point: Plan, rate_max_hz: int, *, chosen: bool) -> FrontRow:
    nan = float("nan")
    return FrontRow(
        method=point.method,
        rate_max_hz=rate_max_hz,
        latency_price_hz=nan if point.latency_price_hz is None else point.latency_price_hz,
        rate_low_hz=float(point.rates_hz.min()),
        rate_high_hz=float(point.rates_hz.max()),
        depth_high=max(part.depth for part in point.topics),
        utilisation=point.utilisation,
        freshness=point.freshness,
        latency_ms=1e3 * point.latency_s,
        up_to_date=point.up_to_date,
        airtime_price=nan if point.airtime_price is None else point.airtime_price,
        chosen=chosen,
    )

"""Growth of processes: how fast what they have becomes more, once they are warm."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.stats import Estimate, bootstrap

if TYPE_CHECKING:
    from collections.abc import Iterator

    import pandas as pd
    from numpy.typing import NDArray

STEP_S = 20.0  #: From one point of a process's course to the next, seconds.
#: How long processes of a kind are followed at least before they are judged, seconds.
JUDGED_S = 600.0


def steps(rows: pd.DataFrame, column: str, *, warm_s: float) -> NDArray[Any]:
    """Return how much a column became more in each step of each life after its warm-up, and the step's hours.

    Rows have ``agent``, ``pid`` and ``t_s``; a life is an agent's process. Shape (steps, 2).
    """
    found: list[NDArray[Any]] = [np.empty((0, 2))]
    for _, life in rows.groupby(["agent", "pid"]):
        old = life[life["t_s"] > life["t_s"].min() + warm_s]
        points = old.groupby(old["t_s"] // STEP_S)[[column, "t_s"]].first().to_numpy(float)
        found.append(np.diff(points, axis=0) / (1, 3600))
    return np.concatenate(found)


def rate(taken: NDArray[Any], *, unit: str) -> Estimate | None:
    """Return the mean growth in an hour by `steps`, which are resampled; None for less than two."""
    if len(taken) < 2:
        return None
    return bootstrap([taken], lambda g: float(g[0][:, 0].sum() / g[0][:, 1].sum()), unit=unit)


def growing(rows: pd.DataFrame, *, warm_s: float) -> Iterator[str]:
    """Yield a sentence for each kind of process (``who``) whose resident memory (``rss_mb``) is not flat.

    It is flat when the upper end of its growth is below its own size in a day: who has memory for an agent
    twice need not start it anew daily. What was followed for less than `JUDGED_S` after its warm-up is not
    judged.
    """
    for who, own in rows.groupby("who"):
        taken, size_mb = steps(own, "rss_mb", warm_s=warm_s), own["rss_mb"].median()
        grown = rate(taken, unit="MB/h")
        if grown is not None and 3600 * taken[:, 1].sum() >= JUDGED_S and 24 * grown.high > size_mb:
            yield f"memory of {who}: {grown}, of {size_mb:.0f} MB"

"""Glass-to-glass and first-picture times by path, and the claims.

A picture is known by the number in its pixels; its capture stamp is what the camera's own log says of that
number, never what a header says.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.latency.experiment import GLASS_PATHS, Config, exp
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, bootstrap, median_of
from sfglab.units import NS_PER_MS

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pandas as pd
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


@derived
def looks(run: Run[Config]) -> pd.DataFrame:
    """Return one line a look: its row, and two times in milliseconds.

    ``first_ms`` from the order to the first picture in hand, and ``first_age_ms`` from that picture's capture;
    NaN for a picture that the camera did not send.
    """
    table = run["look"]
    table = table.assign(first_ms=(table["first_ns"] - table["ordered_ns"]) / NS_PER_MS)
    first = run["sight"].drop_duplicates("look").merge(run["camera"][["number", "stamp_ns"]], on="number")
    first = first.assign(first_age_ms=(first["seen_ns"] - first["stamp_ns"]) / NS_PER_MS)
    return table.merge(first[["look", "first_age_ms"]], on="look", how="left")


@derived
def sights(run: Run[Config]) -> pd.DataFrame:
    """Return one line a picture in a steady look, those at its beginning left out.

    Look, repeat, path, number, and ``glass_ms`` from its capture.
    """
    seen = run["sight"]
    steady = seen[seen.groupby("look").cumcount() >= run.config.skipped]
    steady = steady.merge(run["look"][["look", "repeat", "path"]], on="look")
    steady = steady[steady["path"].isin(GLASS_PATHS)].merge(run["camera"][["number", "stamp_ns"]], on="number")
    return steady.assign(glass_ms=(steady["seen_ns"] - steady["stamp_ns"]) / NS_PER_MS)


def glass_median(run: Run[Config], path: str) -> Estimate:
    """Return the median time from capture to the viewer's hands, over the medians of looks.

    Args:
        run: The run.
        path: One of `GLASS_PATHS`.
    """
    return median_of(look_medians(run)[path].dropna().to_numpy(), unit="ms")


def added(run: Run[Config], path: str) -> Estimate:
    """Return what a path adds to the standard one: the median difference between looks of one repetition.

    Args:
        run: The run.
        path: ``decoder`` or ``agent``.
    """
    medians = look_medians(run)
    return median_of((medians[path] - medians["standard"]).dropna().to_numpy(), unit="ms added")


def look_medians(run: Run[Config]) -> pd.DataFrame:
    """Return the median glass-to-glass time of each look, a line a repetition and a column a path."""
    return sights(run).pivot_table(index="repeat", columns="path", values="glass_ms", aggfunc="median")


def _firsts(run: Run[Config]) -> pd.DataFrame:
    """Return the time to the first picture, a line a repetition and a column a path."""
    return looks(run).pivot_table(index="repeat", columns="path", values="first_ms").dropna()


def first_mean(run: Run[Config], path: str) -> Estimate:
    """Return the mean time from the order to subscribe to the first picture in hand.

    Args:
        run: The run.
        path: One of `PATHS`.
    """
    return bootstrap([_firsts(run)[path].to_numpy()], lambda g: float(np.mean(g[0])), unit="ms")


def first_ratio(run: Run[Config], path: str) -> Estimate:
    """Return how a path's mean time to the first picture compares with the standard one's.

    The paths of one repetition were asked at one phase of the group of pictures, so repetitions are resampled.

    Args:
        run: The run.
        path: One of `PATHS`.
    """
    pairs = _firsts(run)[[path, "standard"]].to_numpy()

    def ratio(groups: Sequence[Floats]) -> float:
        mean, standard = groups[0].mean(axis=0)
        return float(mean / standard)

    return bootstrap([pairs], ratio, unit="times standard")


def idle_cost(run: Run[Config], label: str) -> float:
    """Return what a process at the edge takes while nobody looks, in per cent of one core."""
    return float(run["idle"].loc[run["idle"]["label"] == label, "cpu_percent"].mean())


def checks(run: Run[Config]) -> pd.DataFrame:
    """Return, per path, what proves that the viewer saw the right pictures, and present ones at first.

    ``unknown`` counts first pictures that the camera did not send, ``oldest_ms`` is the largest age of a first
    picture.
    """
    by_path = looks(run).groupby("path", sort=False)
    sums = ["pictures", "unreadable", "missed", "disordered", "broken", "replay_packets", "replay_bytes"]
    table = by_path[sums].sum()
    table["looks"] = by_path.size()
    table["unknown"] = table["looks"] - by_path["first_age_ms"].count()
    table["oldest_ms"] = by_path["first_age_ms"].max()
    return table.reset_index()


def _hosts(run: Run[Config]) -> dict[str, str]:
    return {
        "hosts": str(run.metadata("hosts")["description"]),
        "encoder": str(run.metadata("stream")["encoder"]),
    }


@exp.claim("A-G2G", how=How.LIVE)
def glass_to_glass(run: Run[Config]) -> Finding:
    """Return what the decoder adds from capture to the viewer's hands."""
    details = {
        **_hosts(run),
        "standard": str(glass_median(run, "standard")),
        "through the decoder": str(glass_median(run, "decoder")),
        "through routers and decoder": str(added(run, "agent")),
        "pictures": str(len(sights(run))),
        "what is measured": "capture stamp to decoded pixels in the viewer's hands; no lens, no display",
    }
    return Finding(estimate=added(run, "decoder"), details=details)


@exp.claim("A-FIRST", how=How.LIVE)
def first_picture(run: Run[Config]) -> Finding:
    """Return how the time to the first picture compares with standard, with spare and replay."""
    air = run["idle"]["tx_mbit_s"].mean()
    agent = looks(run)[looks(run)["path"] == "agent"]
    details = {
        **_hosts(run),
        "standard": str(first_mean(run, "standard")),
        "on demand, the paper's way": str(first_mean(run, "on_demand")),
        "on demand, times standard": str(first_ratio(run, "on_demand")),
        "with replay, through routers": str(first_mean(run, "agent")),
        "with replay, decoder in the global domain": str(first_mean(run, "decoder")),
        "packets replayed": f"{agent['replay_packets'].mean():.1f} on average",
        "keeper, nobody looking": f"{idle_cost(run, 'keeper'):.2f} % of one core",
        "sent by the edge, nobody looking": f"{air:.3f} Mbit/s",
        "subscriptions a path": str(len(_firsts(run))),
    }
    return Finding(estimate=first_ratio(run, "agent"), details=details)

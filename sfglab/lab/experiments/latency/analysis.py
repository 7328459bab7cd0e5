"""From the log to figures: glass-to-glass and first-picture times by path, and the claims.

Everything here is computed from the log alone. A picture is known by the number in its pixels; its capture
stamp is what the camera's own log says of that number, never what a header says.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.claims import How, Measured
from sfglab.lab.experiments.latency.config import GLASS_PATHS
from sfglab.lab.stats import Estimate, bootstrap, median_of
from sfglab.record import LogReader

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import pandas as pd
    from numpy.typing import NDArray

    Floats = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """The tables of one run."""

    #: One line a look: its row, ``first_ms`` from the order to the first picture in hand, and ``first_age_ms``
    #: from that picture's capture; NaN for a picture that the camera did not send.
    looks: pd.DataFrame
    #: One line a picture in a steady look: look, repeat, path, number, ``glass_ms`` from its capture.
    sights: pd.DataFrame
    idle: pd.DataFrame  #: What the edge paid while nobody looked.
    config: dict[str, Any]  #: The run's configuration.
    hosts: dict[str, Any]  #: What the hosts were.
    stream: dict[str, Any]  #: What the stream was.


def load_results(log: Path) -> Results:
    """Read a run's tables.

    Args:
        log: The log.
    """
    with LogReader(log) as reader:
        config = reader.metadata("config")
        looks = reader.table("look").drop(columns="log_time_ns")
        looks["first_ms"] = (looks["first_ns"] - looks["ordered_ns"]) / 1e6
        camera = reader.table("camera")[["number", "stamp_ns"]]
        sights = reader.table("sight").drop(columns="log_time_ns")
        return Results(
            looks=_with_ages(looks, sights, camera),
            sights=_steady(sights, looks, camera, skipped=int(config["skipped"])),
            idle=reader.table("idle").drop(columns="log_time_ns"),
            config=config,
            hosts=reader.metadata("hosts"),
            stream=reader.metadata("stream"),
        )


def _with_ages(looks: pd.DataFrame, sights: pd.DataFrame, camera: pd.DataFrame) -> pd.DataFrame:
    first = sights.drop_duplicates("look").merge(camera, on="number")
    first = first.assign(first_age_ms=(first["seen_ns"] - first["stamp_ns"]) / 1e6)
    return looks.merge(first[["look", "first_age_ms"]], on="look", how="left")


def _steady(sights: pd.DataFrame, looks: pd.DataFrame, camera: pd.DataFrame, *, skipped: int) -> pd.DataFrame:
    """Return the pictures of steady looks with their age, those at the beginning left out."""
    order = sights.groupby("look").cumcount()
    steady = sights[order >= skipped].merge(looks[["look", "repeat", "path"]], on="look")
    steady = steady[steady["path"].isin(GLASS_PATHS)].merge(camera, on="number")
    return steady.assign(glass_ms=(steady["seen_ns"] - steady["stamp_ns"]) / 1e6)


def glass_median(results: Results, path: str) -> Estimate:
    """Return the median time from capture to the viewer's hands, over the medians of looks.

    Args:
        results: The run.
        path: One of `GLASS_PATHS`.
    """
    return median_of(look_medians(results)[path].dropna().to_numpy(), unit="ms")


def added(results: Results, path: str) -> Estimate:
    """Return what a path adds to the standard one: the median difference between looks of one repetition.

    Args:
        results: The run.
        path: ``decoder`` or ``agent``.
    """
    medians = look_medians(results)
    return median_of((medians[path] - medians["standard"]).dropna().to_numpy(), unit="ms added")


def look_medians(results: Results) -> pd.DataFrame:
    """Return the median glass-to-glass time of each look, a line a repetition and a column a path."""
    return results.sights.pivot_table(index="repeat", columns="path", values="glass_ms", aggfunc="median")


def _firsts(results: Results) -> pd.DataFrame:
    """Return the time to the first picture, a line a repetition and a column a path."""
    return results.looks.pivot_table(index="repeat", columns="path", values="first_ms").dropna()


def first_mean(results: Results, path: str) -> Estimate:
    """Return the mean time from the order to subscribe to the first picture in hand.

    Args:
        results: The run.
        path: One of `PATHS`.
    """
    return bootstrap([_firsts(results)[path].to_numpy()], lambda g: float(np.mean(g[0])), unit="ms")


def first_ratio(results: Results, path: str) -> Estimate:
    """Return how a path's mean time to the first picture compares with the standard one's.

    The paths of one repetition were asked at one phase of the group of pictures, so repetitions are resampled.

    Args:
        results: The run.
        path: One of `PATHS`.
    """
    pairs = _firsts(results)[[path, "standard"]].to_numpy()

    def ratio(groups: Sequence[Floats]) -> float:
        mean, standard = groups[0].mean(axis=0)
        return float(mean / standard)

    return bootstrap([pairs], ratio, unit="times standard")


def idle_cost(results: Results, label: str) -> float:
    """Return what a process at the edge takes while nobody looks, in per cent of one core."""
    return float(results.idle.loc[results.idle["label"] == label, "cpu_percent"].mean())


def checks(results: Results) -> pd.DataFrame:
    """Return, per path, what proves that the viewer saw the right pictures, and present ones at first.

    ``unknown`` counts first pictures that the camera did not send, ``oldest_ms`` is the largest age of a first
    picture.
    """
    looks = results.looks.groupby("path", sort=False)
    sums = ["pictures", "unreadable", "missed", "disordered", "broken", "replay_packets", "replay_bytes"]
    table = looks[sums].sum()
    table["looks"] = looks.size()
    table["unknown"] = table["looks"] - looks["first_age_ms"].count()
    table["oldest_ms"] = looks["first_age_ms"].max()
    return table.reset_index()


def measure_claims(log: Path) -> dict[str, Measured]:
    """Return our figures for the claims that this experiment answers, by claim id."""
    results = load_results(log)
    hosts = {"hosts": str(results.hosts["description"]), "encoder": str(results.stream["encoder"])}
    return {"A-G2G": _glass_claim(results, hosts), "A-FIRST": _first_claim(results, hosts)}


def _glass_claim(results: Results, hosts: dict[str, str]) -> Measured:
    details = {
        **hosts,
        "standard": str(glass_median(results, "standard")),
        "through the decoder": str(glass_median(results, "decoder")),
        "through routers and decoder": str(added(results, "agent")),
        "pictures": str(len(results.sights)),
        "what is measured": "capture stamp to decoded pixels in the viewer's hands; no lens, no display",
    }
    return Measured(estimate=added(results, "decoder"), how=How.LIVE, details=details)


def _first_claim(results: Results, hosts: dict[str, str]) -> Measured:
    air = results.idle["tx_mbit_s"].mean()
    agent = results.looks[results.looks["path"] == "agent"]
    details = {
        **hosts,
        "standard": str(first_mean(results, "standard")),
        "on demand, the paper's way": str(first_mean(results, "on_demand")),
        "on demand, times standard": str(first_ratio(results, "on_demand")),
        "with replay, through routers": str(first_mean(results, "agent")),
        "with replay, decoder in the global domain": str(first_mean(results, "decoder")),
        "packets replayed": f"{agent['replay_packets'].mean():.1f} on average",
        "keeper, nobody looking": f"{idle_cost(results, 'keeper'):.2f} % of one core",
        "sent by the edge, nobody looking": f"{air:.3f} Mbit/s",
        "subscriptions a path": str(len(_firsts(results))),
    }
    return Measured(estimate=first_ratio(results, "agent"), how=How.LIVE, details=details)

"""Every check of a run, what the bridge adds, the claim A-VIZ: the share of checks that hold; the figures."""

from __future__ import annotations

import io
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.checks import CheckRow, facts_row, share_of_checks
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.visualisation.experiment import CLOUD, PICTURE, Config, exp
from sfglab.lab.experiments.visualisation.stage import ADDED_MS, BOUND_BYTES
from sfglab.lab.figures import COLORS, PAPER_STYLE
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, bootstrap

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray


MIB = 2**20


@derived
def checks(run: Run[Config]) -> pd.DataFrame:
    """Return every check: those made while it ran, and that of what was measured."""
    memory = {"group": "memory", **asdict(check_memory(run["memory"]))}
    return pd.concat([run["check"], pd.DataFrame([memory])], ignore_index=True)


def check_memory(memory: pd.DataFrame) -> CheckRow:
    """Return whether what waits is bounded, nothing is unaccounted for, and pictures flow again afterwards."""
    end, stopped = memory.iloc[-1], memory[memory["stopped"]]
    waiting, most = end["received"] - end["shown"] - end["dropped"], memory["queued_bytes"].max()
    facts = {
        f"at most {most / MIB:.1f} of {BOUND_BYTES / MIB:.1f} MiB wait": bool(most <= BOUND_BYTES),
        f"{waiting} pictures are neither shown nor counted as dropped nor wait": bool(0 <= waiting <= 1),
        "pictures flow again": bool(end["shown"] > stopped["shown"].max() + 1),
    }
    return facts_row("a sink that stands still costs pictures, and bounded memory", facts)


def latency_table(run: Run[Config]) -> pd.DataFrame:
    """Return how long pictures took, by arm: median and percentiles, in milliseconds."""
    table = run["time"].groupby("arm")["taken_ms"].describe(percentiles=[0.05, 0.5, 0.95, 0.99])
    names = {"count": "pictures", "5%": "5 %", "50%": "median", "95%": "95 %", "99%": "99 %"}
    return table[[*names]].rename(columns=names).astype({"pictures": int})


@derived
def added_ms(run: Run[Config]) -> Estimate:
    """Estimate what the bridge adds: its median beyond that of Rerun's own call, in the same run."""
    times = run["time"]
    arms = [times.loc[times["arm"] == arm, "taken_ms"].to_numpy(float) for arm in ("bridge", "bare")]
    return bootstrap(arms, lambda groups: float(np.median(groups[0]) - np.median(groups[1])), unit="ms")


@exp.claim("A-VIZ", how=How.LIVE)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of checks that hold, in the group where it is lowest.

    What the bridge adds is told beside it: the paper states no latency of its bridge.
    """
    share, memory = share_of_checks(checks(run), "group"), run["memory"]
    details = {
        **share.groups,
        "added by the bridge": f"{added_ms(run)}; asked is below {ADDED_MS:g} ms",
        "waiting at most, with a sink that stands still": f"{memory['queued_bytes'].max() / MIB:.1f} MiB",
        "dropped meanwhile": f"{int(memory['dropped'].max())} of {int(memory['received'].max())} pictures",
    }
    return Finding(estimate=share.estimate, details=details, reason=share.reason)


_ARMS = {"bare": ("standard", "Rerun alone"), "bridge": ("proxy", "through the bridge")}


@exp.figure("visualisation_latency", size=(10, 4.2))
def draw_latency(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw what the bridge adds, and what waits and is dropped while a sink stands still."""
    parts: Any = figure.subfigures(1, 2)
    _draw_times(parts[0].subplots(), run)
    upper, lower = parts[1].subplots(2, 1, sharex=True)
    memory = run["memory"]
    _draw_waiting(upper, memory)
    _draw_fates(lower, memory)
    return {
        "added_ms": added_ms(run).value,
        "latency_ms": {str(arm): dict(row) for arm, row in latency_table(run).iterrows()},
        "queued_bytes": int(memory["queued_bytes"].max()),
        "dropped": int(memory["dropped"].max()),
    }


def _draw_times(axes: Axes, run: Run[Config]) -> None:
    for arm, (color, label) in _ARMS.items():
        taken = np.sort(run["time"].loc[run["time"]["arm"] == arm, "taken_ms"].to_numpy(float))
        share = np.arange(1, len(taken) + 1) / len(taken)
        axes.step(taken, share, where="post", color=COLORS[color], label=f"{label}: {np.median(taken):.2f} ms")
    bare = float(np.median(run["time"].loc[run["time"]["arm"] == "bare", "taken_ms"]))
    asked = f"asked at the median: {ADDED_MS:g} ms beyond Rerun alone"
    axes.axvline(bare + ADDED_MS, color=COLORS["network"], label=asked, **PAPER_STYLE)
    axes.set(xlabel="time until the sink has the picture (ms)", ylabel="share of pictures")
    axes.set(xlim=(0, bare + 9), ylim=(0, 1))
    axes.set_title(f"The bridge adds {added_ms(run).value:.2f} ms at the median (640 x 360, raw)")
    axes.legend(loc="lower right", frameon=True, framealpha=1, edgecolor="none")


def _shade(axes: Axes, memory: pd.DataFrame) -> None:
    stopped = memory[memory["stopped"]]["at_s"]
    if len(stopped):
        axes.axvspan(stopped.min(), stopped.max(), color=COLORS["network"], alpha=0.2, linewidth=0)


def _draw_waiting(axes: Axes, memory: pd.DataFrame) -> None:
    _shade(axes, memory)
    queued = memory["queued_bytes"] / MIB
    axes.plot(memory["at_s"], queued, color=COLORS["proxy"], label="not known to be taken")
    grown = (memory["resident_bytes"] - memory["resident_bytes"].iloc[0]) / MIB
    axes.plot(memory["at_s"], grown, color=COLORS["third"], label="process, since the start")
    axes.axhline(BOUND_BYTES / MIB, color=COLORS["standard"], label="bound", **PAPER_STYLE)
    axes.set(ylabel="MiB", title="A sink that stands still (grey)", ylim=(0, 1.8 * BOUND_BYTES / MIB))
    axes.legend(loc="upper left", ncols=2, fontsize="small")


def _draw_fates(axes: Axes, memory: pd.DataFrame) -> None:
    _shade(axes, memory)
    for name, color in (("received", "network"), ("shown", "proxy"), ("dropped", "standard")):
        axes.plot(memory["at_s"], memory[name], color=COLORS[color], label=name)
    axes.set(xlabel="time (s)", ylabel="pictures", ylim=(0, None))
    axes.legend(loc="upper left", fontsize="small")


@exp.figure("visualisation_points", size=(12, 3.5))
def draw_points(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw a picture, the points that its depth became in the recording, and how far they are off."""
    import cv2

    jpeg = np.frombuffer(run.attachment(PICTURE), np.uint8)
    cloud = dict(np.load(io.BytesIO(run.attachment(CLOUD))))
    grid = figure.add_gridspec(1, 3, width_ratios=[1.2, 1.5, 0.9])
    image: Any = cv2.imdecode(jpeg, cv2.IMREAD_COLOR)
    picture = figure.add_subplot(grid[0])
    picture.imshow(cv2.resize(image, (400, 225), interpolation=cv2.INTER_AREA)[..., ::-1])
    picture.set_axis_off()
    picture.set_title("Image, registered to the depth")
    _draw_cloud(figure.add_subplot(grid[1], projection="3d"), cloud["points"], cloud["colors"])
    errors = figure.add_subplot(grid[2])
    errors.hist(1e6 * cloud["errors_m"], bins=40, color=COLORS["proxy"])
    errors.set(xlabel="distance from NumPy's point (um)", ylabel="points", title="how far they are off")
    largest = float(run["cloud"]["largest_error_m"].max())
    return {"images": len(run["cloud"]), "largest_error_m": largest, "points": len(cloud["points"])}


def _draw_cloud(axes: Any, points: NDArray[Any], colors: NDArray[np.uint8]) -> None:
    """Draw points as the camera sees them from a step to the side: x right, z forward, y down (REP 103)."""
    x, y, z = points.T
    axes.scatter(x, z, -y, c=colors / 255.0, s=1.2, linewidths=0, rasterized=True)
    axes.set_box_aspect([np.ptp(x), np.ptp(z), np.ptp(y)], zoom=1.25)
    axes.view_init(elev=18, azim=-68)
    axes.set_zticklabels([])
    axes.locator_params(nbins=4)
    axes.set(xlabel="x (m)", title=f"its {len(points)} points in the recording, depth to the back")

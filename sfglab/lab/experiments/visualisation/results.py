"""Claim and figures on the bridge to the Rerun viewer."""

from __future__ import annotations

import io
from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.checks import fact_rows, facts_row, lowest_share
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.visualisation.experiment import CLOUD, PICTURE, Config, exp
from sfglab.lab.experiments.visualisation.live import DISPLAY, PARAMETER, QOS
from sfglab.lab.experiments.visualisation.plugin import PLUGIN
from sfglab.lab.experiments.visualisation.points import POINTS
from sfglab.lab.figures import COLORS, note
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, bootstrap

if TYPE_CHECKING:
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

ADDED_MS = 5.0
"""Largest accepted delay that the bridge adds to an image of 640 x 360, ms, at the median and at the 99th percentile.
The paper states none."""
JUDGED = {"median": "median", "99 %": "99th percentile"}
"""Columns of `latency_table` that are compared with the bound, and their names in texts."""
DELAY = f"the bridge adds less than {ADDED_MS:g} ms to the median and to the 99th percentile"

FACTS = (PLUGIN, DISPLAY, PARAMETER, QOS, POINTS)
"""The facts of the live part; the delay is computed from the times of the images."""
STATEMENTS = {
    PLUGIN: "Visualizers of another package work, and one that fails disturbs no other.",
    DISPLAY: "A visualizer is added and removed while the bridge runs.",
    PARAMETER: "A parameter is changed at run time.",
    QOS: "A QoS profile is changed at run time.",
    POINTS: "A synchronised depth image and camera info become the points of the pinhole equation.",
    DELAY: f"The bridge adds less than {ADDED_MS:g} ms to the median and to the 99th percentile.",
}
"""Sentence that each fact states."""


def taken_ms(run: Run[Config], arm: str) -> NDArray[np.float64]:
    """Return the times that the images of an arm took, ms, shape (n,)."""
    times = run["time"]
    return times.loc[times["arm"] == arm, "taken_ms"].to_numpy(float)


def latency_table(run: Run[Config]) -> pd.DataFrame:
    """Return the times of images by arm: median and percentiles, ms."""
    table = run["time"].groupby("arm")["taken_ms"].describe(percentiles=[0.05, 0.5, 0.95, 0.99])
    names = {"count": "images", "5%": "5 %", "50%": "median", "95%": "95 %", "99%": "99 %"}
    return table[[*names]].rename(columns=names).astype({"images": int})


@derived
def added_ms(run: Run[Config]) -> Estimate:
    """Estimate the delay that the bridge adds, ms: the difference of its median and that of a direct call of Rerun."""
    arms = [taken_ms(run, "bridge"), taken_ms(run, "bare")]
    return bootstrap(
        arms, lambda groups: float(np.median(groups[0]) - np.median(groups[1])), unit="ms"
    )


def beyond_rerun_ms(run: Run[Config]) -> dict[str, float]:
    """Return how much longer the bridge takes than a direct call of Rerun, in the columns `JUDGED`, ms."""
    taken = latency_table(run).to_dict("index")
    return {name: taken["bridge"][name] - taken["bare"][name] for name in JUDGED}


@derived
def facts(run: Run[Config]) -> pd.DataFrame:
    """Return the facts: those of the live part, and the delay of the bridge."""
    within = {}
    for name, ms in beyond_rerun_ms(run).items():
        within[f"{JUDGED[name]}: {ms:.1f} ms"] = ms < ADDED_MS
    delay = pd.DataFrame([asdict(facts_row(DELAY, within))])
    return pd.concat([fact_rows(run["check"], FACTS), delay], ignore_index=True)


@exp.claim("A-VIZ", how=How.LIVE)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of cases that hold, of the fact where it is lowest.

    The delay that the bridge adds is judged at the median and at 99 %; the paper states none.
    """
    table = facts(run)
    share = lowest_share(table, "check")
    delay = f"{added_ms(run)}; asked is below {ADDED_MS:g} ms"
    details = {**share.groups, "added by the bridge": delay}
    count = f"lowest of {len(table)} facts"
    return Finding(estimate=share.estimate, details=details, reason=share.reason, count=count)


@exp.figure("visualisation_latency", size=(7, 4.2))
def draw_latency(figure: Figure, run: Run[Config]) -> None:
    """Draw the cumulative share of images over their delay, through the bridge and with Rerun alone."""
    axes = figure.subplots()
    table = latency_table(run)
    arms = {"bare": ("standard", "Rerun alone"), "bridge": ("proxy", "through the bridge")}
    for arm, (color, name) in arms.items():
        median_ms, tail_ms = table.loc[arm, [*JUDGED]]
        text = f"{name}: median {median_ms:.1f} ms,\n99th percentile {tail_ms:.1f} ms"
        axes.ecdf(taken_ms(run, arm), color=COLORS[color], label=text)
    axes.set(xlabel="delay until the sink has the image (ms)", ylabel="cumulative share of images")
    axes.set(xlim=(0, None), ylim=(0, 1.02))
    median_ms, tail_ms = beyond_rerun_ms(run).values()
    added = added_ms(run)
    axes.set_title(
        f"The bridge adds {median_ms:.1f} ms [{added.low:.1f}, {added.high:.1f}] to the median delay\nand {tail_ms:.1f} ms to the 99th percentile (bound: {ADDED_MS:g} ms)",
        fontsize="medium",
    )
    axes.legend(loc="lower right", fontsize="small")
    count = len(taken_ms(run, "bare"))
    note(figure, f"live, on this host; {count} raw images of 640 x 360 per curve")


@exp.figure("visualisation_points", size=(10, 3.7), measured=False)
def draw_points(figure: Figure, run: Run[Config]) -> None:
    """Draw an image (left) and the 3D points from its depth (right)."""
    from matplotlib.image import imread

    grid = figure.add_gridspec(1, 2, width_ratios=[1, 1.3])
    picture = figure.add_subplot(grid[0], title="Image, registered to the depth")
    picture.imshow(imread(io.BytesIO(run.attachment(PICTURE)), "jpg"))
    picture.set_axis_off()
    cloud = np.load(io.BytesIO(run.attachment(CLOUD)))
    # As the camera sees them from a step to the side: x right, z forward, y down (REP 103).
    x, y, z = cloud["points"].T
    axes: Any = figure.add_subplot(
        grid[1], projection="3d", title=f"{len(x):,} points of the image"
    )
    axes.scatter(x, z, -y, c=cloud["colors"] / 255.0, s=1.2, linewidths=0, rasterized=True)
    axes.set_box_aspect([np.ptp(x), np.ptp(z), np.ptp(y)], zoom=1.25)
    axes.view_init(elev=18, azim=-68)
    axes.set(xlabel="x (m)", ylabel="depth (m)", zlabel="height (m)")
    axes.locator_params(nbins=4)
    errors_m = run["cloud"]["largest_error_m"]
    figure.suptitle(
        f"3D points differ from the pinhole equation by at most {1e6 * errors_m.max():.1f} µm (depth resolution: 1 mm)"
    )
    note(
        figure,
        f"closed form in double precision; largest difference in {len(errors_m)} images",
    )

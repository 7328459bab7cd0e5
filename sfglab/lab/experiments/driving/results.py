"""The module `driving.results` has claims on the node chain, the chain's time by source, and figures of laps."""

from __future__ import annotations

from dataclasses import replace
from textwrap import fill
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
import pandas as pd

from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.driving.experiment import IMAGE_TOPIC, Config, exp, load_chain
from sfglab.lab.figures import COLORS, note
from sfglab.lab.paper import paper
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, Floats, bootstrap, exactly
from sfglab.lab.workers.driving import GATEWAY, SOFTWARE
from sfglab.soc.driving import CHAIN, SHARED_TOPIC, Chain
from sfglab.soc.driving.town import LANE_M, Road

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

MAPPINGS = (SOFTWARE, GATEWAY)
ASSUMED = "model, node times assumed"
MEASURED = "model, node times measured in software"
LIVE = "live across processes"
PAPER = "paper"
#: Columns of topic A's times in the table ``chain``.
_COLUMNS = {SOFTWARE: "smt_s", GATEWAY: "gateway_s"}
_COLORS = {SOFTWARE: COLORS["standard"], GATEWAY: COLORS["proxy"]}
_RED = "#D62728"
_MS = 1e3
_STANDING_MPS = 0.02  #: Speed below which the car stands.
_FEWEST = 30  #: Smallest number of live images that a standard deviation is computed from.


@derived
def parts_ms(run: Run[Config], source: str, mapping: str) -> pd.DataFrame:
    """Return the parts of the chain's time, ms: one row per frame, one column per node and topic.

    Args:
        run: The run.
        source: `ASSUMED` takes the assumed times of nodes in hardware, `MEASURED` takes measured times of the same
            nodes in software. Both sources take the transfer times of nodes in hardware.
        mapping: Mapping of topic A: `SOFTWARE` or `GATEWAY`.
    """
    frames = run["chain"]
    assumed_s = run["node"].set_index("node")["hardware_s"]
    transfers = run["transfer"]
    others = transfers[transfers["topic"] != SHARED_TOPIC]
    topics_s = {SHARED_TOPIC: frames[_COLUMNS[mapping]], **others.set_index("topic")["mean_s"]}
    parts = {}
    for node, topic in zip(CHAIN, [*topics_s, None], strict=True):
        if source == ASSUMED and not np.isnan(assumed_s[node]):
            parts[node] = assumed_s[node] * _MS
        else:
            parts[node] = frames[f"{node}_ns"] / 1e6
        if topic is not None:
            parts[topic] = topics_s[topic] * _MS
    return pd.DataFrame(parts)


@derived
def chain_ms(run: Run[Config], source: str = ASSUMED) -> dict[str, Floats]:
    """Return the chain's times by mapping of topic A, ms.

    The sources `ASSUMED` and `MEASURED` give one time per frame. The source `LIVE` gives one time per image that
    arrived; with fewer than 30 live images per mapping the result is empty.
    """
    if source != LIVE:
        return {
            mapping: parts_ms(run, source, mapping).sum(axis=1).to_numpy() for mapping in MAPPINGS
        }
    live = run["live"].dropna()
    found = {}
    for mapping in MAPPINGS:
        found[mapping] = live.loc[live["mapping"] == mapping, "chain_s"].to_numpy(np.float64) * _MS
    return found if min(map(len, found.values())) >= _FEWEST else {}


def chain_table(run: Run[Config]) -> pd.DataFrame:
    """Return the chain's mean with its 95 % interval, and the standard deviation, by source and mapping, ms."""
    rows: list[tuple[Any, ...]] = []
    for source in (ASSUMED, MEASURED, LIVE):
        for mapping, times in chain_ms(run, source).items():
            mean = bootstrap([times], lambda drawn: float(drawn[0].mean()), unit="ms")
            rows.append((source, mapping, mean.value, mean.low, mean.high, times.std(ddof=1)))
    for mapping in MAPPINGS:
        stated = paper("C-DRIVE", f"{mapping}, mean (ms)")
        deviation = paper("C-DRIVE-DEV", f"{mapping}, deviation (ms)")
        rows.append((PAPER, mapping, stated, None, None, deviation))
    interval = ["95 % low of the mean (ms)", "95 % high of the mean (ms)"]
    return pd.DataFrame(
        rows, columns=["source", "topic A", "mean (ms)", *interval, "deviation (ms)"]
    )


def live_saving(run: Run[Config]) -> Estimate | None:
    """Return how much a gateway shortens the mean of the live chain, ms; None without the live part."""
    times = list(chain_ms(run, LIVE).values())
    if not times:
        return None
    return bootstrap(times, lambda drawn: float(drawn[0].mean() - drawn[1].mean()), unit="ms saved")


def part_table(run: Run[Config]) -> pd.DataFrame:
    """Return mean times, ms: one row per node and topic, one column per source and mapping of A."""
    means = {}
    for source in (ASSUMED, MEASURED):
        for mapping in MAPPINGS:
            means[source, mapping] = parts_ms(run, source, mapping).mean()
    return pd.DataFrame(means)


@exp.claim("C-DRIVE", how=How.SIMULATED)
def shorter_chain(run: Run[Config]) -> Finding:
    """Return the time that a gateway saves with the graph's images, and in the details for other image sizes."""
    frames = run["chain"]
    saved_ms = (frames["smt_s"] - frames["gateway_s"]).to_numpy(dtype=np.float64) * _MS
    laps = run["lap"]
    details = {"laps passed": f"{laps['passed'].sum()} of {len(laps)}"}
    for source in (ASSUMED, MEASURED):
        details[f"times as fast, {source}"] = f"{_ratio(run, source):.3g}"
    return Finding(
        estimate=bootstrap([saved_ms], lambda drawn: float(drawn[0].mean()), unit="ms saved"),
        details=details,
        reason="the time saved grows with the image, whose size the paper does not state",
        under=_other_sizes(),
    )


def _ratio(run: Run[Config], source: str) -> float:
    """Return how many times as fast the chain is with a gateway as without a gateway."""
    times = chain_ms(run, source)
    return float(times[SOFTWARE].mean() / times[GATEWAY].mean())


def _other_sizes() -> dict[str, Estimate]:
    """Return the time that a gateway saves for other image sizes than the graph's."""
    return {
        f"images of {width} x {height}": exactly(saved_ms(width, height), "ms saved")
        for width, height in ((320, 240), (800, 600))
    }


def saved_ms(width: int, height: int) -> float:
    """Return the time that a gateway saves by the model for an image size, ms: the mean over all delivery orders."""
    graph = load_chain().graph
    resized = replace(graph.topic(SHARED_TOPIC), size_bytes=3 * width * height)
    others = [topic for topic in graph.topics if topic.name != SHARED_TOPIC]
    chain = Chain(replace(graph, topics=(resized, *others)))
    return _MS * (float(np.mean(list(chain.software_s.values()))) - chain.gateway_s)


_ORDERS = "orders of magnitude less deviation"


@exp.claim("C-DRIVE-DEV", how=How.SIMULATED)
def steadier_chain(run: Run[Config]) -> Finding:
    """Return how much smaller the chain's standard deviation is with a gateway, by the model and live."""
    frames = np.column_stack(list(chain_ms(run).values()))
    estimate = bootstrap([frames], lambda drawn: orders_less(drawn[0].T), unit=_ORDERS)
    live = chain_ms(run, LIVE)
    if not live:
        skipped = run.skipped("live")
        return Finding(estimate=estimate, details={LIVE: skipped} if skipped else {})
    across = bootstrap(list(live.values()), orders_less, unit=_ORDERS)
    return Finding(
        estimate=estimate,
        details={LIVE: str(across)},
        also=How.LIVE,
        ends={
            "orders of magnitude, live across processes": across.value,
            "share of pictures that arrive, live": float(run["live"]["chain_s"].notna().mean()),
        },
        reason="the model assumes constant times of hardware nodes; between live processes the delay of the Linux "
        "scheduler remains",
    )


def orders_less(times: Sequence[Floats] | Floats) -> float:
    """Return the orders of magnitude by which the standard deviation of the second times is below that of the first."""
    software, gateway = times
    return float(np.log10(software.std(ddof=1) / gateway.std(ddof=1)))


@exp.figure("driving_chain", size=(7, 4.3))
def draw_chain(figure: Figure, run: Run[Config]) -> None:
    """Draw mean and standard deviation of the chain's time with and without a gateway, by model, live and paper."""
    axes = figure.subplots()
    table = chain_table(run)
    sources = table["source"].unique()
    for mapping, shift in ((SOFTWARE, -0.1), (GATEWAY, 0.1)):
        rows = table[table["topic A"] == mapping]
        places = np.arange(len(rows)) + shift
        style: dict[str, Any] = {"color": _COLORS[mapping], "label": f"topic A: {mapping}"}
        axes.errorbar(
            places, rows["mean (ms)"], rows["deviation (ms)"], fmt="o", capsize=4, **style
        )
    axes.set_xticks(range(len(sources)), [fill(source, 16) for source in sources])
    axes.set(ylabel="time of node chain \N{GREEK SMALL LETTER ALPHA} (ms)", ylim=(0, None))
    axes.legend(loc="lower left")
    times = chain_ms(run)
    model_ms = times[SOFTWARE].mean() - times[GATEWAY].mean()
    live = live_saving(run)
    across = (
        f"\nand {live.value:.1f} ms [{live.low:.1f}, {live.high:.1f}] across live processes"
        if live
        else ""
    )
    figure.suptitle(
        f"A gateway for topic A saves {model_ms:.1f} ms by the model{across} "
        f"(paper: {paper('C-DRIVE'):.1f} ms)"
    )
    note(
        figure,
        "chain \N{GREEK SMALL LETTER ALPHA}: compensation to lane control; model: transfer times of hardware nodes\n"
        "error bars: standard deviation",
    )


@derived
def stopped(run: Run[Config]) -> pd.DataFrame:
    """Return the rows of the track in which the car stands, after its start."""
    track = run["track"]
    return track[(track["speed_mps"] < _STANDING_MPS) & (track["t_s"] > 1.0)]


@exp.figure("driving_lap", size=(10, 4.6))
def draw_lap(figure: Figure, run: Run[Config]) -> None:
    """Draw one lap: the road, the track and the stops from above, and the camera image at the start."""
    left, right = figure.subplots(1, 2)
    _draw_map(left, run)
    _draw_first_image(right, run)
    lap = run["lap"].iloc[0]
    result = "passes" if lap["passed"] else "does not pass"
    figure.suptitle(
        f"The car drives the lap of town {lap['seed']} in {lap['lap_s']:.1f} s, stops at "
        f"{lap['red_lights_obeyed']} red lights and {result}"
    )
    note(
        figure, "simulated town and car; nodes in software; at other stop lines the light was green"
    )


def _draw_first_image(axes: Axes, run: Run[Config]) -> None:
    image = next(iter(run.messages(IMAGE_TOPIC)))
    bgr = cv2.imdecode(image.message.data, cv2.IMREAD_COLOR)
    axes.imshow(np.asarray(bgr)[:, :, ::-1])
    axes.set_axis_off()
    axes.set_title("camera image at the start")


def _draw_map(axes: Axes, run: Run[Config]) -> None:
    town = run.metadata("town")
    road = Road(np.array(town["road"]))
    for left_m, color in ((0.0, "#E6B800"), (-LANE_M, "0.5"), (LANE_M, "0.5")):
        axes.fill(*road.beside(left_m).T, fill=False, edgecolor=color)
    track = run["track"][["x_m", "y_m"]].to_numpy()
    lights = np.array(town["lights"])
    axes.plot(*track.T, color=COLORS["proxy"], label="track")
    start, ahead = track[0], track[8]
    arrow = {"arrowstyle": "-|>", "color": "black", "shrinkA": 0, "linewidth": 2}
    axes.annotate("", ahead, start, arrowprops=arrow)
    axes.annotate("start", start, (-24, 0), textcoords="offset points", ha="right", fontsize=8)
    axes.plot(lights[:, 0], lights[:, 1], "s", color="black", mfc="white", label="stop line")
    axes.plot(stopped(run)["x_m"], stopped(run)["y_m"], "o", color=_RED, label="stop of the car")
    axes.set(aspect="equal", xlabel="east (m)", ylabel="north (m)", title="lap from above")
    axes.legend(fontsize=8, loc="center")

"""Times glass to glass and to the first picture by path, the claims, Fig. 10 of paper A, and a budget to turn.

A picture is known by its number; its capture stamp is what the camera's own log says of that
number, never what a header says. The budget alone times something here and now.
"""

from __future__ import annotations

import math
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.codecs import TABLE_2, H264Decoder, H264Encoder
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiment import Look
from sfglab.lab.experiments.latency.experiment import GLASS_PATHS, Config, exp
from sfglab.lab.experiments.latency.stage import PAPERS
from sfglab.lab.figures import COLORS, PAPER_STYLE, note
from sfglab.lab.runs import Run, derived
from sfglab.lab.sources import open_source
from sfglab.lab.stats import Estimate, Floats, bootstrap, exactly, median_of, ratio_of
from sfglab.units import NS_PER_MS

if TYPE_CHECKING:
    import pandas as pd
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    _Groups = dict[str, Floats]

PAPERS_WAY, OUR_WAY = "container", "agent"


@derived
def looks(run: Run[Config]) -> pd.DataFrame:
    """Return one line a look: its row, and two times in milliseconds.

    ``first_ms`` from the order to the first picture, ``first_age_ms`` from its capture; NaN: the camera did not
    send it.
    """
    table = run["look"]
    table = table.assign(first_ms=(table["first_ns"] - table["ordered_ns"]) / NS_PER_MS)
    first = (
        run["sight"]
        .drop_duplicates("look")
        .merge(run["camera"][["number", "stamp_ns"]], on="number")
    )
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
    steady = steady[steady["path"].isin(GLASS_PATHS)].merge(
        run["camera"][["number", "stamp_ns"]], on="number"
    )
    return steady.assign(glass_ms=(steady["seen_ns"] - steady["stamp_ns"]) / NS_PER_MS)


def glass_median(run: Run[Config], path: str) -> Estimate:
    """Return the median time from capture to the viewer's hands on one of `GLASS_PATHS`, by looks' medians."""
    return median_of(look_medians(run)[path].dropna().to_numpy(), unit="ms")


def added(run: Run[Config], path: str, *, to: str = "standard") -> Estimate:
    """Return what a path adds to another one: the median difference between looks of one repetition."""
    medians = look_medians(run)
    return median_of((medians[path] - medians[to]).dropna().to_numpy(), unit="ms added")


def look_medians(run: Run[Config]) -> pd.DataFrame:
    """Return the median glass-to-glass time of each look, a line a repetition and a column a path."""
    return sights(run).pivot_table(
        index="repeat", columns="path", values="glass_ms", aggfunc="median"
    )


def _firsts(run: Run[Config]) -> pd.DataFrame:
    """Return the time to the first picture, a line a repetition and a column a path; NaN: not asked there."""
    return looks(run).pivot_table(index="repeat", columns="path", values="first_ms")


def first_mean(run: Run[Config], path: str) -> Estimate:
    """Return the mean time from the order to subscribe to the first picture in hand, on one of `PATHS`."""
    return bootstrap(
        [_firsts(run)[path].dropna().to_numpy()], lambda g: float(np.mean(g[0])), unit="ms"
    )


def first_ratio(run: Run[Config], path: str) -> Estimate:
    """Return how a path's mean time to the first picture compares with the standard one's.

    The paths of one repetition were asked at one phase of the group of pictures, so repetitions are resampled.
    """
    return ratio_of(
        _firsts(run)[[path, "standard"]].dropna().to_numpy(), np.mean, unit="times standard"
    )


def loading(run: Run[Config], path: str) -> Estimate:
    """Return what a path adds to the standard one's mean time to the first picture, within repetitions."""
    more = (_firsts(run)[path] - _firsts(run)["standard"]).dropna().to_numpy()
    return bootstrap([more], lambda g: float(np.mean(g[0])), unit="ms")


def idle_cost(run: Run[Config], label: str) -> float:
    """Return what a process at the edge takes while nobody looks, in per cent of one core."""
    return float(run["idle"].loc[run["idle"]["label"] == label, "cpu_percent"].mean())


def checks(run: Run[Config]) -> pd.DataFrame:
    """Return, per path, what proves that the viewer saw the right pictures, and present ones at first.

    ``unknown`` counts first pictures that the camera did not send, ``oldest_ms`` is the largest age of one.
    """
    by_path = looks(run).groupby("path", sort=False)
    sums = [
        "pictures",
        "unreadable",
        "missed",
        "disordered",
        "broken",
        "replay_packets",
        "replay_bytes",
    ]
    table = by_path[sums].sum()
    table["looks"] = by_path.size()
    table["unknown"] = table["looks"] - by_path["first_age_ms"].count()
    table["oldest_ms"] = by_path["first_age_ms"].max()
    return table.reset_index()


def _has_papers_way(run: Run[Config]) -> bool:
    """Return whether the paper's way was measured; logs from before it have ours alone."""
    return PAPERS_WAY in set(run["look"]["path"])


def _not_measured(unit: str) -> Finding:
    reason = "the log has no looks through a component container and by DDS"
    return Finding(estimate=exactly(math.nan, unit), reason=reason)


def _hosts(run: Run[Config]) -> dict[str, str]:
    hosts, stream = run.metadata("hosts"), run.metadata("stream")
    return {"hosts": str(hosts["description"]), "encoder": str(stream["encoder"])}


def _glass_details(run: Run[Config]) -> dict[str, str]:
    return {
        **_hosts(run),
        "standard": str(glass_median(run, "standard")),
        "pictures": str(len(sights(run))),
        "what is measured": "capture stamp to decoded pixels in the viewer's hands; no lens, no display",
    }


@exp.claim("A-G2G", how=How.LIVE)
def glass_to_glass(run: Run[Config]) -> Finding:
    """Return what the paper's way adds from capture to the viewer's hands: routers, decoder, and DDS out."""
    if not _has_papers_way(run):
        return _not_measured("ms added")
    way_out = added(run, PAPERS_WAY, to=OUR_WAY)
    details = {
        **_glass_details(run),
        "judged by": "two routers, the decoder, and DDS to the viewer",
        "by shared memory to the viewer": str(added(run, OUR_WAY)),
        "DDS in place of shared memory": str(way_out),
        "pictures lost on the way": str(checks(run).set_index("path")["missed"][PAPERS_WAY]),
    }
    reason = f"of it DDS in place of shared memory: {way_out}"
    return Finding(estimate=added(run, PAPERS_WAY), details=details, reason=reason)


@exp.claim("A-G2G-OURS", how=How.LIVE)
def glass_to_glass_ours(run: Run[Config]) -> Finding:
    """Return what our way adds: routers, decoder, and shared memory out."""
    details = {**_glass_details(run), "without routers": str(added(run, "decoder"))}
    return Finding(estimate=added(run, OUR_WAY), details=details)


@exp.claim("A-FIRST", how=How.LIVE)
def first_picture(run: Run[Config]) -> Finding:
    """Return how the time to the first picture compares with standard in the paper's way."""
    if not _has_papers_way(run):
        return _not_measured("times standard")
    standard, container, process = (first_mean(run, path) for path in ("standard", *PAPERS))
    one, new = (loading(run, path) for path in PAPERS)
    wait_ms = 500 * run.metadata("stream")["gop_s"]
    details = {
        **_hosts(run),
        "judged by": "a component container: a process that is there, libraries loaded; on demand it opens "
        "subscription, codec and publisher, waits for the next key frame, and hands pictures on by DDS",
        "in a process that is started for it": str(process),
        "in such a process, times standard": str(first_ratio(run, "on_demand")),
        "subscriptions a path": str(len(_firsts(run))),
    }
    papers_ms = PAPER_FIRST_MS[PAPERS_WAY] - PAPER_FIRST_MS["standard"]
    reason = (
        f"both wait for a key frame; loading adds {one} in a container and {new} in a new process, "
        f"{papers_ms:.0f} ms in the paper, about as a second such wait would ({wait_ms:.0f} ms)"
    )
    ends = {"on demand (ms)": container.value, "standard (ms)": standard.value}
    return Finding(estimate=first_ratio(run, PAPERS_WAY), details=details, reason=reason, ends=ends)


@exp.claim("A-FIRST-OURS", how=How.LIVE)
def first_picture_ours(run: Run[Config]) -> Finding:
    """Return how the time to the first picture compares with standard, with spare and replay."""
    air = run["idle"]["tx_mbit_s"].mean()
    agent = looks(run)[looks(run)["path"] == OUR_WAY]
    details = {
        **_hosts(run),
        "standard": str(first_mean(run, "standard")),
        "with replay, through routers": str(first_mean(run, OUR_WAY)),
        "with replay, decoder in the global domain": str(first_mean(run, "decoder")),
        "packets replayed": f"{agent['replay_packets'].mean():.1f} on average",
        "keeper, nobody looking": f"{idle_cost(run, 'keeper'):.2f} % of one core",
        "sent by the edge, nobody looking": f"{air:.3f} Mbit/s",
        "subscriptions a path": str(len(_firsts(run))),
    }
    return Finding(estimate=first_ratio(run, OUR_WAY), details=details)


PAPER_ADDED_MS = 2.6
PAPER_FIRST_MS = {"standard": 570.0, "container": 1095.0}  #: Paper A, section 5.4.

GLASS_LABELS = {
    "standard": "standard:\neach decodes",
    "container": "paper's way:\nrouters, decoder,\nDDS out",
    "agent": "ours: shared\nmemory out",
    "decoder": "ours without\nrouters",
}
FIRST_LABELS = {
    "standard": "standard,\nno decoder",
    "container": "paper's way:\ncomponent\ncontainer",
    "on_demand": "paper's way in\na new process",
    "agent": "ours: spare\nand replay",
}
BAR_COLORS = {
    "standard": COLORS["standard"],
    "container": COLORS["third"],
    "on_demand": COLORS["third"],
    "agent": COLORS["proxy"],
    "decoder": COLORS["network"],
}


@exp.figure("latency", size=(11.6, 4.4))
def draw_latency(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw glass-to-glass times (left) and times to the first picture (right)."""
    glass, first = figure.subplots(1, 2)
    _draw_glass(glass, run)
    _draw_first(first, run)
    said = [
        f"{name} adds {more.value:.1f} ms [{more.low:.1f}, {more.high:.1f}]; first picture after "
        f"{first_ratio(run, path).value:.2g} times standard's wait"
        for name, path in (("The paper's way", PAPERS_WAY), ("Ours", OUR_WAY))
        if path in _firsts(run) and (more := added(run, path))
    ]
    figure.suptitle("\n".join(said), fontsize=11)
    note(
        figure,
        "a dot: a look; bars: median (left), mean (right); lines: the middle two thirds",
        run,
    )
    return _twin(run)


def _draw_glass(axes: Axes, run: Run[Config]) -> None:
    """Draw the time from capture to the viewer's hands, a dot a look, and the paper's addition."""
    medians = look_medians(run)
    groups = {path: medians[path].dropna().to_numpy() for path in GLASS_LABELS if path in medians}
    heights = {path: glass_median(run, path).value for path in groups}
    paper = heights["standard"] + PAPER_ADDED_MS
    _bars(axes, GLASS_LABELS, heights, groups, {PAPERS_WAY: f"(paper: +{PAPER_ADDED_MS})"})
    _paper_lines(axes, groups, {PAPERS_WAY: paper})
    _limit(axes, groups, paper)
    axes.set_ylabel("capture to picture in hand (ms)")
    axes.set_title(
        "glass to glass, without lens and display (paper, with both: 118.3 ms)", fontsize=9
    )


def _draw_first(axes: Axes, run: Run[Config]) -> None:
    """Draw the time from the order to subscribe to the first picture, a dot a subscription."""
    by_path = {path: group["first_ms"].to_numpy() for path, group in looks(run).groupby("path")}
    groups = {path: by_path[path] for path in FIRST_LABELS if path in by_path}
    said = {path: f"(paper: {paper_ms:.0f})" for path, paper_ms in PAPER_FIRST_MS.items()}
    _bars(
        axes,
        FIRST_LABELS,
        {path: float(group.mean()) for path, group in groups.items()},
        groups,
        said,
    )
    _paper_lines(axes, groups, PAPER_FIRST_MS)
    _limit(axes, groups, max(PAPER_FIRST_MS.values()))
    axes.set_ylabel("order to first picture (ms)")
    axes.set_title("first picture after a subscription", fontsize=9)


def _bars(
    axes: Axes,
    labels: dict[str, str],
    heights: dict[str, float],
    groups: _Groups,
    said: dict[str, str],
) -> None:
    """Draw one bar a path, its samples beside its middle, the range of two thirds of them, and what is said."""
    for position, (path, group) in enumerate(groups.items()):
        height = heights[path]
        # The paper draws one standard deviation; this is the same where samples are normal, and does not follow
        # the one look in which the machine was busy elsewhere.
        low, high = np.percentile(group, (16, 84))
        axes.bar(position, height, color=BAR_COLORS[path], width=0.5)
        spread = [[max(height - low, 0)], [max(high - height, 0)]]
        axes.errorbar(position, height, yerr=spread, color="black", capsize=4)
        spots = position + np.linspace(-0.25, 0.25, len(group))
        axes.plot(spots, group, ".", color="black", markersize=3, alpha=0.4)
    values = {path: f"{height:.{1 if height < 20 else 0}f} ms" for path, height in heights.items()}
    names = [
        f"{labels[p]}\n{values[p]} (n = {len(groups[p])})\n{said.get(p, '')}".rstrip()
        for p in groups
    ]
    axes.set_xticks(range(len(groups)), names)
    axes.grid(visible=False, axis="x")


def _limit(axes: Axes, groups: _Groups, shown: float) -> None:
    """End the axis above nine tenths of each group; what lies beyond is marked at the edge with its value."""
    top = 1.3 * max(shown, *(float(np.percentile(group, 90)) for group in groups.values()))
    axes.set_ylim(0, top)
    for position, group in enumerate(groups.values()):
        beyond = sorted(group[group > top])
        if beyond:
            axes.plot(position, 0.98 * top, "^", color="black", markersize=4, alpha=0.6)
            values = ", ".join(f"{value:.0f}" for value in beyond)
            axes.annotate(values, (position + 0.06, 0.98 * top), va="center", fontsize=7)


def _paper_lines(axes: Axes, groups: _Groups, heights: dict[str, float]) -> None:
    shown = {place: heights[path] for place, path in enumerate(groups) if path in heights}
    spots, style = np.array([*shown]), {**PAPER_STYLE, "color": "black", "label": "paper A, 5.4"}
    axes.hlines([*shown.values()], spots - 0.38, spots + 0.38, **style)
    axes.legend(fontsize=8.5, loc="upper right")


def _twin(run: Run[Config]) -> dict[str, Any]:
    glass, first = look_medians(run).columns, _firsts(run).columns
    return {
        **{f"glass_{path}": glass_median(run, path) for path in glass},
        **{f"added_{path}": added(run, path) for path in glass if path != "standard"},
        **{f"first_{path}": first_mean(run, path) for path in first},
        **{f"first_ratio_{path}": first_ratio(run, path) for path in first if path != "standard"},
    }


_CODED = 30
_STAGES = {"encoding": "third", "network": "network", "decoding": "standard"}


@exp.look(
    "budget",
    Look(
        turn=("gop", "bitrate_mbit_s", "link_mbit_s"),
        needs=(),
        size=(10, 3.6),
        start={"encoder": "libx264"},  # finding the best one takes seconds
        reference="latency",
    ),
)
def draw_budget(figure: Figure, run: Run[Config]) -> None:
    """Draw where the milliseconds go: coding is timed here and now, the rest follows from rates.

    Until the first picture, *standard* waits for the next key frame; with the sender's replay the pictures
    since the last one are sent and decoded at once.
    """
    config = run.config
    size_bytes, encoding_ms, decoding_ms = _coded(config)
    sending_ms = 8e-3 * size_bytes / config.link_mbit_s
    glass, first = figure.subplots(1, 2)
    left = 0.0
    for (stage, color), taken in zip(
        _STAGES.items(), (encoding_ms, sending_ms, decoding_ms), strict=True
    ):
        glass.barh(
            "a picture", taken, left=left, color=COLORS[color], label=f"{stage} {taken:.1f} ms"
        )
        left += taken
    glass.set(xlabel="time (ms)", ylim=(-0.6, 1.2), title=f"capture to pixels: {left:.1f} ms")
    glass.legend(fontsize=8)
    since = np.arange(config.gop)
    ways = {
        "standard": (config.gop - since) * 1e3 / TABLE_2.fps + sending_ms + decoding_ms,
        "agent": (since + 1) * (sending_ms + decoding_ms),
    }
    for path, label in (("standard", "waits for a key frame"), ("agent", "with replay")):
        named = f"{label}: {ways[path].mean():.0f} ms on average"
        first.plot(since, ways[path], ".-", color=BAR_COLORS[path], label=named)
    first.set(
        xlabel="frames since the last key frame", ylabel="first picture after (ms)", ylim=(0, None)
    )
    first.legend(fontsize=8)
    figure.suptitle(
        "A budget: coding timed on this machine, the rest computed; without waits for processes"
    )


def _coded(config: Config) -> tuple[float, float, float]:
    """Return the mean size of a picture, bytes, and the median times to encode and to decode it, ms."""
    bitrate_bps = round(config.bitrate_mbit_s * 1e6)
    encoder = H264Encoder(
        replace(TABLE_2, bitrate_bps=bitrate_bps, gop=config.gop, encoder=config.encoder)
    )
    decoder, source = H264Decoder(), open_source(config.source, seed=config.seed)
    rows = []
    for _ in range(_CODED):
        picture = source.frame().bgr
        started = time.perf_counter_ns()
        packets = encoder.encode(picture)
        encoded = time.perf_counter_ns()
        for packet in packets:
            decoder.decode_bgr(packet.data)
        size = sum(len(packet.data) for packet in packets)
        rows.append(
            (size, (encoded - started) / NS_PER_MS, (time.perf_counter_ns() - encoded) / NS_PER_MS)
        )
    source.close()
    sizes, encoding, decoding = np.array(rows).T
    return float(sizes.mean()), float(np.median(encoding)), float(np.median(decoding))

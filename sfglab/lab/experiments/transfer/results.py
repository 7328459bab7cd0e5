"""The module `transfer.results` has the claims, figures and the explorer of transfer times.

Fig. 6 and 7 have four panels, one per side of the publisher and side of the subscriber. In each panel the speed-up
of a gateway is the transfer time over a software-mapped topic divided by the transfer time through the gateway.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
import pandas as pd

from sfglab.fields import Bounds
from sfglab.lab import pictures
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.transfer.experiment import MODEL, RTL, Config, exp
from sfglab.lab.figures import COLORS, bytes_axis, lines, note, paper_line
from sfglab.lab.paper import paper
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import Estimate, exactly, paired_ratios
from sfglab.soc.memory import FITTED, STORED
from sfglab.soc.paper_values import MESSAGE_BYTES, STATED, SUBSCRIBERS, Panel, SpeedUp, speed_ups
from sfglab.soc.prediction import predictions
from sfglab.tables import field_rows

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

SMALL, LARGE = MESSAGE_BYTES[0], MESSAGE_BYTES[-1]
MANY = SUBSCRIBERS[-1]
_FAST = "times as fast"
_MS_PER_S = 1e3
_MS_PER_NS = 1e-6


# --- Tables -----------------------------------------------------------------------------------


@derived
def bars(run: Run[Config], model: str = MODEL) -> pd.DataFrame:
    """Return the bars of the memory model, or of simulated hardware, with three more columns.

    ``ratio`` is the gateway's speed-up; ``smt_ms`` and ``gateway_ms`` are the times, ms.
    """
    table = run["bar"]
    chosen = table[table["model"] == model]
    return chosen.assign(
        ratio=chosen["smt_s"] / chosen["gateway_s"],
        smt_ms=_MS_PER_S * chosen["smt_s"],
        gateway_ms=_MS_PER_S * chosen["gateway_s"],
    )


def ratios_of(run: Run[Config], panel: Panel, model: str = MODEL) -> dict[tuple[int, int], float]:
    """Return the speed-ups of a panel by message size and number of subscribers."""
    table = bars(run, model)
    chosen = table[table["panel"] == panel.value]
    return {(bar.message_bytes, bar.subscribers): bar.ratio for bar in lines_of(chosen)}


def by_size(table: pd.DataFrame, panel: Panel, value: str = "ratio") -> pd.DataFrame:
    """Return a column of a panel's bars, one row per message size and one column per number of subscribers."""
    chosen = table[table["panel"] == panel.value]
    return chosen.pivot_table(index="message_bytes", columns="subscribers", values=value)


@derived
def live_bars(run: Run[Config]) -> pd.DataFrame:
    """Return the live medians, the live speed-up with its interval, and the model's speed-up, one row per bar."""
    pairs = paired_ratios(
        run["crossing"],
        by=["publisher", "subscribers", "message_bytes"],
        pair="transport",
        order=("smt", "gateway"),
        values=["hardware_ns", "software_ns"],
    )
    panels = pairs["publisher"] + " to " + pairs["value"].str.removesuffix("_ns")
    table = pairs.assign(
        panel=panels,
        smt_ms=_MS_PER_NS * pairs["smt"],
        gateway_ms=_MS_PER_NS * pairs["gateway"],
    )
    key = ["panel", "subscribers", "message_bytes"]
    model = bars(run)[[*key, "ratio"]].rename(columns={"ratio": "model"})
    columns = [*key, "smt_ms", "gateway_ms", "ratio", "low", "high", "model", "repeats"]
    return table.merge(model, on=key, how="left")[columns]


@derived
def stated(run: Run[Config]) -> pd.DataFrame:
    """Return the stated numbers of section 4, the model's values, and the predictions from the other numbers."""
    numbers = [paper(one.claim, one.number) for one in STATED]
    rows = []
    for one, number, prediction in zip(STATED, numbers, predictions(numbers), strict=True):
        row = {
            "panel": one.panel.value,
            "claim": one.claim,
            "unit": "times as slow" if one.slower else _FAST,
            "bar": one.bar,
            "paper": number,
            "model": one.by(ratios_of(run, one.panel)),
            "predicted": prediction.value,
            "low": prediction.low,
            "high": prediction.high,
        }
        rows.append(row)
    return pd.DataFrame(rows)


def worst_fit(run: Run[Config]) -> float:
    """Return the largest relative difference, without sign, between the model and the stated numbers."""
    table = stated(run)
    return float((table["model"] / table["paper"] - 1).abs().max())


def prediction_table(run: Run[Config]) -> pd.DataFrame:
    """Return the stated numbers and their predictions as a notebook shows them."""
    names = {"unit": "ratio of times", "bar": "point", "low": "95 % low", "high": "95 % high"}
    ratios = {_FAST: "topic / gateway", "times as slow": "gateway / topic"}
    points = {"lowest": "lowest speed-up", "highest": "highest speed-up"}
    return stated(run).replace({"unit": ratios, "bar": points}).rename(columns=names)


_UNITS = {
    "_s_per_byte": (" per byte", 1e9, "ns/B"),
    "_s": ("", 1e6, "µs"),
    "_hz": ("", 1e-6, "MHz"),
    "_cycles": ("", 1, "cycles"),
    "_bytes": ("", 1, "B"),
}
"""End of a constant's label, factor and unit of its value, by the end of its name."""


def constants() -> pd.DataFrame:
    """Return the constants of the memory model with their values, meanings and origins."""
    rows = []
    for name, value, meaning in field_rows(STORED)[1:]:
        suffix = next(end for end in _UNITS if name.endswith(end))
        label_end, factor, unit = _UNITS[suffix]
        label = name.removesuffix(suffix).replace("_", " ") + label_end
        # The table has another unit than the field.
        text = meaning.replace(", s.", ".").replace(", Hz.", ".")
        rows.append((label, f"{factor * float(value):.4g} {unit}", text))
    return pd.DataFrame(rows, columns=["constant", "value", "meaning"])


# --- Claims -----------------------------------------------------------------------------------


@exp.claim("C-HWHW", how=How.SIMULATED)
def hardware_to_hardware(run: Run[Config]) -> Finding:
    """Return the speed-up with 8 hardware subscribers at 10 MB; the other end is the speed-up at 10 kB."""
    ratios = ratios_of(run, Panel.HARDWARE_TO_HARDWARE)
    return Finding(
        estimate=exactly(ratios[LARGE, MANY], f"{_FAST} at 10 MB"),
        ends={f"{_FAST} at 10 kB": ratios[SMALL, MANY]},
        **evidence(run, Panel.HARDWARE_TO_HARDWARE, LARGE, MANY),
    )


@exp.claim("C-HWSW", how=How.SIMULATED)
def hardware_to_software(run: Run[Config]) -> Finding:
    """Return the largest slow-down at 10 kB; the other end is the speed-up at 10 MB, 8 subscribers."""
    ratios = ratios_of(run, Panel.HARDWARE_TO_SOFTWARE)
    count = min(SUBSCRIBERS, key=lambda count: ratios[SMALL, count])
    return Finding(
        estimate=exactly(1 / ratios[SMALL, count], "times as slow at 10 kB"),
        ends={f"{_FAST} at 10 MB, 8 nodes": ratios[LARGE, MANY]},
        **evidence(run, Panel.HARDWARE_TO_SOFTWARE, SMALL, count),
    )


@exp.claim("C-SWHW", how=How.SIMULATED)
def software_to_hardware(run: Run[Config]) -> Finding:
    """Return the largest speed-up of all bars; the other end is the largest speed-up at 10 kB."""
    ratios = ratios_of(run, Panel.SOFTWARE_TO_HARDWARE)
    size, count = max(ratios, key=lambda bar: ratios[bar])
    return Finding(
        estimate=exactly(ratios[size, count], f"{_FAST} at 10 MB"),
        ends={"largest at 10 kB": max(ratios[SMALL, count] for count in SUBSCRIBERS)},
        **evidence(run, Panel.SOFTWARE_TO_HARDWARE, size, count),
    )


@exp.claim("C-SWSW", how=How.SIMULATED)
def software_to_software(run: Run[Config]) -> Finding:
    """Return the largest speed-up; the other end is the smallest speed-up."""
    ratios = ratios_of(run, Panel.SOFTWARE_TO_SOFTWARE)
    size, count = max(ratios, key=lambda bar: ratios[bar])
    return Finding(
        estimate=exactly(ratios[size, count], f"{_FAST}, largest"),
        ends={f"{_FAST}, least": min(ratios.values())},
        **evidence(run, Panel.SOFTWARE_TO_SOFTWARE, size, count),
    )


def evidence(run: Run[Config], panel: Panel, size: int, count: int) -> dict[str, Any]:
    """Return the details of a claim about one bar of a panel, and how its numbers were fitted."""
    predicted = []
    for row in lines_of(stated(run)[stated(run)["panel"] == panel.value]):
        interval = f"[{row.low:.3g}, {row.high:.3g}]"
        predicted.append(f"{row.predicted:.3g} {interval} for {row.paper:g} {row.unit}")
    fitted = (
        f"{len(FITTED)} constants to {len(STATED)} stated numbers, so their agreement shows only that "
        f"the numbers are consistent under the model; out of sample: {', '.join(predicted)}"
    )
    by_rtl = ratios_of(run, panel, RTL).get((size, count))
    skipped = run.metadata("missing").get("rtl", "not simulated")
    rtl = f"{by_rtl:.3f} {_FAST}" if by_rtl else str(skipped)
    details = {"RTL": rtl, "live": live_detail(run, panel, size, count)}
    return {"details": details, "fitted": fitted}


def live_detail(run: Run[Config], panel: Panel, size: int, count: int) -> str:
    """Return the live speed-up of a bar with its interval, as a text."""
    place = f"panel == '{panel.value}' and message_bytes == {size} and subscribers == {count}"
    found = lines_of(live_bars(run).query(place))
    if not found:
        return "this case was not measured"
    [bar] = found
    speed_up = Estimate(value=bar.ratio, low=bar.low, high=bar.high, unit=_FAST)
    return f"{speed_up}, {count} hardware subscribers, {size} B; {bar.repeats} repetitions"


# --- Figures ----------------------------------------------------------------------------------

STYLES: dict[int, dict[str, Any]] = {
    2: {"color": "0.62", "marker": "o"},
    4: {"color": "0.38", "marker": "s"},
    8: {"color": "0.1", "marker": "^"},
}
"""Properties of lines by number of hardware subscribers. Only the paper's numbers have dashed lines."""
TOPICS = {
    "smt": ("software-mapped topic", COLORS["standard"]),
    "gateway": ("gateway", COLORS["proxy"]),
}
"""Labels and colours by kind of topic."""
_RATIO_TICKS = (0.125, 0.25, 0.5, 1, 2, 4, 8, 16, 32)


@exp.figure("transfer", size=(10, 6.2), measured=False)
def draw_transfer(figure: Figure, run: Run[Config]) -> None:
    """Draw the model's transfer times and speed-ups over the message size (Fig. 6, 7), one column per panel."""
    for ratios, panel in draw_panels(figure, bars(run)):
        lines(ratios, by_size(bars(run), panel), STYLES, markersize=4)
        rtl = by_size(bars(run, RTL), panel)
        lines(ratios, rtl, STYLES, markersize=9, mfc="none", linestyle="")
        draw_stated(ratios, panel)
        ratios.set_ylim(0.3, 16)
    title = (
        "By the fitted model a gateway is slower only from hardware to software, and with small "
        "messages\nfrom software to hardware "
        f"(the paper's seven numbers within {math.ceil(100 * worst_fit(run))} %)"
    )
    figure.suptitle(title)
    note(
        figure,
        f"memory model with {len(FITTED)} constants fitted to the dashed numbers of the paper; "
        "hollow: with the cycles of simulated hardware (RTL)\n"
        "titles: publisher to subscribers; above, the gateway's curves for 2, 4 and 8 hardware nodes are equal",
    )


def draw_stated(axes: Axes, panel: Panel) -> None:
    """Draw the paper's speed-ups of a panel, with a number at each line where the curves leave room."""
    stated_ratios = []
    for one in STATED:
        if one.panel is panel:
            number = paper(one.claim, one.number)
            stated_ratios.append(1 / number if one.slower else number)
    for value in stated_ratios:
        is_largest = value == max(stated_ratios)
        paper_line(axes, value, at=0.55 if is_largest else 1, below=not is_largest)


@exp.figure("transfer_live", size=(10, 6.2), when=lambda run: not run["crossing"].empty)
def draw_live(figure: Figure, run: Run[Config]) -> None:
    """Draw measured transfer times and speed-ups between processes over the message size, one column per panel."""
    table = live_bars(run)
    for ratios, panel in draw_panels(figure, table):
        chosen = table[table["panel"] == panel.value]
        for place, count in enumerate(sorted(set(chosen["subscribers"]))):
            found = chosen[chosen["subscribers"] == count]
            # The intervals for several numbers of subscribers are beside each other.
            sizes = found["message_bytes"] * 1.15 ** (place - 1)
            style = STYLES.get(count, {})
            ratios.plot(sizes, found["ratio"], markersize=5, **style)
            ratios.vlines(sizes, found["low"], found["high"], color=style.get("color"))
        model = by_size(table, panel, "model")
        lines(ratios, model, STYLES, linestyle=":", marker="")
    decided = table[(table["low"] > 1) | (table["high"] < 1)]
    same = (decided["ratio"] > 1) == (decided["model"] > 1)
    title = (
        f"Between live processes {same.sum()} of {len(table)} speed-ups are on the model's side of 1, "
        f"{len(decided) - same.sum()} on the other"
    )
    figure.suptitle(title)
    note(
        figure,
        "measured live, medians; error bars: 95 % CI; dotted: speed-ups by the model\n"
        f"titles: publisher to subscribers; {len(table) - len(decided)} intervals include 1",
    )


def draw_panels(figure: Figure, table: pd.DataFrame) -> list[tuple[Axes, Panel]]:
    """Draw the transfer times of each panel with one legend, and return the axes of the speed-ups."""
    grid = figure.subplots(2, len(Panel), sharex=True, sharey="row")
    for times, ratios, panel in zip(*grid, Panel, strict=True):
        for topic, (_, color) in TOPICS.items():
            lines(times, by_size(table, panel, f"{topic}_ms"), STYLES, color=color, markersize=4)
        times.set(title=panel.value, yscale="log")
        bytes_axis(ratios)
        ratios.set_yscale("log", base=2)
        ratios.axhline(1, color="black", linewidth=0.8)
        ratios.set_yticks(_RATIO_TICKS, [f"{tick:g}" for tick in _RATIO_TICKS])
    for label, color in TOPICS.values():
        grid[0, -1].plot([], [], color=color, label=label)
    for count in sorted(set(table["subscribers"])):
        grid[0, -1].plot([], [], label=f"{count} hardware nodes", **STYLES.get(count, {}))
    grid[0, -1].legend(loc="upper left", fontsize=8)
    grid[0, 0].set_ylabel("transfer time (ms)")
    grid[1, 0].set_ylabel("speed-up by the gateway (times)")
    return list(zip(grid[1], Panel, strict=True))


# --- Explorer ---------------------------------------------------------------------------------

Size = Annotated[int, Bounds(256, 100_000_000, log=True)]
Count = Annotated[int, Bounds(1, 16)]
Cycles = Annotated[float, Bounds(1, 300, log=True)]
Microseconds = Annotated[float, Bounds(10, 2000, log=True)]

SIZES_BYTES = np.geomspace(256, 100_000_000, 29).astype(int).tolist()
"""Message sizes of the curves."""
_SIZE = pictures.Axis("message size", "B", 256, 1e8, log=True, ticks=(1e3, 1e5, 1e7), si=True)
_TIME = pictures.Axis("transfer time", "ms", 0.01, 3e4, log=True, ticks=(0.01, 1, 100, 1e4))
_DELEGATE_US = round(1e6 * STORED.delegate_s, 2)


@exp.explorer
def transfer_curves(
    *,
    message_bytes: Size = 1_000_000,
    subscribers: Count = 4,
    read_latency_cycles: Cycles = STORED.read_latency_cycles,
    delegate_us: Microseconds = _DELEGATE_US,
) -> pictures.Picture:
    """Return transfer times over message sizes, and the gateway's speed-up at the size of the dots.

    Args:
        message_bytes: Message size of the dots [B].
        subscribers: Number of hardware subscribers.
        read_latency_cycles: Latency from a read request to its first word [cycles].
        delegate_us: Round trip to a delegate [µs].
    """
    all_sizes = [*SIZES_BYTES, message_bytes]
    costs = replace(STORED, read_latency_cycles=read_latency_cycles, delegate_s=delegate_us / 1e6)
    computed = speed_ups(costs, subscribers=[subscribers], sizes_bytes=all_sizes)
    panels = [_curves(panel, computed) for panel in Panel]
    said = (
        f"Transfer times to {subscribers} hardware subscribers and one in software. "
        f"Dots: messages of {message_bytes:,} B."
    )
    return pictures.Picture(said=said, panels=tuple(panels))


def _curves(panel: Panel, computed: list[SpeedUp]) -> pictures.Panel:
    """Return the curves of a panel; the last value of the panel has the message size of the dots."""
    chosen = [one for one in computed if one.panel is panel]
    here = chosen[-1]
    series: list[pictures.Series] = []
    for topic, (name, color) in TOPICS.items():
        times_ms = [_MS_PER_S * getattr(one, f"{topic}_s") for one in chosen]
        series += pictures.curve(name, color, [one.message_bytes for one in chosen], times_ms)
    return pictures.Panel(
        title=panel.value,
        x=_SIZE,
        y=_TIME,
        series=tuple(series),
        note=f"speed-up: {here.ratio:.2f}",
    )

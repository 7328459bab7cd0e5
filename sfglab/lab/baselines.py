"""Baselines of real ROS 2: an experiment's rows of it beside ours, their table, their figure, raw images.

Measured in a part of their own, `PART`, which is skipped with its reason where there is no ROS 2. Run alone, it
makes a log that counts beside a reference log, instead of its own part: ``x_ros2.mcap`` beside ``x.mcap``.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.bus.address import BusAddress
from sfglab.codecs import COMPRESSED_IMAGE
from sfglab.lab.experiment import Experiment, SkippedPartError
from sfglab.lab.figures import note, series
from sfglab.lab.meters import measure
from sfglab.lab.ros2 import RosMember
from sfglab.lab.stats import bootstrap
from sfglab.lab.streams import FIRST_PICTURE_S, GLOBAL_DOMAIN
from sfglab.lab.workers.viewer import ViewerConfig
from sfglab.processes import Member, ProcessGroup
from sfglab.units import NS_PER_MS, NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    from matplotlib.figure import Figure

    from sfglab.lab.bench import Bench
    from sfglab.lab.runs import Run
    from sfglab.lab.testbed import Testbed

PART = "ros2"
REAL, STAND_IN = "standard ROS 2", "stand-in"
_STYLES = ("standard", "proxy", "third", "fourth")


@dataclass(frozen=True, slots=True, kw_only=True)
class BesideRow:
    """One figure of real ROS 2, or of what stands for it or beside it here."""

    setting: str  #: What was measured, the same for both sides.
    quantity: str  #: Which figure, with its unit.
    kind: str  #: Whose: `REAL`, or which of ours.
    repeat: int  #: Which repetition.
    value: float  #: The figure.


def beside(exp: Experiment[Any], run: Run[Any], table: str = PART) -> pd.DataFrame:
    """Return a run's rows, of which those that were measured apart, if they were, are the newer ones."""
    apart = apart_of(run)
    return (exp.load(apart) if apart.is_file() else run)[table]


def apart_of(run: Run[Any]) -> Path:
    """Return where the log is that was measured apart from a run, if there is one."""
    return run.log.with_name(f"{run.log.stem}_{PART}.mcap")


def compared(exp: Experiment[Any], run: Run[Any]) -> pd.DataFrame:
    """Return medians of real ROS 2 and its stand-in, and their ratio over resampled repetitions, by setting."""
    rows = (
        beside(exp, run)
        .groupby(["quantity", "setting", "kind", "repeat"], sort=False)["value"]
        .median()
    )
    lines = []
    for (quantity, setting), values in rows.groupby(["quantity", "setting"], sort=False):
        by_kind = {kind: group.to_numpy() for kind, group in values.groupby("kind")}
        if {REAL, STAND_IN} <= by_kind.keys():
            pair = [by_kind[STAND_IN], by_kind[REAL]]
            stand_in, real = map(float, map(np.median, pair))
            line = {"quantity": quantity, "setting": setting, REAL: real, STAND_IN: stand_in}
            if real > 0:
                ratio = bootstrap(
                    pair, lambda g: float(np.median(g[0]) / np.median(g[1])), unit="times ROS 2"
                )
            lines.append(line | {"ratio": str(ratio) if real > 0 else ""})
    return pd.DataFrame(lines)


def declare(exp: Experiment[Any], title: str) -> None:
    """Declare an experiment's table and figure of real ROS 2 beside ours."""
    exp.table(PART)(BesideRow)

    @exp.figure(f"{exp.name}_{PART}", size=(11.5, 3.6), when=lambda run: not beside(exp, run).empty)
    def draw(figure: Figure, run: Run[Any]) -> dict[str, Any]:
        """Draw real ROS 2 beside ours over the settings, a dot a measurement and a line at each median."""
        rows = beside(exp, run)
        _draw(figure, rows)
        figure.suptitle(title)
        note(
            figure, f"a dot: a measurement, repetitions: {rows['repeat'].nunique()}; lines: medians"
        )
        return {
            "apart": apart_of(run).name if apart_of(run).is_file() else "",
            "compared": compared(exp, run),
        }


def _draw(figure: Figure, rows: pd.DataFrame) -> None:
    quantities, settings = list(rows["quantity"].unique()), sorted(rows["setting"].unique())
    kinds = sorted(rows["kind"].unique(), key=lambda kind: (not kind.startswith(REAL), kind))
    for axes, quantity in zip(
        figure.subplots(1, len(quantities), squeeze=False)[0], quantities, strict=True
    ):
        for place, kind in enumerate(kinds):
            style = series(_STYLES[place])
            axes.plot([], [], linestyle="", label=kind, **style)
            of_kind = rows[(rows["quantity"] == quantity) & (rows["kind"] == kind)]
            for setting, values in of_kind.groupby("setting")["value"]:
                at = settings.index(setting) + 0.2 * (place - (len(kinds) - 1) / 2)
                axes.plot(
                    [at] * len(values), values, linestyle="", markersize=4, alpha=0.6, **style
                )
                axes.hlines(
                    values.median(), at - 0.08, at + 0.08, color=style["color"], linewidth=2
                )
        axes.set_xticks(range(len(settings)), settings)
        if len(settings) > 5:
            axes.tick_params(axis="x", labelrotation=60, labelsize=8)
        highest = rows.loc[rows["quantity"] == quantity, "value"].max()
        axes.set(xlim=(-0.5, len(settings) - 0.5), ylim=(0, 1.1 * highest or 1.0))
        axes.set_title(quantity, fontsize=9)
    figure.legend(
        *figure.axes[0].get_legend_handles_labels(), loc="outside lower right", ncols=len(kinds)
    )


def peer_on(testbed: Testbed, host: str, name: str, *arguments: str) -> RosMember:
    """Return a member that is a peer of the first distribution that is there, with its arguments.

    Raises:
        RosMissingError: None is.
        SkippedPartError: Hosts are not separate.
    """
    if not testbed.separate:
        raise SkippedPartError(
            "needs network namespaces: real ROS 2 would meet whoever else is on this network"
        )
    return RosMember(name=name, host=host, config=arguments)


# --- Raw images -----------------------------------------------------------------------------------------------

_TOPIC = "/camera_front/image_raw"
_PICTURE = {"width": 640, "height": 360, "hz": 30.0}


class _RawStream(ProcessGroup):
    """A camera of rclpy at the edge, and at the consumer viewers of rclpy and of ours."""

    def __init__(self, testbed: Testbed, most: int) -> None:
        config = ViewerConfig(
            remote=BusAddress(domain_id=GLOBAL_DOMAIN, interface=testbed.interface("consumer")),
            local=BusAddress(domain_id=GLOBAL_DOMAIN + 1, interface="lo"),
            remote_topic=_TOPIC,
            remote_type=COMPRESSED_IMAGE,
            codec="",
            local_topic=_TOPIC,
            joined=True,
        )
        ours: dict[str, Any] = {
            "host": "consumer",
            "module": "sfglab.lab.workers.viewer",
            "config": config,
        }
        members: list[Member] = [peer_on(testbed, "edge", "camera", "camera")]
        members += [peer_on(testbed, "consumer", f"{REAL} {i}", f"viewer_{i}") for i in range(most)]
        members += [Member(name=f"{STAND_IN} {i}", **ours) for i in range(most)]
        super().__init__(members, wrap_command=testbed.argv)

    async def settle(self) -> None:
        """Start the camera."""
        await self.ask(
            "shooting", ["camera"], timeout_s=FIRST_PICTURE_S, do="shoot", topic=_TOPIC, **_PICTURE
        )

    async def look(self, kind: str, count: int, look_s: float) -> dict[str, list[float]]:
        """Let so many viewers of a kind look, and return what was measured by quantity."""
        names = [f"{kind} {i}" for i in range(count)]
        order = {"do": "look", "mode": "raw", "topic": _TOPIC}
        firsts = await self.ask("first", names, timeout_s=FIRST_PICTURE_S, **order)
        (reading,) = await measure(
            look_s, look_s, cpu={"viewers": [self[name].pid for name in names]}
        )
        seen = (await self.ask("seen", names, timeout_s=FIRST_PICTURE_S, do="stop")).values()
        now_ns = time.time_ns()
        sent = sum(
            1 + _PICTURE["hz"] * (now_ns - first["seen_ns"]) / NS_PER_S for first in firsts.values()
        )
        return {
            "first picture (ms)": [
                (r["seen_ns"] - r["ordered_ns"]) / NS_PER_MS for r in firsts.values()
            ],
            "capture to picture in hand (ms)": [
                float(np.median(r["ages_ns"])) / NS_PER_MS for r in seen
            ],
            "CPU of a subscriber (% of a core)": [(reading.cpu_percent or 0.0) / count],
            "pictures received (%)": [100 * sum(r["frames"] for r in seen) / sent],
        }


async def measure_raw(
    bench: Bench[Any],
    quantities: Sequence[str],
    *,
    counts: Sequence[int],
    repeats: int,
    look_s: float,
) -> None:
    """Measure some quantities of raw images' subscribers, rclpy's beside ours in random order.

    Raises:
        SkippedPartError: No look was asked for.
    """
    if not counts or not repeats:
        raise SkippedPartError("ros2: none was asked for")
    rng = np.random.default_rng(bench.config.seed)
    async with _RawStream(bench.testbed, max(counts)) as stream:
        for kind in (REAL, STAND_IN):
            await stream.look(
                kind, 1, 0.2
            )  # unmeasured: what only the first time costs is not asked
        for repeat in range(repeats):
            for count in counts:
                for kind in map(str, rng.permutation([REAL, STAND_IN])):
                    found = await stream.look(kind, count, look_s)
                    row = {"setting": f"{count}", "kind": kind, "repeat": repeat}
                    for name in quantities:
                        bench.write_all(
                            PART, (row | {"quantity": name, "value": v} for v in found[name])
                        )
                    bench.advance(f"{kind} {count}")

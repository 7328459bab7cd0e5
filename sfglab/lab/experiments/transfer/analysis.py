"""Bars, residuals, speed-ups across processes, and the claims on Fig. 6 and 7 with what they are worth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.transfer.experiment import Config, exp
from sfglab.lab.experiments.transfer.stage import IN, OUT, READS, WRITE
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, exactly, ratio_of
from sfglab.soc.memory import Origin
from sfglab.soc.paper_values import MESSAGE_BYTES, SUBSCRIBERS, Panel
from sfglab.soc.prediction import PRIORS, predictions

if TYPE_CHECKING:
    from collections.abc import Callable

MAIN = "stored"  #: The constants by which claims are judged; the other set is told beside.

_MS_PER_NS = 1e-6


@derived
def bars(run: Run[Config]) -> pd.DataFrame:
    """Return the bars with their ``ratio``: how many times as fast a gateway is."""
    return run["bar"].assign(ratio=lambda t: t["smt_s"] / t["gateway_s"])


@derived
def stated(run: Run[Config]) -> pd.DataFrame:
    """Return the stated numbers with their ``residual``."""
    return run["stated"].assign(residual=lambda t: t["found"] / t["stated"] - 1)


def bars_of(run: Run[Config], panel: Panel, *, model: str = MAIN) -> pd.DataFrame:
    """Return a panel's bars by a set of constants or ``rtl``, by subscribers and size; empty: it has none."""
    table = bars(run)
    chosen = table[(table["model"] == model) & (table["panel"] == panel.value)]
    return chosen.sort_values(["subscribers", "message_bytes"])


def live_speed_up(
    run: Run[Config], panel: Panel, subscribers: int, message_bytes: int
) -> Estimate | None:
    """Return the ratio of the medians of both transports across processes; None: it was not measured.

    Repetitions, in which both were measured right after each other, are resampled as pairs.
    """
    pairs = _pairs(run, panel, subscribers, message_bytes).to_numpy(dtype=np.float64)
    return ratio_of(pairs, np.median, unit="times as fast") if len(pairs) else None


def _pairs(run: Run[Config], panel: Panel, subscribers: int, message_bytes: int) -> pd.DataFrame:
    """Return ns over both transports, ``smt`` and ``gateway``, a line a repetition."""
    publisher, receiver = panel.value.split(" to ")
    cell = {"publisher": publisher, "subscribers": subscribers, "message_bytes": message_bytes}
    table = run["crossing"]
    chosen = table[(table[list(cell)] == list(cell.values())).all(axis=1)]
    pairs = chosen.pivot_table(index="repeat", columns="transport", values=f"{receiver}_ns")
    return pairs.reindex(columns=["smt", "gateway"])


def live_table(run: Run[Config]) -> pd.DataFrame:
    """Return every live cell: both medians in ms, speed-up with interval, the model's, repetitions."""
    rows = run["crossing"]
    cells = sorted(
        set(zip(rows["subscribers"].tolist(), rows["message_bytes"].tolist(), strict=True))
    )
    return pd.DataFrame([_live_line(run, panel, *cell) for panel in Panel for cell in cells])


def _live_line(run: Run[Config], panel: Panel, count: int, size: int) -> dict[str, Any]:
    cell, speed_up = _pairs(run, panel, count, size), live_speed_up(run, panel, count, size)
    medians = cell.median() * _MS_PER_NS
    assert speed_up, "the cell was measured"
    return {
        "panel": panel.value,
        "subscribers": count,
        "message_bytes": size,
        "smt_ms": float(medians["smt"]),
        "gateway_ms": float(medians["gateway"]),
        "speed_up": speed_up.value,
        "low": speed_up.low,
        "high": speed_up.high,
        "model": float(_ratios(run, panel).get((count, size), np.nan)),
        "repeats": len(cell),
    }


def live_agreement(table: pd.DataFrame) -> tuple[int, int, int]:
    """Return how many bars there are, how many of them say which is faster, and how many as the model does.

    Of a table as from `live_table`. A transport is faster where the whole interval lies on one side of 1.
    """
    decided = table[(table["low"] > 1) | (table["high"] < 1)]
    same = (decided["speed_up"] > 1) == (decided["model"] > 1)
    return len(table), len(decided), int(same.sum())


def live_note(run: Run[Config]) -> str:
    """Return under which conditions the live part ran."""
    rows, machine = run["crossing"], run.metadata("run")["machine"]
    if rows.empty:
        return "nothing ran live"
    cores, processes = machine["usable_cores"], rows["subscribers"].max() + 3
    share = f"; up to {processes} processes share them, so they wait for each other"
    waits = share if processes > cores else ""
    load, times = rows["load"].median(), rows["repeat"].nunique()
    return f"{cores} cores of {machine['cpu']}{waits}; {times} repetitions, load {load:.1f}"


def memory_speed_ups(run: Run[Config]) -> pd.DataFrame:
    """Return the speed-up of the memory part alone, for long messages, from the hardware's cycles of a chunk.

    Towards hardware: all readers' turns against one read and a broadcast; from hardware, with the write before.
    """
    chunk = run["law"].pivot_table(index="subscribers", columns="path", values="chunk_cycles")
    if chunk.empty:
        return pd.DataFrame()
    both = {
        "hardware to hardware": (chunk[WRITE] + chunk[READS]) / chunk[IN],
        "software to hardware": chunk[READS] / chunk[OUT],
    }
    return pd.DataFrame(both).reset_index()


def rtl_residual(run: Run[Config]) -> float | None:
    """Return the largest |model / hardware - 1| where the hardware was simulated; None: nowhere."""
    if run["cycles"].empty:
        return None
    ran = run["cycles"][run["cycles"]["simulated"]]
    return float((ran["model_cycles"] / ran["rtl_cycles"] - 1).abs().max())


def fit_meaning(run: Run[Config]) -> dict[str, str]:
    """Return what the agreement of the main constants with the stated numbers is worth, for the ledger."""
    tables = (stated(run), *(run[name] for name in ("constant", "refit", "tendency", "variant")))
    numbers, constants, refits, tendencies, variants = (t[t["model"] == MAIN] for t in tables)
    fitted = (constants["origin"] == Origin.FITTED.value).sum()
    ended = refits["rms"].dropna()
    best = (ended < ended.min() * 1.001).sum()
    moved = refits.loc[ended.index, "shift"].min()
    missed = tendencies[~tendencies["holds"]]["text"]
    return {
        "fit": f"{fitted} constants to {len(numbers)} stated numbers: that they agree shows that these numbers "
        "are possible together, and little more",
        "worst of the stated numbers": f"{numbers['residual'].abs().max():.1%} away",
        "fitted anew": f"{best} of {len(refits)} drawn starts end at the committed constants (to {moved:.2%})"
        + (", the others at worse ones" if best < len(refits) else ""),
        "an assumed constant halved or doubled": "with all others fitted anew, the worst stated number is "
        f"{variants['worst'].min():.1%} to {variants['worst'].max():.1%} away",
        "sentences without a number, not fitted": f"{len(tendencies) - len(missed)} of {len(tendencies)} hold"
        + "".join(f"; not: {text}" for text in missed),
    }


Ratios = pd.Series  #: Speed-ups of a panel by subscribers and size.


@dataclass(frozen=True, slots=True, kw_only=True)
class _Asked:
    """What a claim asks of its panel."""

    panel: Panel  #: From whom to whom.
    #: Which of its speed-ups it is about, by subscribers and size.
    bar: Callable[[Ratios], tuple[int, int]]
    slower: bool = False  #: The figure is how many times as slow; else how many times as fast.
    #: The other end of the paper's range, by its name in the claim.
    end: tuple[str, Callable[[Ratios], float]]
    unit: str  #: Of the figure.

    def value(self, ratios: Ratios) -> float:
        """Return the claim's figure."""
        ratio = float(ratios[self.bar(ratios)])
        return 1 / ratio if self.slower else ratio


_SMALL, _LARGE, _MANY = MESSAGE_BYTES[0], MESSAGE_BYTES[-1], SUBSCRIBERS[-1]


def _largest(ratios: Ratios) -> tuple[int, int]:
    return max(product(SUBSCRIBERS, MESSAGE_BYTES), key=lambda cell: float(ratios[cell]))


_ASKED = {
    "C-HWHW": _Asked(
        panel=Panel.HARDWARE_TO_HARDWARE,
        bar=lambda _: (_MANY, _LARGE),
        end=("times as fast at 10 kB", lambda ratios: float(ratios[_MANY, _SMALL])),
        unit="times as fast at 10 MB",
    ),
    "C-HWSW": _Asked(
        panel=Panel.HARDWARE_TO_SOFTWARE,
        bar=lambda ratios: (min(SUBSCRIBERS, key=lambda count: ratios[count, _SMALL]), _SMALL),
        slower=True,
        end=("times as fast at 10 MB, 8 nodes", lambda ratios: float(ratios[_MANY, _LARGE])),
        unit="times as slow at 10 kB",
    ),
    "C-SWHW": _Asked(
        panel=Panel.SOFTWARE_TO_HARDWARE,
        bar=_largest,
        end=(
            "largest at 10 kB",
            lambda ratios: max(float(ratios[count, _SMALL]) for count in SUBSCRIBERS),
        ),
        unit="times as fast at 10 MB",
    ),
    "C-SWSW": _Asked(
        panel=Panel.SOFTWARE_TO_SOFTWARE,
        bar=_largest,
        end=("times as fast, least", lambda ratios: float(ratios.min())),
        unit="times as fast, largest",
    ),
}


def _ratios(run: Run[Config], panel: Panel, model: str = MAIN) -> Ratios:
    return bars_of(run, panel, model=model).set_index(["subscribers", "message_bytes"])["ratio"]


def _measured(run: Run[Config], asked: _Asked) -> Finding:
    ratios = _ratios(run, asked.panel)
    value, (count, size) = asked.value(ratios), asked.bar(ratios)
    live = live_speed_up(run, asked.panel, count, size)
    details = {
        "if the core cut through": f"{asked.value(_ratios(run, asked.panel, 'cut-through')):.3f}",
        **_hardware(run, asked),
        "live": f"{live}, {count} readers, {size} B; {live_note(run)}"
        if live
        else "this bar was not measured",
        **fit_meaning(run),
        **_out_of_sample(asked.panel),
    }
    name, end = asked.end
    # The model draws nothing: there is no interval.
    return Finding(
        estimate=exactly(value, asked.unit),
        details=details,
        ends={name: end(ratios)},
        fitted=f"{details['fit']}; out of sample: {details['out of sample']}",
    )


def _out_of_sample(panel: Panel) -> dict[str, str]:
    """Return what priors and the other numbers predict of the panel's numbers, each left out."""
    found = [one for one in predictions() if one.panel is panel]
    ranges = [(one.decider, one.low, one.high, *one.narrowed) for one in found]
    said = [
        f"{by}: [{a:.3g}, {b:.3g}] becomes [{low:.3g}, {high:.3g}]"
        for by, a, b, low, high in ranges
    ]
    return {
        "out of sample": ", ".join(map(str, found)),
        "would decide": "; ".join(said),
        "priors": "; ".join(
            f"{k} {p.median:g} (x/÷ {p.factor:g}), {p.source}" for k, p in PRIORS.items()
        ),
    }


def _hardware(run: Run[Config], asked: _Asked) -> dict[str, str]:
    worst, ratios = rtl_residual(run), _ratios(run, asked.panel, "rtl")
    if worst is None:
        return {"RTL": str(run.metadata("missing").get("rtl", "not simulated"))}
    text = f"cycles of the model within {worst:.2%} of the simulated ones"
    if len(ratios) == len(_ratios(run, asked.panel)):
        text = f"{asked.value(ratios):.3f} with the hardware's cycles in the memory part; {text}"
    alone = memory_speed_ups(run)
    if asked.panel.value in alone:
        most = alone.iloc[-1]
        text += (
            f"; memory part alone, {most['subscribers']:.0f} nodes: {most[asked.panel.value]:.2f}"
        )
    if proof := run.metadata("proof"):
        follows = "follows" if proof["holds"] else "does not follow"
        text += f"; the control {follows} the core's table, for every sequence of inputs (Yosys, by induction)"
    return {"RTL": text}


for _claim, _asked in _ASKED.items():
    exp.claim(_claim, how=How.SIMULATED)(partial(_measured, asked=_asked))

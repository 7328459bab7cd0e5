"""What the transfer experiment says to the claims on Fig. 6 and 7, and what its agreement is worth.

Everything here is computed from the log alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.lab.claims import How, Measured
from sfglab.lab.experiments.transfer.analysis import (
    MAIN,
    Results,
    bars_of,
    live_note,
    live_speed_up,
    load_results,
    memory_speed_ups,
    rtl_residual,
)
from sfglab.lab.stats import Estimate
from sfglab.soc.memory import MESSAGE_BYTES, SUBSCRIBERS, Origin, Panel

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    import pandas as pd


def fit_meaning(results: Results, model: str = MAIN) -> dict[str, str]:
    """Return what the model's agreement with the stated numbers is worth, for the ledger.

    Args:
        results: The run.
        model: Which set of constants.
    """
    stated, constants, refits, tendencies, variants = (
        table[table["model"] == model]
        for table in (
            results.stated,
            results.constants,
            results.refits,
            results.tendencies,
            results.variants,
        )
    )
    fitted = (constants["origin"] == Origin.FITTED.value).sum()
    ended = refits["rms"].dropna()
    best = (ended < ended.min() * 1.001).sum()
    moved = refits.loc[ended.index, "shift"].min()
    missed = tendencies[~tendencies["holds"]]["text"]
    return {
        "fit": f"{fitted} constants to {len(stated)} stated numbers: that they agree shows that these numbers "
        "are possible together, and little more",
        "worst of the stated numbers": f"{stated['residual'].abs().max():.1%} away",
        "fitted anew": f"{best} of {len(refits)} drawn starts end at the committed constants (to {moved:.2%})"
        + (", the others at worse ones" if best < len(refits) else ""),
        "an assumed constant halved or doubled": "with all others fitted anew, the worst stated number is "
        f"{variants['worst'].min():.1%} to {variants['worst'].max():.1%} away",
        "sentences without a number, not fitted": f"{len(tendencies) - len(missed)} of {len(tendencies)} hold"
        + "".join(f"; not: {text}" for text in missed),
    }


@dataclass(frozen=True, slots=True, kw_only=True)
class _Asked:
    """What a claim asks of its panel."""

    panel: Panel  #: From whom to whom.
    #: Which of the panel's speed-ups it is about, by subscribers and size.
    bar: Callable[[pd.Series[float]], tuple[int, int]]
    slower: bool = False  #: The figure is how many times as slow; else how many times as fast.
    other: Callable[[pd.Series[float]], str]  #: What else the paper states of the panel, beside ours.
    unit: str  #: Of the figure.

    def value(self, ratios: pd.Series[float]) -> float:
        """Return the claim's figure."""
        ratio = float(ratios[self.bar(ratios)])
        return 1 / ratio if self.slower else ratio


_SMALL, _LARGE, _MANY = MESSAGE_BYTES[0], MESSAGE_BYTES[-1], SUBSCRIBERS[-1]


def _small(ratios: pd.Series[float]) -> str:
    return ", ".join(f"{ratios[count, _SMALL]:.3f} with {count} nodes" for count in SUBSCRIBERS)


def _largest(ratios: pd.Series[float]) -> tuple[int, int]:
    cells = [(count, size) for count in SUBSCRIBERS for size in MESSAGE_BYTES]
    return max(cells, key=lambda cell: float(ratios[cell]))


_ASKED = {
    "C-HWHW": _Asked(
        panel=Panel.HARDWARE_TO_HARDWARE,
        bar=lambda _: (_MANY, _LARGE),
        other=lambda ratios: f"{ratios[_MANY, _SMALL]:.3f} at 10 kB, paper 1.94",
        unit="times as fast at 10 MB",
    ),
    "C-HWSW": _Asked(
        panel=Panel.HARDWARE_TO_SOFTWARE,
        bar=lambda ratios: (min(SUBSCRIBERS, key=lambda count: ratios[count, _SMALL]), _SMALL),
        slower=True,
        other=lambda ratios: f"speed-up {ratios[_MANY, _LARGE]:.3f} at 10 MB, 8 nodes; paper: approaches 1",
        unit="times as slow at 10 kB",
    ),
    "C-SWHW": _Asked(
        panel=Panel.SOFTWARE_TO_HARDWARE,
        bar=_largest,
        other=lambda ratios: f"at 10 kB {_small(ratios)}; paper: below 1",
        unit="times as fast at 10 MB",
    ),
    "C-SWSW": _Asked(
        panel=Panel.SOFTWARE_TO_SOFTWARE,
        bar=_largest,
        other=lambda ratios: f"least {ratios.min():.3f}, paper 1.06",
        unit="times as fast, largest",
    ),
}


def _ratios(results: Results, panel: Panel, model: str = MAIN) -> pd.Series[float]:
    """Return a panel's speed-ups by subscribers and size."""
    return bars_of(results, panel, model=model).set_index(["subscribers", "message_bytes"])["ratio"]


def measure_claims(log: Path) -> dict[str, Measured]:
    """Return our figures for the claims that this experiment answers, by claim id."""
    results = load_results(log)
    return {name: _measured(results, asked) for name, asked in _ASKED.items()}


def _measured(results: Results, asked: _Asked) -> Measured:
    ratios = _ratios(results, asked.panel)
    value = asked.value(ratios)
    details = {
        "the other end": asked.other(ratios),
        "if the core cut through": f"{asked.value(_ratios(results, asked.panel, 'cut-through')):.3f}",
        **_hardware(results, asked),
        **_live(results, asked, asked.bar(ratios)),
        **fit_meaning(results),
    }
    # The model draws nothing: there is no interval.
    estimate = Estimate(value=value, low=value, high=value, unit=asked.unit)
    return Measured(estimate=estimate, how=How.SIMULATED, details=details)


def _hardware(results: Results, asked: _Asked) -> dict[str, str]:
    worst, ratios = rtl_residual(results), _ratios(results, asked.panel, "rtl")
    if worst is None:
        return {"RTL": str(results.missing.get("rtl", "not simulated"))}
    text = f"cycles of the model within {worst:.2%} of the simulated ones"
    if len(ratios) == len(_ratios(results, asked.panel)):
        text = f"{asked.value(ratios):.3f} with the hardware's cycles in the memory part; {text}"
    alone = memory_speed_ups(results)
    if asked.panel.value in alone:
        most = alone.iloc[-1]
        text += f"; memory part alone, {most['subscribers']:.0f} nodes: {most[asked.panel.value]:.2f}"
    return {"RTL": text}


def _live(results: Results, asked: _Asked, bar: tuple[int, int]) -> dict[str, str]:
    """Return the same bar across processes, and under which conditions."""
    count, size = bar
    found = live_speed_up(results, asked.panel, count, size)
    if found is None:
        return {"live": "this bar was not measured"}
    return {"live": f"{found}, {count} readers, {size} B; {live_note(results)}"}

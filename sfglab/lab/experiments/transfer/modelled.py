"""What the model of the memory interface says of Fig. 6 and 7, and its fit, run anew."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sfglab.lab.experiments.transfer.rows import (
    ConstantRow,
    RefitRow,
    StatedRow,
    TendencyRow,
    TransferBarRow,
    VariantRow,
)
from sfglab.soc.memory import (
    CUT_THROUGH,
    STORED,
    FitError,
    Origin,
    constants,
    fit,
    residuals,
    sensitivity,
    speed_ups,
    tendencies,
)

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.soc.memory import Costs, Fit, SpeedUp


MODELS = {"stored": STORED, "cut-through": CUT_THROUGH}
"""Both sets of constants; the first is the better fit and the one that claims are judged by."""

SPREAD = 2.5
"""A fit starts with every constant up to this factor from the committed one."""

Row = TransferBarRow | StatedRow | TendencyRow | ConstantRow | RefitRow | VariantRow


def model_rows(refits: int, rng: np.random.Generator) -> Iterator[tuple[str, Row]]:
    """Return every row of this part, with its table.

    Args:
        refits: Starts from which each set is fitted anew.
        rng: Draws them.
    """
    for name, costs in MODELS.items():
        for bar in speed_ups(costs):
            yield "bar", bar_row(name, bar)
        for item in residuals(costs):
            yield (
                "stated",
                StatedRow(
                    model=name,
                    panel=item.panel.value,
                    text=item.text,
                    stated=item.stated,
                    found=item.model,
                ),
            )
        for said, holds in tendencies(costs):
            yield "tendency", TendencyRow(model=name, panel=said.panel.value, text=said.text, holds=holds)
        yield from _fits(name, costs, refits, rng)
        for other in sensitivity(costs):
            yield (
                "variant",
                VariantRow(
                    model=name,
                    constant=other.name,
                    factor=other.factor,
                    rms=other.fit.rms,
                    worst=other.worst,
                ),
            )


def bar_row(model: str, bar: SpeedUp) -> TransferBarRow:
    """Return a bar as a row."""
    return TransferBarRow(
        model=model,
        panel=bar.panel.value,
        message_bytes=bar.message_bytes,
        subscribers=bar.subscribers,
        smt_s=bar.smt_s,
        gateway_s=bar.gateway_s,
    )


def _fits(
    name: str, costs: Costs, refits: int, rng: np.random.Generator
) -> Iterator[tuple[str, RefitRow | ConstantRow]]:
    """Fit from drawn starts, and put the best fit's constants beside the committed ones."""
    fitted = _fitted(costs)
    found: list[Fit] = []
    for start in range(refits):
        factors = np.exp(rng.uniform(-math.log(SPREAD), math.log(SPREAD), len(fitted)))
        drawn = {key: value * float(f) for (key, value), f in zip(fitted.items(), factors, strict=True)}
        ended = _ended(_with(costs, drawn))
        if ended:
            found.append(ended)
        yield (
            "refit",
            RefitRow(
                model=name,
                start=start,
                farthest=float(np.exp(np.abs(np.log(factors)).max())),
                rms=ended.rms if ended else math.nan,
                shift=_shift(fitted, _fitted(ended.costs)) if ended else math.nan,
            ),
        )
    best = min(found, key=lambda item: item.rms).costs if found else costs
    for item, again in zip(constants(costs), constants(best), strict=True):
        yield (
            "constant",
            ConstantRow(
                model=name,
                constant=item.name,
                value=item.value,
                unit=item.unit,
                origin=item.origin.value,
                reason=item.reason,
                refitted=again.value,
            ),
        )


def _ended(start: Costs) -> Fit | None:
    try:
        return fit(start)
    except FitError:
        return None


def _fitted(costs: Costs) -> dict[str, float]:
    return {item.name: item.value for item in constants(costs) if item.origin is Origin.FITTED}


def _with(costs: Costs, values: dict[str, float]) -> Costs:
    """Return the costs with some constants set."""
    others = dict(values)
    memory = replace(costs.memory, write_latency_cycles=others.pop("write_latency_cycles"))
    return replace(costs, memory=memory, **others)


def _shift(committed: dict[str, float], found: dict[str, float]) -> float:
    return max(abs(found[key] / value - 1) for key, value in committed.items())

"""Paper values of paper C, section 4, how far the model is from them, and the one fit of its free constants.

Fig. 6 and 7 reach us as text: ends of ranges, which are ratios with a residual, and tendencies, which hold or
do not. Six constants are fitted to seven ratios, by least squares on their logarithms: that shows only that the
numbers are possible together. More telling is what was not fitted (`TENDENCIES`), and what the assumed
constants change (`sensitivity`).
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

from sfglab.errors import SfglabError
from sfglab.soc.memory import (
    STORED,
    Costs,
    Setup,
    Side,
    Transport,
    fitted_values,
    transfer_times,
    with_values,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

MESSAGE_BYTES = (10_000, 100_000, 1_000_000, 10_000_000)  #: Image sizes of section 4.
#: Numbers of subscribing hardware nodes; one software node subscribes besides.
SUBSCRIBERS = (2, 4, 8)


class Panel(Enum):
    """A row of Fig. 6 or 7: from whom to whom."""

    HARDWARE_TO_HARDWARE = "hardware to hardware"
    HARDWARE_TO_SOFTWARE = "hardware to software"
    SOFTWARE_TO_HARDWARE = "software to hardware"
    SOFTWARE_TO_SOFTWARE = "software to software"


_HH, _HS, _SH, _SS = Panel


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedUp:
    """A bar of Fig. 6 or 7."""

    panel: Panel  #: From whom to whom.
    message_bytes: int  #: Size of the message.
    subscribers: int  #: Subscribing hardware nodes.
    smt_s: float  #: Transfer time over a software-mapped topic.
    gateway_s: float  #: Transfer time through a gateway.

    @property
    def ratio(self) -> float:
        """The gateway's speed-up; below 1, it is slower."""
        return self.smt_s / self.gateway_s


def speed_ups(
    costs: Costs = STORED,
    *,
    subscribers: Sequence[int] = SUBSCRIBERS,
    sizes_bytes: Sequence[int] = MESSAGE_BYTES,
) -> list[SpeedUp]:
    """Return the model's value of every bar of Fig. 6 and 7, or of others, panel by panel."""
    cells = itertools.product(Panel, subscribers, sizes_bytes)
    return [_speed_up(panel, subscribers, size, costs) for panel, subscribers, size in cells]


def _speed_up(panel: Panel, subscribers: int, message_bytes: int, costs: Costs) -> SpeedUp:
    def time_s(transport: Transport) -> float:
        setup = Setup(
            publisher=Side.HARDWARE if panel in {_HH, _HS} else Side.SOFTWARE,
            transport=transport,
            message_bytes=message_bytes,
            hardware=subscribers,
        )
        times = transfer_times(setup, costs)
        found = times.hardware_s if panel in {_HH, _SH} else times.software_s
        assert found is not None
        return found

    return SpeedUp(
        panel=panel,
        message_bytes=message_bytes,
        subscribers=subscribers,
        smt_s=time_s(Transport.SMT),
        gateway_s=time_s(Transport.GATEWAY),
    )


@dataclass(frozen=True, slots=True)
class PaperValue:
    """A number of the paper."""

    panel: Panel  #: Whose speed-up.
    value: float  #: The number.
    pick: Callable[[Sequence[SpeedUp]], float]  #: Which of the panel's bars it is.
    text: str  #: How the paper puts it.


@dataclass(frozen=True, slots=True, kw_only=True)
class Residual:
    """A paper value beside the model's."""

    panel: Panel  #: Whose speed-up.
    text: str  #: How the paper puts it.
    paper: float  #: The paper's number.
    model: float  #: The model's.

    @property
    def relative(self) -> float:
        """(model - paper) / paper."""
        return self.model / self.paper - 1


@dataclass(frozen=True, slots=True)
class Tendency:
    """A sentence of the paper without a number; it is no part of any fit."""

    panel: Panel  #: Whose speed-up.
    text: str  #: What the paper says, as it is read here.
    holds: Callable[[Sequence[SpeedUp]], bool]  #: Whether it is so, given the panel's bars.


def _least(bars: Sequence[SpeedUp]) -> float:
    return min(bar.ratio for bar in bars)


def _most(bars: Sequence[SpeedUp]) -> float:
    return max(bar.ratio for bar in bars)


def _at(subscribers: int, message_bytes: int) -> Callable[[Sequence[SpeedUp]], float]:
    def pick(bars: Sequence[SpeedUp]) -> float:
        return next(
            b.ratio
            for b in bars
            if (b.subscribers, b.message_bytes) == (subscribers, message_bytes)
        )

    return pick


def _grows(bars: Sequence[SpeedUp]) -> bool:
    """Return whether the speed-up grows with size at every number of subscribers, and the other way round."""
    rows = [[_at(n, x)(bars) for x in MESSAGE_BYTES] for n in SUBSCRIBERS]
    return all(line == sorted(line) for line in (*rows, *map(list, zip(*rows, strict=True))))


_SMALL, _LARGE, _MANY = MESSAGE_BYTES[0], MESSAGE_BYTES[-1], SUBSCRIBERS[-1]

PAPER_VALUES = (
    PaperValue(_HH, 1.94, _at(_MANY, _SMALL), "8 hardware nodes: from 1.94 for small messages"),
    PaperValue(_HH, 7.95, _at(_MANY, _LARGE), "8 hardware nodes: to 7.95 for larger messages"),
    PaperValue(_HS, 1 / 2, _least, "transmission times up to a factor of approximately 2"),
    PaperValue(_HS, 1.0, _at(_MANY, _LARGE), "large and many: the speedup approaches 1"),
    PaperValue(_SH, 3.79, _most, "for larger message sizes speedups up to 3.79"),
    PaperValue(_SS, 1.06, _least, "the range of speedups is from 1.06"),
    PaperValue(_SS, 2.05, _most, "the range of speedups is to 2.05"),
)
"""The numbers of section 4."""

TENDENCIES = (
    Tendency(
        _HH,
        "speedups as soon as more than one hardware node subscribes",
        lambda bars: _least(bars) > 1,
    ),
    Tendency(_HH, "at 8 nodes, 1.94 and 7.95 are the ends of the range", _grows),
    Tendency(_HS, "with size and number of hardware nodes the overhead reduces", _grows),
    Tendency(
        _SH,
        "below 1 for smaller message sizes, at least with 2 and 4 nodes",
        lambda bars: _at(2, _SMALL)(bars) < 1 and _at(4, _SMALL)(bars) < 1,
    ),
    Tendency(
        _SH,
        "below 1 for smaller message sizes, with 8 nodes too",
        lambda b: _at(_MANY, _SMALL)(b) < 1,
    ),
    Tendency(_SS, "speedups for all measured sizes and numbers", lambda bars: _least(bars) > 1),
)
"""The sentences of section 4 without a number."""


def residuals(costs: Costs = STORED) -> list[Residual]:
    """Return every paper value beside the model's."""
    panels = _by_panel(costs)
    return [
        Residual(
            panel=item.panel, text=item.text, paper=item.value, model=item.pick(panels[item.panel])
        )
        for item in PAPER_VALUES
    ]


def tendencies(costs: Costs = STORED) -> list[tuple[Tendency, bool]]:
    """Return every tendency and whether the model has it."""
    panels = _by_panel(costs)
    return [(item, item.holds(panels[item.panel])) for item in TENDENCIES]


def _by_panel(costs: Costs) -> dict[Panel, list[SpeedUp]]:
    bars = speed_ups(costs)
    return {panel: [bar for bar in bars if bar.panel is panel] for panel in Panel}


class FitError(SfglabError, RuntimeError):
    """The solver found no minimum."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Fit:
    """A fit and how good it is."""

    costs: Costs  #: The constants, fitted and standing.
    residuals: tuple[Residual, ...]  #: Every paper value beside the model's.
    rms: float  #: Root mean square of the residuals' logarithms.


@dataclass(frozen=True, slots=True, kw_only=True)
class Variant:
    """A fit with one assumed constant changed."""

    name: str  #: Of the constant.
    factor: float  #: By which it was multiplied.
    fit: Fit  #: What the others become, and how good that is.

    @property
    def worst(self) -> float:
        """The largest residual, relative and without sign."""
        return max(abs(item.relative) for item in self.fit.residuals)


def fit(start: Costs = STORED) -> Fit:
    """Fit the fitted constants to `PAPER_VALUES` from where they start; FitError where it does not converge."""
    from scipy.optimize import least_squares

    values = fitted_values(start)

    def costs_of(logs: list[float]) -> Costs:
        return with_values(
            start, {name: math.exp(log) for name, log in zip(values, logs, strict=True)}
        )

    def errors(logs: list[float]) -> list[float]:
        return [math.log(item.model / item.paper) for item in residuals(costs_of(logs))]

    found = least_squares(
        errors, [math.log(value) for value in values.values()], x_scale="jac", xtol=1e-12
    )
    if not found.success:
        raise FitError(f"fit of {', '.join(values)}: {found.message}")
    costs = costs_of(found.x)
    left = tuple(residuals(costs))
    return Fit(costs=costs, residuals=left, rms=math.sqrt(2 * found.cost / len(left)))


def sensitivity(start: Costs = STORED) -> list[Variant]:
    """Return the fits with each assumed constant halved and doubled: none of them is known well."""
    found = []
    for factor in (0.5, 2.0):
        latency = factor * start.memory.read_latency_cycles
        variants = {
            "read_latency_cycles": replace(
                start, memory=replace(start.memory, read_latency_cycles=latency)
            ),
            "delegate_s": replace(start, delegate_s=factor * start.delegate_s),
            "publish_s": replace(start, publish_s=factor * start.publish_s),
        }
        found += [
            Variant(name=name, factor=factor, fit=fit(costs)) for name, costs in variants.items()
        ]
    return found

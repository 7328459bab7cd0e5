"""Paper values of paper C, section 4, how far the model is from them, and the one fit of its free constants.

Fig. 6 and 7 reach us as text: ends of ranges and tendencies, all of them ratios. Ends are numbers with a
residual; tendencies hold or do not. Six constants are fitted to seven ratios, by least squares on their
logarithms: so nearly as many constants as numbers that agreement shows only that the numbers are possible
together; what is worth looking at is what was not fitted (`TENDENCIES`), and what the assumed constants change
(`sensitivity`). Refuses to know how a time comes about.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import TYPE_CHECKING

from sfglab.errors import SfglabError
from sfglab.soc.memory.memif import FITTED_NAMES, STORED, Costs
from sfglab.soc.memory.transfer import Setup, Side, Transport, transfer_times

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

MESSAGE_BYTES = (10_000, 100_000, 1_000_000, 10_000_000)
"""Image sizes of section 4."""
SUBSCRIBERS = (2, 4, 8)
"""Numbers of subscribing hardware nodes; one software node subscribes besides."""


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


def speed_ups(costs: Costs = STORED) -> list[SpeedUp]:
    """Return the model's value of every bar of Fig. 6 and 7, panel by panel."""
    cells = itertools.product(Panel, SUBSCRIBERS, MESSAGE_BYTES)
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Stated:
    """A number that the paper states."""

    panel: Panel  #: Whose speed-up.
    value: float  #: The number.
    pick: Callable[[Sequence[SpeedUp]], float]  #: Which of the panel's bars it is.
    text: str  #: How the paper puts it.


@dataclass(frozen=True, slots=True, kw_only=True)
class Residual:
    """A stated number beside the model's."""

    panel: Panel  #: Whose speed-up.
    text: str  #: How the paper puts it.
    stated: float  #: The paper's number.
    model: float  #: The model's.

    @property
    def relative(self) -> float:
        """(model - stated) / stated."""
        return self.model / self.stated - 1


@dataclass(frozen=True, slots=True, kw_only=True)
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
        return next(b.ratio for b in bars if (b.subscribers, b.message_bytes) == (subscribers, message_bytes))

    return pick


def _grows(bars: Sequence[SpeedUp]) -> bool:
    """Return whether the speed-up grows with size at every number of subscribers, and the other way round."""
    rows = [[_at(n, x)(bars) for x in MESSAGE_BYTES] for n in SUBSCRIBERS]
    lines = [*rows, *map(list, zip(*rows, strict=True))]
    return all(line == sorted(line) for line in lines)


_SMALL, _LARGE, _MANY = MESSAGE_BYTES[0], MESSAGE_BYTES[-1], SUBSCRIBERS[-1]

STATED = (
    Stated(
        panel=_HH, value=1.94, pick=_at(_MANY, _SMALL), text="8 hardware nodes: from 1.94 for small messages"
    ),
    Stated(
        panel=_HH, value=7.95, pick=_at(_MANY, _LARGE), text="8 hardware nodes: to 7.95 for larger messages"
    ),
    Stated(panel=_HS, value=1 / 2, pick=_least, text="transmission times up to a factor of approximately 2"),
    Stated(panel=_HS, value=1.0, pick=_at(_MANY, _LARGE), text="large and many: the speedup approaches 1"),
    Stated(panel=_SH, value=3.79, pick=_most, text="for larger message sizes speedups up to 3.79"),
    Stated(panel=_SS, value=1.06, pick=_least, text="the range of speedups is from 1.06"),
    Stated(panel=_SS, value=2.05, pick=_most, text="the range of speedups is to 2.05"),
)
"""The numbers of section 4."""

TENDENCIES = (
    Tendency(
        panel=_HH,
        text="speedups as soon as more than one hardware node subscribes",
        holds=lambda bars: _least(bars) > 1,
    ),
    Tendency(panel=_HH, text="at 8 nodes, 1.94 and 7.95 are the ends of the range", holds=_grows),
    Tendency(
        panel=_HS,
        text="with size and number of hardware nodes the overhead reduces",
        holds=_grows,
    ),
    Tendency(
        panel=_SH,
        text="below 1 for smaller message sizes, at least with 2 and 4 nodes",
        holds=lambda bars: _at(2, _SMALL)(bars) < 1 and _at(4, _SMALL)(bars) < 1,
    ),
    Tendency(
        panel=_SH,
        text="below 1 for smaller message sizes, with 8 nodes too",
        holds=lambda bars: _at(_MANY, _SMALL)(bars) < 1,
    ),
    Tendency(
        panel=_SS,
        text="speedups for all measured sizes and numbers",
        holds=lambda bars: _least(bars) > 1,
    ),
)
"""The sentences of section 4 without a number."""


def residuals(costs: Costs = STORED) -> list[Residual]:
    """Return every stated number beside the model's."""
    panels = _by_panel(costs)
    return [
        Residual(panel=item.panel, text=item.text, stated=item.value, model=item.pick(panels[item.panel]))
        for item in STATED
    ]


def tendencies(costs: Costs = STORED) -> list[tuple[Tendency, bool]]:
    """Return every stated tendency and whether the model has it."""
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
    residuals: tuple[Residual, ...]  #: Every stated number beside the model's.
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
    """Fit `FITTED_NAMES` to `STATED`; all other constants stay.

    Args:
        start: Where the search starts, and the constants that stay.

    Raises:
        FitError: The solver did not converge.
    """
    from scipy.optimize import least_squares

    def errors(logs: list[float]) -> list[float]:
        return [math.log(item.model / item.stated) for item in residuals(_with(start, logs))]

    found = least_squares(errors, [math.log(value) for value in _values(start)], x_scale="jac", xtol=1e-12)
    if not found.success:
        raise FitError(f"fit of {', '.join(FITTED_NAMES)}: {found.message}")
    costs = _with(start, found.x)
    left = tuple(residuals(costs))
    return Fit(costs=costs, residuals=left, rms=math.sqrt(2 * found.cost / len(left)))


def sensitivity(start: Costs = STORED) -> list[Variant]:
    """Return the fits with each assumed constant halved and doubled: none of them is known well.

    Args:
        start: The constants to change.
    """
    found = []
    for factor in (0.5, 2.0):
        latency = factor * start.memory.read_latency_cycles
        variants = {
            "read_latency_cycles": replace(start, memory=replace(start.memory, read_latency_cycles=latency)),
            "delegate_s": replace(start, delegate_s=factor * start.delegate_s),
            "publish_s": replace(start, publish_s=factor * start.publish_s),
        }
        found += [Variant(name=name, factor=factor, fit=fit(costs)) for name, costs in variants.items()]
    return found


def _values(costs: Costs) -> list[float]:
    return [getattr(costs.memory if hasattr(costs.memory, name) else costs, name) for name in FITTED_NAMES]


def _with(costs: Costs, logs: list[float]) -> Costs:
    """Return the costs with the fitted constants set, given their logarithms."""
    values = {name: math.exp(log) for name, log in zip(FITTED_NAMES, logs, strict=True)}
    memory = replace(costs.memory, write_latency_cycles=values.pop("write_latency_cycles"))
    return replace(costs, memory=memory, **values)

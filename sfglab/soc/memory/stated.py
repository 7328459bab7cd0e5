"""What paper C states of its measurements, and how far the model is from it.

Fig. 6 and 7 reach us as text: ends of ranges and tendencies, all of them ratios. Ends are numbers with a
residual; tendencies hold or do not. Knows the paper's sentences; refuses to know how a time comes about.
"""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING

from sfglab.soc.memory.costs import STORED, Costs
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

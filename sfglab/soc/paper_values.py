"""The module `paper_values` computes the bars of paper C's Fig. 6 and 7, and names the numbers that the paper states.

The project has paper C only as text. Section 4 of this text states only seven ratios: the ends of the ranges of the
gateway's speed-up. The file ``data/claims.yaml`` has the seven ratios. The constant `STATED` names the speed-up of
the model that belongs to each ratio.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import Enum
from itertools import product
from operator import itemgetter
from typing import TYPE_CHECKING

from sfglab.soc.graph import Placement, TopicMapping
from sfglab.soc.memory import STORED, Costs, Setup, transfer_times

if TYPE_CHECKING:
    from collections.abc import Sequence

MESSAGE_BYTES = (10_000, 100_000, 1_000_000, 10_000_000)  #: Sizes of the images.
#: Numbers of hardware subscribers; one software node is a further subscriber.
SUBSCRIBERS = (2, 4, 8)


class Panel(Enum):
    """A `Panel` is a column of Fig. 6 or 7; its value names the sides of publisher and subscriber."""

    HARDWARE_TO_HARDWARE = "hardware to hardware"
    HARDWARE_TO_SOFTWARE = "hardware to software"
    SOFTWARE_TO_HARDWARE = "software to hardware"
    SOFTWARE_TO_SOFTWARE = "software to software"

    @property
    def publisher(self) -> Placement:
        """Return the side of the publisher."""
        return Placement(self.value.split()[0])

    @property
    def subscriber(self) -> Placement:
        """Return the side of the subscriber whose time counts; in hardware the last subscriber counts."""
        return Placement(self.value.split()[-1])


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedUp:
    """A `SpeedUp` is a bar of Fig. 6 or 7."""

    panel: Panel  #: Sides of publisher and subscriber.
    message_bytes: int  #: Size of the message, bytes.
    subscribers: int  #: Number of hardware subscribers.
    smt_s: float  #: Transfer time over a software-mapped topic, s.
    gateway_s: float  #: Transfer time through a gateway, s.

    @property
    def ratio(self) -> float:
        """Return the gateway's speed-up: time over the SMT divided by time through the gateway."""
        return self.smt_s / self.gateway_s


def speed_ups(
    costs: Costs = STORED,
    *,
    subscribers: Sequence[int] = SUBSCRIBERS,
    sizes_bytes: Sequence[int] = MESSAGE_BYTES,
) -> list[SpeedUp]:
    """Return the memory model's value of every bar of Fig. 6 and 7, panel by panel.

    Args:
        costs: Constants of the memory model.
        subscribers: Numbers of hardware subscribers.
        sizes_bytes: Sizes of the message, bytes.
    """
    bars = []
    for panel, count, size in product(Panel, subscribers, sizes_bytes):
        bar = SpeedUp(
            panel=panel,
            message_bytes=size,
            subscribers=count,
            smt_s=_time_s(panel, TopicMapping.SOFTWARE, count, size, costs),
            gateway_s=_time_s(panel, TopicMapping.GATEWAY, count, size, costs),
        )
        bars.append(bar)
    return bars


def _time_s(panel: Panel, mapping: TopicMapping, count: int, size: int, costs: Costs) -> float:
    setup = Setup(
        publisher=panel.publisher,
        mapping=mapping,
        message_bytes=size,
        hardware_subscribers=count,
    )
    return transfer_times(setup, costs)[panel.subscriber]


Ratios = Mapping[tuple[int, int], float]  #: Speed-ups of a panel by message size and subscribers.


@dataclass(frozen=True, slots=True)
class Stated:
    """A `Stated` is a number that section 4 states, with the speed-up of a panel that belongs to this number."""

    claim: str  #: Id of the claim in ``data/claims.yaml`` that has the number.
    #: Key of the number among the claim's `numbers`; empty if the number is the value of the claim.
    number: str
    panel: Panel  #: Panel of the speed-up.
    #: Message size and number of hardware subscribers of the speed-up, or the rank of the speed-up.
    bar: str
    #: Whether the paper states how many times as slow the gateway is: the reciprocal of the speed-up.
    slower: bool = False

    def by(self, ratios: Ratios) -> float:
        """Return the stated number's value by the given speed-ups of the panel."""
        ratio = _RATIOS[self.bar](ratios)
        return 1 / ratio if self.slower else ratio


_LOWEST = "lowest"
_HIGHEST = "highest"
_SMALL_MANY = "10 kB, 8 subscribers"
_LARGE_MANY = "10 MB, 8 subscribers"
_RATIOS: dict[str, Callable[[Ratios], float]] = {
    _LOWEST: lambda ratios: min(ratios.values()),
    _HIGHEST: lambda ratios: max(ratios.values()),
    _SMALL_MANY: itemgetter((10_000, 8)),
    _LARGE_MANY: itemgetter((10_000_000, 8)),
}
_TO_HARDWARE, _TO_SOFTWARE, _FROM_SOFTWARE, _BETWEEN_SOFTWARE = Panel

STATED = (
    Stated("C-HWHW", "times as fast at 10 kB", _TO_HARDWARE, _SMALL_MANY),
    Stated("C-HWHW", "", _TO_HARDWARE, _LARGE_MANY),
    Stated("C-HWSW", "", _TO_SOFTWARE, _LOWEST, slower=True),
    Stated("C-HWSW", "times as fast at 10 MB, 8 nodes", _TO_SOFTWARE, _LARGE_MANY),
    Stated("C-SWHW", "", _FROM_SOFTWARE, _HIGHEST),
    Stated("C-SWSW", "times as fast, least", _BETWEEN_SOFTWARE, _LOWEST),
    Stated("C-SWSW", "", _BETWEEN_SOFTWARE, _HIGHEST),
)
"""`STATED` has the seven numbers of section 4."""


def stated_by_model(costs: Costs = STORED) -> list[float]:
    """Return the memory model's values of the numbers in `STATED`."""
    ratios: dict[Panel, dict[tuple[int, int], float]] = {panel: {} for panel in Panel}
    for bar in speed_ups(costs):
        ratios[bar.panel][bar.message_bytes, bar.subscribers] = bar.ratio
    return [stated.by(ratios[stated.panel]) for stated in STATED]

"""What a planned QoS must keep to, and what is said when it cannot be."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.errors import SfglabError


class ProgrammeError(SfglabError, ValueError):
    """An input of the programme that has no meaning, or a solver that found no optimum."""


class InfeasiblePlanError(ProgrammeError):
    """The topics' minimal rates alone take more airtime than there is.

    Attributes:
        sender: Whose time it is: the medium's where it is shared, else a host's.
        needed: Share of its time that the minimal rates take.
        allowed: Share that may be planned.
        largest: Names of the topics that take most, the most first.
    """

    def __init__(self, sender: str, needed: float, allowed: float, largest: tuple[str, ...]) -> None:
        self.sender, self.needed, self.allowed, self.largest = sender, needed, allowed, largest
        super().__init__(sender, needed, allowed, largest)

    @property
    def lacking(self) -> float:
        """By how much the share exceeds what is allowed."""
        return self.needed - self.allowed

    def __str__(self) -> str:
        return (
            f"QoS plan has no solution: the minimal rates take {self.needed:.3g} of the time of {self.sender}, "
            f"allowed is {self.allowed:.3g}, so {self.lacking:.3g} is lacking; most is taken by "
            f"{', '.join(self.largest)}: lower minimal rates (to {self.allowed / self.needed:.2g} of them if "
            "all alike), send fewer topics, or use a faster link"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """What a plan must keep to."""

    utilisation_max: float = 0.9  #: The most of each sender's time that may be taken, below 1.
    #: Share of samples that may stay lost after repairs, where a history can keep it; a plan says what it
    #: expects (`TopicPlan.loss`).
    residual_loss: float = 1e-4

    def __post_init__(self) -> None:
        for name in ("utilisation_max", "residual_loss"):
            if not 0 < getattr(self, name) < 1:
                raise ProgrammeError(
                    f"{name}: given {getattr(self, name)}, allowed is between 0 and 1, both excluded"
                )

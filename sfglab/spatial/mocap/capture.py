"""What a motion capture system says in one of its frames, whatever system it is."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum
from typing import TYPE_CHECKING, Protocol

from sfglab.errors import SfglabError
from sfglab.spatial.poses import Pose

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Mapping
    from contextlib import AbstractAsyncContextManager


class MocapError(SfglabError):
    """Motion capture that cannot be had, or cannot be used."""


class Lapse(Enum):
    """Why there is no pose."""

    OCCLUDED = "occluded"
    """Too few of the object's markers were seen."""
    INVALID = "invalid"
    """The numbers are no pose: not finite, or a quaternion of length zero."""


Sight = Pose | Lapse
"""An object's pose in the capture system's world, or why there is none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Capture:
    """All objects at one time."""

    number: int | None  #: The system's frame number; None when it has none.
    capture_ns: int  #: When the cameras saw it, by this host's clock.
    receipt_ns: int  #: When it arrived here, by the same clock.
    sights: Mapping[str, Sight]  #: What is known of each object, by its id in the capture system.


class MocapSource(Protocol):
    """Anything that captures come from."""

    def captures(self) -> AbstractAsyncContextManager[AsyncIterator[Capture]]:
        """Open the source; leaving the context closes it."""

"""Transform frames at the border: whose they are, how they are called across it, and which clash.

Paper A, section 4.1: "for transform topics, appropriate frame prefixing is required to prevent TF frame ID
clashes". In the agent's own domain its frames need no prefix; everywhere else they are ``<agent>/<frame>``, so
what stands before the first slash is an agent, and a frame without slash is shared by all, or nobody's in
particular. A transform belongs to whoever owns its child, because a frame has one parent. Pure: knows names of
frames; refuses to know messages (`transforms`) and topics.
"""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.errors import SfglabError
from sfglab.fleet.routing.policy import Direction
from sfglab.names import SHARED_FRAMES, frame_owner, prefixed_frame


class FrameClashError(SfglabError, ValueError):
    """A transform that would move a frame of somebody else.

    Attributes:
        direction: Which way it was to cross the border.
        frame: Its child, as given.
    """

    def __init__(self, direction: Direction, frame: str, allowed: str) -> None:
        self.direction = direction
        self.frame = frame
        super().__init__(f"{direction.value} transform: given the child frame {frame!r}, allowed are {allowed}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Frames:
    """The names of one agent's frames."""

    agent: str  #: The agent.
    #: Frames that all mean by the same name and that are never prefixed.
    shared: frozenset[str] = frozenset(SHARED_FRAMES)
    #: Frames of the agent, without prefix, that others may give a parent, as motion capture does with a robot's
    #: base (paper A, section 4.5).
    placed_by_others: frozenset[str] = frozenset()

    def outward(self, frame: str) -> str:
        """Return a local frame's name in the global domain."""
        return prefixed_frame(frame, self.agent, shared=self.shared)

    def check_outward(self, child: str) -> None:
        """Refuse a transform out of the agent's domain that moves a frame of others.

        Args:
            child: The child frame as the agent's nodes write it.

        Raises:
            FrameClashError: It is a shared frame, it has another agent's prefix, or it is empty.
        """
        frame = child.removeprefix("/")
        if not frame or frame in self.shared or frame_owner(frame) not in {"", self.agent}:
            allowed = f"frames without prefix and those below {self.agent + '/'!r}, but no shared ones"
            raise FrameClashError(Direction.OUTWARD, child, f"{allowed} ({', '.join(sorted(self.shared))})")

    def check_inward(self, child: str) -> None:
        """Refuse a transform into the agent's domain that moves one of its own frames.

        Args:
            child: The child frame as the others write it.

        Raises:
            FrameClashError: It has this agent's prefix and is not among `placed_by_others`, or it is empty.
        """
        frame = child.removeprefix("/")
        own = frame_owner(frame) == self.agent
        if not frame or (own and frame.removeprefix(f"{self.agent}/") not in self.placed_by_others):
            placed = ", ".join(f"{self.agent}/{frame}" for frame in sorted(self.placed_by_others)) or "none"
            raise FrameClashError(
                Direction.INWARD, child, f"frames of others, and of those below {self.agent + '/'!r}: {placed}"
            )


class FrameClaims:
    """Who of the others moves the frames that are nobody's in particular: the first one that does.

    Frames with a prefix need no claim; their name says whose they are.
    """

    def __init__(self) -> None:
        self._owners: dict[str, str] = {}

    def claim(self, child: str, owner: str) -> None:
        """Let an owner move a frame.

        Args:
            child: The child frame.
            owner: Who publishes the transform: an agent's router, or a participant.

        Raises:
            FrameClashError: Somebody else moves it already.
        """
        frame = child.removeprefix("/")
        if "/" in frame or (holder := self._owners.setdefault(frame, owner)) == owner:
            return
        raise FrameClashError(Direction.INWARD, child, f"frames that nobody else publishes, but {holder} does")

    def keep(self, owners: frozenset[str]) -> None:
        """Forget the claims of all owners but these."""
        for frame, owner in list(self._owners.items()):
            if owner not in owners:
                self._owners.pop(frame, None)

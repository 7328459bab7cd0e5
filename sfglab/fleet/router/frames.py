"""Transform frames at the border: whose they are, how they are called across it, and which clash.

Paper A, section 4.1: "for transform topics, appropriate frame prefixing is required to prevent TF frame ID
clashes". In the agent's own domain its frames need no prefix; everywhere else they are ``<agent>/<frame>``, so
what stands before the first slash is an agent, and a frame without slash is shared by all, or nobody's in
particular. A transform belongs to whoever owns its child, because a frame has one parent.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.fleet.policy import Direction
from sfglab.fleet.refusals import SaidOnce
from sfglab.messages import CdrError, deserialize, message_type, serialize
from sfglab.names import SHARED_FRAMES, frame_owner, prefixed_frame

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.forwarding import Transform


class FrameClashError(SfglabError, ValueError):
    """A transform that would move a frame of somebody else."""

    def __init__(self, direction: Direction, frame: str, allowed: str) -> None:
        self.direction = direction  #: Which way it was to cross the border.
        self.frame = frame  #: Its child, as given.
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
        """Refuse a transform of the agent's nodes, by its child frame, that moves a frame of others.

        Raises:
            FrameClashError: It is a shared frame, it has another agent's prefix, or it is empty.
        """
        frame = child.removeprefix("/")
        if not frame or frame in self.shared or frame_owner(frame) not in {"", self.agent}:
            allowed = f"frames without prefix and those below {self.agent + '/'!r}, but no shared ones"
            raise FrameClashError(Direction.OUTWARD, child, f"{allowed} ({', '.join(sorted(self.shared))})")

    def check_inward(self, child: str) -> None:
        """Refuse a transform of others, by its child frame, that moves one of the agent's own.

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
        """Let an owner, an agent's router or a participant, move a frame.

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


TF_TYPE = "tf2_msgs/msg/TFMessage"
_log = logging.getLogger(__name__)


@dataclass(slots=True)
class FrameCounts:
    """What happened to transforms at the border."""

    prefixed: int = 0  #: Transforms that got other names on their way out.
    clashed: int = 0  #: Transforms that were dropped.


class TransformGate:
    """Lets an agent's transforms out under its prefix, and those of others in if they clash with nothing."""

    def __init__(self, frames: Frames) -> None:
        self.counts = FrameCounts()
        self._frames = frames
        self._claims = FrameClaims()
        self._say = SaidOnce(_log)
        self._type = message_type(TF_TYPE)

    def outward(self, cdr: bytes) -> bytes | None:
        """Return a message of the agent's nodes as the others are to see it; None when nothing is left."""
        return self._passed(cdr, self._let_out)

    def inward(self, owner: str) -> Transform:
        """Return what is done with messages of one of the others."""
        return partial(self._passed, check=partial(self._let_in, owner))

    def keep_owners(self, owners: frozenset[str]) -> None:
        """Forget all others but these."""
        self._claims.keep(owners)

    def _passed(self, cdr: bytes, check: Callable[[Any], bool]) -> bytes | None:
        """Return the message with the transforms that pass; the same object when nothing changed."""
        try:
            message = deserialize(cdr, self._type)
        except CdrError as error:
            self._clash(str(error), "no transforms")
            return None
        changed, passed = False, []
        for transform in message.transforms:
            try:
                changed |= check(transform)
                passed.append(transform)
            except FrameClashError as error:
                self._clash(str(error), error.frame)
        if message.transforms and not passed:
            return None
        return cdr if len(passed) == len(message.transforms) and not changed else serialize(self._type(passed))

    def _let_out(self, transform: Any) -> bool:
        """Rename a transform's frames; return whether that changed anything."""
        frames = self._frames
        frames.check_outward(transform.child_frame_id)
        before = transform.header.frame_id, transform.child_frame_id
        after = frames.outward(before[0]), frames.outward(before[1])
        transform.header.frame_id, transform.child_frame_id = after
        self.counts.prefixed += after != before
        return after != before

    def _let_in(self, owner: str, transform: Any) -> bool:
        self._frames.check_inward(transform.child_frame_id)
        self._claims.claim(transform.child_frame_id, owner)
        return False

    def _clash(self, why: str, frame: str) -> None:
        self.counts.clashed += 1
        self._say(frame, f"{why}; it is dropped, and further ones of it silently")

"""Transform frames at the border: whose they are, how they are called across it, and which clash.

Paper A, section 4.1: "for transform topics, appropriate frame prefixing is required to prevent TF frame ID
clashes". Outside the agent's own domain its frames are ``<agent>/<frame>``. A frame without slash is shared by
all and named in the fleet file, or it stays outside: inside, its name would mean a frame of the agent. A
transform belongs to whoever owns its child, because a frame has one parent.
"""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.fleet.policy import Direction
from sfglab.fleet.refusals import SaidOnce
from sfglab.messages import CdrError, deserialize, message_type, serialize
from sfglab.names import SHARED_FRAMES, frame_owner, prefixed_frame

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from sfglab.bus.forwarding import Transform


MAX_FRAME = 255  #: Longest name of a frame of others, in characters.
MAX_CLAIMS = 1000  #: Most frames that one of the others moves; of all together ten times as many.


class FrameClashError(SfglabError, ValueError):
    """A transform that would move a frame of somebody else."""

    def __init__(self, direction: Direction, frame: str, allowed: str) -> None:
        self.direction = direction  #: Which way it was to cross the border.
        self.frame = frame  #: Its child, as given.
        self.allowed = allowed  #: What is.
        given = f"given the child frame {_short(frame)!r}, allowed are {allowed}"
        super().__init__(f"{direction.value} transform: {given}")


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
            allowed = (
                f"frames without prefix and those below {self.agent + '/'!r}, but no shared ones"
            )
            raise FrameClashError(
                Direction.OUTWARD, child, f"{allowed} ({', '.join(sorted(self.shared))})"
            )

    def check_inward(self, child: str, parent: str = "map") -> None:
        """Refuse a transform of others that moves one of the agent's own frames, or could.

        Raises:
            FrameClashError: Its child has this agent's prefix and is not among `placed_by_others`; or child or
                parent has no prefix and is not shared, so that inside it would mean another, or is too long.
        """
        frame, below = child.removeprefix("/"), parent.removeprefix("/")
        owner, shared = frame_owner(frame), ", ".join(sorted(self.shared))
        own = (
            owner == self.agent
            and frame.removeprefix(f"{self.agent}/") not in self.placed_by_others
        )
        if not frame or own or not (owner or frame in self.shared):
            placed = (
                ", ".join(f"{self.agent}/{frame}" for frame in sorted(self.placed_by_others))
                or "none"
            )
            allowed = f"frames of others, by prefix or shared ({shared}), and of those below"
            raise FrameClashError(
                Direction.INWARD, child, f"{allowed} {self.agent + '/'!r}: {placed}"
            )
        if (
            not (frame_owner(below) or below in self.shared)
            or max(len(frame), len(below)) > MAX_FRAME
        ):
            allowed = f"those below parents with a prefix or shared ({shared}), of {MAX_FRAME} characters each"
            raise FrameClashError(
                Direction.INWARD, child, f"{allowed}, and its parent is {_short(parent)!r}"
            )


class FrameClaims:
    """Who of the others moves a frame: the first one that does, until it has gone; bounded."""

    def __init__(self) -> None:
        self._owners: dict[str, str] = {}
        self._held: Counter[str] = Counter()
        self._contested: set[str] = set()

    def claim(self, child: str, owner: str) -> None:
        """Let an owner, an agent's router or a participant, move a frame.

        Raises:
            FrameClashError: Somebody else moves it already, or this one moves too many.
        """
        frame = child.removeprefix("/")
        if (holder := self._owners.get(frame)) == owner:
            return
        if holder is not None:
            self._contested.add(frame)
            allowed = f"frames that nobody else publishes, but {holder} does, and now {owner}"
            raise FrameClashError(Direction.INWARD, child, allowed)
        held = self._held[owner]
        if held >= MAX_CLAIMS or len(self._owners) >= 10 * MAX_CLAIMS or len(frame) > MAX_FRAME:
            allowed = f"{MAX_CLAIMS} frames of one publisher, of at most {MAX_FRAME} characters"
            raise FrameClashError(Direction.INWARD, child, f"{allowed}, and {owner} has {held}")
        self._owners[frame] = owner
        self._held[owner] += 1

    def keep(self, owners: frozenset[str]) -> bool:
        """Forget the claims of all owners but these; return whether somebody else had wanted one of them."""
        free = {frame for frame, owner in list(self._owners.items()) if owner not in owners}
        for frame in free:
            self._owners.pop(frame, None)
        self._held = Counter(list(self._owners.values()))
        wanted = bool(free & self._contested)
        self._contested -= free
        return wanted


TF_TYPE = "tf2_msgs/msg/TFMessage"
_log = logging.getLogger(__name__)


class TransformGate:
    """Lets an agent's transforms out under its prefix, and those of others in if they clash with nothing."""

    def __init__(self, frames: Frames) -> None:
        self.clashed = 0  #: Transforms that were dropped.
        self._frames = frames
        self._claims = FrameClaims()
        self._own: set[str] = (
            set()
        )  # shared frames that the agent's nodes place themselves, as far as seen
        self._say = SaidOnce(_log)
        self._type = message_type(TF_TYPE)

    def outward(self, cdr: bytes) -> bytes | None:
        """Return a message of the agent's nodes as the others are to see it; None when nothing is left."""
        return self._passed(cdr, self._let_out)

    def inward(self, owner: str) -> Transform:
        """Return what is done with messages of one of the others."""
        return partial(self._passed, check=partial(self._let_in, owner))

    def keep_owners(self, owners: frozenset[str]) -> bool:
        """Forget all others but these; return whether somebody else had wanted to move a frame of theirs."""
        return self._claims.keep(owners)

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
                self._clash(str(error), (error.direction, _short(error.frame)))
        if message.transforms and not passed:
            return None
        return (
            cdr
            if len(passed) == len(message.transforms) and not changed
            else serialize(self._type(passed))
        )

    def _let_out(self, transform: Any) -> bool:
        """Rename a transform's frames; return whether that changed anything."""
        frames = self._frames
        self._own |= frames.shared & {transform.child_frame_id.removeprefix("/")}
        frames.check_outward(transform.child_frame_id)
        before = transform.header.frame_id, transform.child_frame_id
        after = frames.outward(before[0]), frames.outward(before[1])
        transform.header.frame_id, transform.child_frame_id = after
        return after != before

    def _let_in(self, owner: str, transform: Any) -> bool:
        child, parent = transform.child_frame_id, transform.header.frame_id
        if child.removeprefix("/") in self._own:
            holder = f"{self._frames.agent} itself"
            allowed = f"frames that nobody else publishes, but {holder} does, and now {owner}"
            raise FrameClashError(Direction.INWARD, child, allowed)
        try:
            self._frames.check_inward(child, parent)
        except FrameClashError as error:
            raise FrameClashError(
                Direction.INWARD, child, f"{error.allowed}; it is from {owner}"
            ) from None
        self._claims.claim(child, owner)
        return False

    def _clash(self, why: str, what: Hashable) -> None:
        self.clashed += 1
        self._say(what, f"{why}; it is dropped, and further ones of it silently")


def _short(frame: str) -> str:
    return frame if len(frame) <= MAX_FRAME else frame[:MAX_FRAME] + "..."

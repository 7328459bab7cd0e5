"""Transform frames at the domain boundary: names, owners and clashes.

Paper A, section 4.1: "for transform topics, appropriate frame prefixing is required to prevent TF frame ID
clashes". Outside the agent's domain its frames are ``<agent>/<frame>``. A frame without slash is common to all
agents and named in the fleet file, or it stays outside: inside, the name would mean a frame of the agent. A
transform belongs to the owner of its child frame, because a frame has one parent.
"""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.errors import SfglabError
from sfglab.fleet.policy import Direction
from sfglab.fleet.refusals import WarnOnce
from sfglab.messages import CdrError, deserialize, message_type, serialize
from sfglab.names import SHARED_FRAMES, frame_owner, prefixed_frame

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable, Iterable

    from sfglab.bus.forwarding import Transform


MAX_FRAME = 255  #: Maximum length of the name of another agent's frame, characters.
MAX_CLAIMS = 1000  #: Maximum number of frames of one publisher; ten times as many for all together.
TF_TYPE = "tf2_msgs/msg/TFMessage"
_log = logging.getLogger(__name__)


class FrameClashError(SfglabError, ValueError):
    """A transform that would move a frame of another owner."""

    def __init__(self, direction: Direction, frame: str, allowed: str) -> None:
        self.direction = direction  #: Direction across the boundary.
        self.frame = frame  #: Child frame, as given.
        self.allowed = allowed  #: Allowed child frames.
        given = f"given the child frame {_short(frame)!r}, allowed are {allowed}"
        super().__init__(f"{direction.value} transform: {given}")


@dataclass(frozen=True, slots=True, kw_only=True)
class Frames:
    """Names of one agent's frames."""

    agent: str  #: Name of the agent.
    #: Frames without prefix, common to all agents.
    shared: frozenset[str] = frozenset(SHARED_FRAMES)
    #: Frames of the agent, without prefix, to which others may publish a parent, as motion capture does with a
    #: robot's base (paper A, section 4.5).
    placed_by_others: frozenset[str] = frozenset()

    def outward(self, frame: str) -> str:
        """Return a local frame's name in the global domain."""
        return prefixed_frame(frame, self.agent, shared=self.shared)

    def check_outward(self, child: str) -> None:
        """Check the child frame of a transform of the agent's nodes.

        Raises:
            FrameClashError: It is a shared frame, it has another agent's prefix, or it is empty.
        """
        frame = child.removeprefix("/")
        if not frame or frame in self.shared or frame_owner(frame) not in {"", self.agent}:
            own = f"frames without prefix and those below {self.agent + '/'!r}"
            allowed = f"{own}, but no shared ones ({_listed(self.shared)})"
            raise FrameClashError(Direction.OUTWARD, child, allowed)

    def check_inward(self, child: str, parent: str = "map") -> None:
        """Check a transform of others, which must not move the agent's frames.

        Raises:
            FrameClashError: Its child has this agent's prefix and is not among `placed_by_others`; or child or
                parent has no prefix and is not shared, so that inside it would mean another frame, or is too
                long.
        """
        frame, below = child.removeprefix("/"), parent.removeprefix("/")
        if not frame or self._is_own(frame) or not self._is_known(frame):
            placed = [f"{self.agent}/{name}" for name in self.placed_by_others]
            allowed = (
                f"frames of others, by prefix or shared ({_listed(self.shared)}), and of those below "
                f"{self.agent + '/'!r}: {_listed(placed) or 'none'}"
            )
            raise FrameClashError(Direction.INWARD, child, allowed)
        if not self._is_known(below) or max(len(frame), len(below)) > MAX_FRAME:
            allowed = (
                f"those below parents with a prefix or shared ({_listed(self.shared)}), of {MAX_FRAME} "
                f"characters each, and its parent is {_short(parent)!r}"
            )
            raise FrameClashError(Direction.INWARD, child, allowed)

    def _is_known(self, frame: str) -> bool:
        return bool(frame_owner(frame)) or frame in self.shared

    def _is_own(self, frame: str) -> bool:
        """Return whether a frame is the agent's and not placed by others."""
        name = frame.removeprefix(f"{self.agent}/")
        return frame_owner(frame) == self.agent and name not in self.placed_by_others


class FrameClaims:
    """Owners of other agents' frames: the first publisher of a frame, until it has gone. Bounded."""

    def __init__(self) -> None:
        self._owners: dict[str, str] = {}
        self._held: Counter[str] = Counter()
        self._contested: set[str] = set()

    def claim(self, child: str, owner: str) -> None:
        """Give a frame to an owner, an agent's router or a participant.

        Raises:
            FrameClashError: Another owner has it already, or this one has too many.
        """
        frame = child.removeprefix("/")
        holder = self._owners.get(frame)
        if holder == owner:
            return
        if holder is not None:
            self._contested.add(frame)
            allowed = f"frames that no other publishes, but {holder} does, and now {owner}"
            raise FrameClashError(Direction.INWARD, child, allowed)
        held = self._held[owner]
        if held >= MAX_CLAIMS or len(self._owners) >= 10 * MAX_CLAIMS or len(frame) > MAX_FRAME:
            allowed = f"{MAX_CLAIMS} frames of one publisher, of at most {MAX_FRAME} characters"
            raise FrameClashError(Direction.INWARD, child, f"{allowed}, and {owner} has {held}")
        self._owners[frame] = owner
        self._held[owner] += 1

    def keep(self, owners: frozenset[str]) -> bool:
        """Forget the frames of all owners but these; return whether another had claimed one of them."""
        # DDS threads may claim frames meanwhile, so each pass works on a copy.
        free = {frame for frame, owner in list(self._owners.items()) if owner not in owners}
        for frame in free:
            self._owners.pop(frame, None)
        self._held = Counter(list(self._owners.values()))
        was_contested = bool(free & self._contested)
        self._contested -= free
        return was_contested


class TransformGate:
    """Renames the agent's transforms on their way out, and drops transforms whose frames clash."""

    def __init__(self, frames: Frames) -> None:
        self.clashed = 0  #: Number of dropped transforms.
        self._frames = frames
        self._claims = FrameClaims()
        self._own: set[str] = set()  # shared frames that the agent's nodes have placed themselves
        self._warn = WarnOnce(_log)
        self._type = message_type(TF_TYPE)

    def outward(self, cdr: bytes) -> bytes | None:
        """Return a message of the agent's nodes as others receive it; None if no transform is left."""
        return self._filtered(cdr, self._rename)

    def inward(self, owner: str) -> Transform:
        """Return the function that filters messages of another publisher."""
        return partial(self._filtered, accept=partial(self._admit, owner))

    def keep_owners(self, owners: frozenset[str]) -> bool:
        """Forget all other publishers; return whether another had claimed one of their frames."""
        return self._claims.keep(owners)

    def _filtered(self, cdr: bytes, accept: Callable[[Any], bool]) -> bytes | None:
        """Return the message with the accepted transforms; the same object if nothing changed."""
        try:
            message = deserialize(cdr, self._type)
        except CdrError as error:
            self._drop(str(error), "no transforms")
            return None
        changed, accepted = False, []
        for transform in message.transforms:
            try:
                changed |= accept(transform)
                accepted.append(transform)
            except FrameClashError as error:
                self._drop(str(error), (error.direction, _short(error.frame)))
        if message.transforms and not accepted:
            return None
        if changed or len(accepted) < len(message.transforms):
            return serialize(self._type(accepted))
        return cdr

    def _rename(self, transform: Any) -> bool:
        """Rename a transform's frames; return whether that changed anything."""
        frames = self._frames
        self._own |= frames.shared & {transform.child_frame_id.removeprefix("/")}
        frames.check_outward(transform.child_frame_id)
        before = transform.header.frame_id, transform.child_frame_id
        after = frames.outward(before[0]), frames.outward(before[1])
        transform.header.frame_id, transform.child_frame_id = after
        return after != before

    def _admit(self, owner: str, transform: Any) -> bool:
        child, parent = transform.child_frame_id, transform.header.frame_id
        if child.removeprefix("/") in self._own:
            holder = f"{self._frames.agent} itself"
            allowed = f"frames that no other publishes, but {holder} does, and now {owner}"
            raise FrameClashError(Direction.INWARD, child, allowed)
        try:
            self._frames.check_inward(child, parent)
        except FrameClashError as error:
            allowed = f"{error.allowed}; it is from {owner}"
            raise FrameClashError(Direction.INWARD, child, allowed) from None
        self._claims.claim(child, owner)
        return False

    def _drop(self, why: str, key: Hashable) -> None:
        self.clashed += 1
        self._warn(key, f"{why}; it is dropped, and further ones of it silently")


def _listed(frames: Iterable[str]) -> str:
    return ", ".join(sorted(frames))


def _short(frame: str) -> str:
    return frame if len(frame) <= MAX_FRAME else frame[:MAX_FRAME] + "..."

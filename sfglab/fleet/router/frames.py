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


@dataclass(frozen=True, slots=True, kw_only=True)
class Frames:
    """Rules for the names of one agent's TF frames."""

    agent: str  #: Name of the agent.
    #: Frames without prefix, common to all agents.
    shared: frozenset[str] = frozenset(SHARED_FRAMES)
    #: Frames of the agent, without prefix, to which others may publish a parent, as motion capture does with a
    #: robot's base (paper A, section 4.5).
    placed_by_others: frozenset[str] = frozenset()

    def outward(self, frame: str) -> str:
        """Return the global name of a frame of the agent's domain, with the agent's prefix if it gets one."""
        return prefixed_frame(frame, self.agent, shared=self.shared)

    def outward_refusal(self, child: str) -> str:
        """Return why a transform of the agent's nodes is dropped, by its child frame; empty if it may pass.

        Shared frames, frames with another agent's prefix, and empty names are refused.
        """
        frame = child.removeprefix("/")
        if frame and frame not in self.shared and frame_owner(frame) in {"", self.agent}:
            return ""
        own = f"frames without prefix and those below {self.agent + '/'!r}"
        allowed = f"{own}, but no shared ones ({_listed(self.shared)})"
        return _refusal(Direction.OUTWARD, _child(child), allowed)

    def inward_refusal(self, child: str, parent: str = "map") -> str:
        """Return why a transform of others is dropped; empty if it may pass.

        The transform must not move the agent's frames, except those in `placed_by_others`. Names that are longer than
        `MAX_FRAME`, and names that have no prefix and are not shared, are refused: inside, the latter would mean
        another frame.
        """
        frame, below = child.removeprefix("/"), parent.removeprefix("/")
        known = (
            f"frames with the prefix of an agent or shared ({_listed(self.shared)}), of at most "
            f"{MAX_FRAME} characters"
        )
        if self._is_own(frame) or not self._is_known(frame):
            placed = [f"{self.agent}/{name}" for name in self.placed_by_others]
            allowed = (
                f"{known}, and of those below {self.agent + '/'!r}: {_listed(placed) or 'none'}"
            )
            return _refusal(Direction.INWARD, _child(child), allowed)
        if not self._is_known(below):
            given = f"the parent frame {_short(parent)!r} of {_short(child)!r}"
            return _refusal(Direction.INWARD, given, known)
        return ""

    def _is_known(self, frame: str) -> bool:
        """Return whether a frame means the same inside and outside."""
        return len(frame) <= MAX_FRAME and (bool(frame_owner(frame)) or frame in self.shared)

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

    def claim(self, child: str, owner: str) -> str:
        """Give a frame to an owner, an agent's router or a participant; return why not, or an empty text."""
        frame = child.removeprefix("/")
        holder = self._owners.get(frame)
        if holder == owner:
            return ""
        if holder is not None:
            self._contested.add(frame)
            return _contested(child, holder, owner)
        held = self._held[owner]
        if held >= MAX_CLAIMS or len(self._owners) >= 10 * MAX_CLAIMS:
            allowed = f"{MAX_CLAIMS} frames of one publisher, and {owner} has {held}"
            return _refusal(Direction.INWARD, _child(child), allowed)
        self._owners[frame] = owner
        self._held[owner] += 1
        return ""

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
        self._frames = frames
        self._claims = FrameClaims()
        self._own: set[str] = set()  # shared frames that the agent's nodes have placed themselves
        self._warn = WarnOnce(_log)
        self._type = message_type(TF_TYPE)

    def outward(self, cdr: bytes) -> bytes | None:
        """Return a message of the agent's nodes as others receive it; None if no transform is left."""
        return self._filtered(cdr, Direction.OUTWARD, self._admit_own)

    def inward(self, owner: str) -> Transform:
        """Return the function that filters messages of another publisher."""
        admit = partial(self._admit_other, owner)
        return partial(self._filtered, direction=Direction.INWARD, admit=admit)

    def keep_owners(self, owners: frozenset[str]) -> bool:
        """Forget all other publishers; return whether another had claimed one of their frames."""
        return self._claims.keep(owners)

    def _filtered(
        self, cdr: bytes, direction: Direction, admit: Callable[[Any], str]
    ) -> bytes | None:
        """Return the message with the admitted transforms; the same object if nothing changed."""
        try:
            transforms = deserialize(cdr, self._type).transforms
        except CdrError as error:
            self._warn_dropped((direction, None), str(error))
            return None
        before = [_names(transform) for transform in transforms]
        admitted = []
        for transform in transforms:
            refusal = admit(transform)
            if refusal:
                # The key has no parent, because a child with many parents must not use up the warnings.
                self._warn_dropped((direction, _short(transform.child_frame_id)), refusal)
            else:
                admitted.append(transform)
        if transforms and not admitted:
            return None
        is_same = before == [_names(transform) for transform in admitted]
        return cdr if is_same else serialize(self._type(admitted))

    def _admit_own(self, transform: Any) -> str:
        """Rename the frames of a transform, or return why it is dropped."""
        parent, child = _names(transform)
        self._own |= self._frames.shared & {child.removeprefix("/")}
        refusal = self._frames.outward_refusal(child)
        if not refusal:
            transform.header.frame_id = self._frames.outward(parent)
            transform.child_frame_id = self._frames.outward(child)
        return refusal

    def _admit_other(self, owner: str, transform: Any) -> str:
        parent, child = _names(transform)
        if child.removeprefix("/") in self._own:
            return _contested(child, f"{self._frames.agent} itself", owner)
        refusal = self._frames.inward_refusal(child, parent)
        return f"{refusal}; it is from {owner}" if refusal else self._claims.claim(child, owner)

    def _warn_dropped(self, key: Hashable, why: str) -> None:
        self._warn(key, f"{why}; it is dropped, and further ones of it silently")


def _names(transform: Any) -> tuple[str, str]:
    return transform.header.frame_id, transform.child_frame_id


def _refusal(direction: Direction, given: str, allowed: str) -> str:
    return f"{direction.value} transform: given {given}, allowed: {allowed}"


def _child(frame: str) -> str:
    return f"the child frame {_short(frame)!r}"


def _contested(child: str, holder: str, owner: str) -> str:
    allowed = f"frames that no other publishes, but {holder} does, and now {owner}"
    return _refusal(Direction.INWARD, _child(child), allowed)


def _listed(frames: Iterable[str]) -> str:
    return ", ".join(sorted(frames))


def _short(frame: str) -> str:
    return frame if len(frame) <= MAX_FRAME else frame[:MAX_FRAME] + "..."

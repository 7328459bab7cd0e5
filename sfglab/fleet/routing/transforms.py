"""The transform topics at the border: prefixes on the way out, and nothing that clashes either way.

Knows the message (`tf2_msgs/msg/TFMessage`) and the rules of `frames`. What is made here for one direction is
called in one thread only, the one that reads there; counts may be read from any.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any

from sfglab.fleet.routing.frames import FrameClaims, FrameClashError, Frames
from sfglab.messages import CdrError, deserialize, message_type, serialize

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus.forwarding import Transform


TF_TYPE = "tf2_msgs/msg/TFMessage"
_log = logging.getLogger(__name__)
_MAX_SAID = 1000


@dataclass(slots=True)
class FrameCounts:
    """What happened to transforms at the border."""

    prefixed: int = 0  #: Transforms that got other names on their way out.
    clashed: int = 0  #: Transforms that were dropped.


class TransformGate:
    """Lets an agent's transforms out under its prefix, and those of others in if they clash with nothing.

    Args:
        frames: The agent's frames.
    """

    def __init__(self, frames: Frames) -> None:
        self.counts = FrameCounts()
        self._frames = frames
        self._claims = FrameClaims()
        self._said: set[str] = set()
        self._type = message_type(TF_TYPE)

    def outward(self, cdr: bytes) -> bytes | None:
        """Return a message of the agent's nodes as the others are to see it; None when nothing is left."""
        return self._passed(cdr, self._let_out)

    def inward(self, owner: str) -> Transform:
        """Return what is done with messages of one of the others.

        Args:
            owner: Who publishes them.
        """
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
        if frame not in self._said and len(self._said) < _MAX_SAID:
            self._said.add(frame)
            _log.warning("%s; it is dropped, and further ones of it silently", why)

"""Which names of frames are right: ``<agent>/<frame>``, and the few that all agents share.

Paper A, section 4.1, asks for prefixes so that the frames of different agents do not clash. The rule itself is
`sfglab.names`', which the fleet's routers follow too; here it is judged.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass

from sfglab.names import SHARED_FRAMES as _SHARED
from sfglab.names import frame_owner, prefixed_frame, validate_agent

SHARED_FRAMES = frozenset(_SHARED)
"""Roots that all agents mean by the same name."""


def prefixed(frame: str, agent: str, *, shared: frozenset[str] = SHARED_FRAMES) -> str:
    """Return what an agent's frame is called by everybody else, see `sfglab.names.prefixed_frame`."""
    return prefixed_frame(frame, agent, shared=shared)


def agent_of(frame: str) -> str:
    """Return the agent whose frame it is; empty for a frame without prefix."""
    return frame_owner(frame)


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameRule:
    """Which names frames may have.

    Raises:
        FqnError: A name is none that an agent may bear.
    """

    agents: frozenset[str]  #: Agents whose prefixes are known.
    shared: frozenset[str] = SHARED_FRAMES  #: Frames without prefix that are allowed.

    def __post_init__(self) -> None:
        for agent in self.agents:
            validate_agent(agent)

    def problem(self, frame: str, known: frozenset[str] = frozenset()) -> str | None:
        """Say what is wrong with a name, or return None.

        Args:
            frame: The name.
            known: Names among which to look for what was meant.
        """
        agent, slash, rest = frame.partition("/")
        if frame in self.shared or (slash and agent in self.agents and rest and not rest.startswith("/")):
            return None
        fitting = sorted(name for name in known - {frame} if self.problem(name) is None)
        near = difflib.get_close_matches(frame, fitting, n=1)
        hint = f"; did you mean {near[0]!r}?" if near else ""
        allowed = f"<agent>/<frame> of {', '.join(sorted(self.agents)) or 'no agent'}"
        return (
            f"given {frame!r}, allowed are {allowed}, and {', '.join(sorted(self.shared)) or 'nothing'}{hint}"
        )

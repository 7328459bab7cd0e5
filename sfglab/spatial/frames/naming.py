"""What frames are called: ``<agent>/<frame>``, and the few that all agents share.

Paper A, section 4.1, asks for prefixes so that the frames of different agents do not clash: a topic of agent
go2 is ``/global/go2/...``, its frames are ``go2/...``. The rule is that of the fleet's routers, for those who
read frames.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass

from sfglab.names import validate_agent

__all__ = ["SHARED_FRAMES", "FrameRule", "agent_of", "prefixed"]

SHARED_FRAMES = frozenset({"map", "earth", "world"})
"""Roots that all agents mean by the same name: REP 105's, without `odom`, which every agent has of its own."""


def prefixed(frame: str, agent: str, *, shared: frozenset[str] = SHARED_FRAMES) -> str:
    """Return what an agent's frame is called by everybody else.

    Args:
        frame: As the agent's own nodes write it; a name with a slash inside has its prefix already.
        agent: The agent; empty leaves the name as it is.
        shared: Frames that are never prefixed.
    """
    frame = frame.removeprefix("/")  # as tf2 does
    return frame if not agent or "/" in frame or frame in shared else f"{agent}/{frame}"


def agent_of(frame: str) -> str:
    """Return the agent whose frame it is; empty for a frame without prefix."""
    agent, slash, _ = frame.partition("/")
    return agent if slash else ""


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameRule:
    """Which names frames may have.

    Attributes:
        agents: Agents whose prefixes are known.
        shared: Frames without prefix that are allowed.

    Raises:
        FqnError: A name is none that an agent may bear.
    """

    agents: frozenset[str]
    shared: frozenset[str] = SHARED_FRAMES

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

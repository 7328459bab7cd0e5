"""Names of frames across agents: ``<agent>/<frame>``, and the few that all agents share.

Paper A, section 4.1: "for transform topics, appropriate frame prefixing is required to prevent TF frame ID
clashes". How the prefix looks is not in the paper; ours is the agent's segment of the FQN schema: a topic of
agent go2 is ``/global/go2/...``, its frames are ``go2/...``. One rule for routers, who rename at the border,
and for those who read frames.
"""

from __future__ import annotations

SHARED_FRAMES = ("map", "earth", "world")
"""Roots that all agents mean by the same name: REP 105's, without `odom`, which every agent has of its own."""


def prefixed_frame(frame: str, agent: str, *, shared: frozenset[str] = frozenset(SHARED_FRAMES)) -> str:
    """Return what an agent's frame is called by everybody else.

    Args:
        frame: As the agent's own nodes write it; a name with a slash inside has its prefix already.
        agent: The agent; empty leaves the name as it is.
        shared: Frames that are never prefixed.
    """
    frame = frame.removeprefix("/")  # as tf2 does
    return frame if not agent or "/" in frame or frame in shared else f"{agent}/{frame}"


def frame_owner(frame: str) -> str:
    """Return the agent whose frame it is; empty for a frame without prefix."""
    agent, slash, _ = frame.partition("/")
    return agent if slash else ""

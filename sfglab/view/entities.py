"""Where things stand in the viewer: from a ROS topic to an entity, one root per agent.

Pure. A name of the schema (paper A, section 4.1) lands below its agent, whichever scope it has, so one click
hides an agent: ``/global/go2/camera_front/color/ffmpeg`` is ``/agents/go2/global/camera_front/color/ffmpeg``.
Other topics keep their names.
"""

from __future__ import annotations

from sfglab.names import FqnError, parse

AGENTS = "/agents"
"""The root of all agents."""


def agent_root(agent: str) -> str:
    """Return the entity below which everything of an agent stands."""
    return f"{AGENTS}/{agent}"


def agent_of_topic(topic: str) -> str | None:
    """Return whose topic it is by the schema; None for one of nobody, or outside the schema."""
    try:
        return parse(topic).agent
    except FqnError:
        return None


def entity_of_topic(topic: str) -> str:
    """Return the entity of a topic."""
    agent = agent_of_topic(topic)
    if agent is None:
        return topic
    scope, _, *rest = topic.strip("/").split("/")
    return "/".join((agent_root(agent), scope, *rest))

"""Agents' names: which ones there may be, which one an agent has by default, and the frames that bear it.

Paper A, section 4.1: the set A is resolved at run time, from `SFG_AGENT_NAME` or the sanitised host name; and
"for transform topics, appropriate frame prefixing is required to prevent TF frame ID clashes". How the prefix
looks is ours: the agent's segment, so that frames of agent go2 are ``go2/...``.
"""

from __future__ import annotations

import os
import re
import socket
from typing import TYPE_CHECKING

from sfglab.names.grammar import FqnError, check_words, router_breaks
from sfglab.names.vocabulary import Component, check_unmistakable

if TYPE_CHECKING:
    from collections.abc import Mapping

AGENT_VARIABLE = "SFG_AGENT_NAME"  #: The environment variable that names the agent.


def validate_agent(agent: str) -> str:
    """Return an agent's name unchanged if every name of the schema can carry it.

    Refused beside wrong characters: what reads as a scope, component, stream or resource, so that a forgotten
    agent is found; and what a DDS router breaks in `/global/<agent>/get_metadata`, such as `torq`.

    Raises:
        FqnError: With segment `agent`.
    """
    check_words("agent", agent)
    check_unmistakable("agent", agent, own=Component)
    if router_breaks(agent, followed=True):
        allowed = "a name without 'Request' or 'Reply' that does not end in 'rq' or 'rr'"
        raise FqnError("agent", agent, f"{allowed}: a DDS router breaks it")
    return agent


def sanitize_agent(hostname: str) -> str:
    """Return the agent's name that a host name stands for.

    The first label in lower case, every run of other characters than ASCII letters and digits one
    underscore, none at the ends, and `agent_` before a leading digit: `Go2-Jetson.local` is `go2_jetson`,
    `7up` is `agent_7up`. Hosts that differ only in what is dropped get the same name: set `SFG_AGENT_NAME`.

    Raises:
        FqnError: If nothing remains, or what remains is not a name for an agent.
    """
    label = hostname.partition(".")[0].lower()
    name = re.sub(r"[^a-z0-9]+", "_", label).strip("_")
    if not name:
        raise FqnError(
            "agent", hostname, f"a host name with ASCII letters or digits; or set {AGENT_VARIABLE}"
        )
    if name[0].isdigit():
        name = f"agent_{name}"
    return _validated(name, f"or set {AGENT_VARIABLE}; this comes from host name {hostname!r}")


def default_agent(environ: Mapping[str, str] = os.environ, hostname: str | None = None) -> str:
    """Return this agent's name: `SFG_AGENT_NAME` if set, else the sanitised host name.

    Raises:
        FqnError: If the variable holds no valid name (it is never changed, and empty is not unset), or the
            host name gives none.
    """
    given = environ.get(AGENT_VARIABLE)
    if given is not None:
        return _validated(given, f"this comes from {AGENT_VARIABLE}")
    return sanitize_agent(socket.gethostname() if hostname is None else hostname)


def _validated(agent: str, origin: str) -> str:
    try:
        return validate_agent(agent)
    except FqnError as error:
        raise FqnError("agent", agent, f"{error.allowed}; {origin}") from error


SHARED_FRAMES = ("map", "earth", "world")  #: Roots that all agents share: REP 105's without `odom`.


def prefixed_frame(
    frame: str, agent: str, *, shared: frozenset[str] = frozenset(SHARED_FRAMES)
) -> str:
    """Return a frame's name as others see it: the agent's prefix, where there is an agent and no slash yet."""
    frame = frame.removeprefix("/")  # as tf2 does
    return frame if not agent or "/" in frame or frame in shared else f"{agent}/{frame}"


def frame_owner(frame: str) -> str:
    """Return the agent whose frame it is; empty for a frame without prefix."""
    agent, slash, _ = frame.partition("/")
    return agent if slash else ""

"""Names of agents: allowed names, the default name, and the prefix of TF frames.

Paper A, section 4.1: the set A is resolved at run time, from `SFG_AGENT_NAME` or the sanitised host name;
and "for transform topics, appropriate frame prefixing is required to prevent TF frame ID clashes". The form
of the prefix is ours. It is the agent's segment, so that frames of agent go2 are ``go2/...``.
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

    Three kinds of names are refused: names with wrong characters; the names of scopes, components, streams and
    resources, so that a forgotten agent is detected; and names that a DDS router breaks in
    `/global/<agent>/get_metadata`, such as `torq`.

    Raises:
        FqnError: The name is refused; the error's segment is ``agent``.
    """
    check_words("agent", agent)
    check_unmistakable("agent", agent, own=Component)
    if router_breaks(agent, followed=True):
        allowed = "a name without 'Request' or 'Reply' that does not end in 'rq' or 'rr'"
        raise FqnError("agent", agent, f"{allowed}: a DDS router breaks it")
    return agent


def sanitize_agent(hostname: str) -> str:
    """Return the agent's name for a host name.

    It is the first label of the host name, in lower case. Each run of characters other than ASCII letters
    and digits becomes one underscore, and none remains at the ends. A leading digit gets the prefix
    `agent_`: `Go2-Jetson.local` gives `go2_jetson`, `7up` gives `agent_7up`. Hosts that differ only in
    removed parts get the same name; set `SFG_AGENT_NAME` there.

    Raises:
        FqnError: Nothing remains, or the rest is not a name for an agent.
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
        FqnError: The variable holds no valid name, or the host name gives none. The variable's value is never
            changed, and an empty value counts as set.
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


#: Root frames that all agents share: those of REP 105 without `odom`.
SHARED_FRAMES = ("map", "earth", "world")


def prefixed_frame(
    frame: str, agent: str, *, shared: frozenset[str] = frozenset(SHARED_FRAMES)
) -> str:
    """Return the name of a frame outside the agent: prefixed, if there is an agent and the name has no slash."""
    frame = frame.removeprefix("/")  # as tf2 does
    return frame if not agent or "/" in frame or frame in shared else f"{agent}/{frame}"


def frame_owner(frame: str) -> str:
    """Return the agent that owns a frame; empty for a frame without prefix."""
    agent, slash, _ = frame.partition("/")
    return agent if slash else ""

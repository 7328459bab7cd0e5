"""The names that the routing experiment uses: those of Table 1, local ones, and near misses.

Every party publishes and subscribes all of them, so that a router that asked only whether somebody wants a
topic would let everything cross. Says what Table 1 means in words of its own, without patterns, to compare the
policy with. Pure.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from sfglab.lab.workers.test_peer import TRANSFORMS
from sfglab.names import TF, TF_STATIC, Resource, RosFqnBuilder, Scope, dds_topic

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    import numpy as np


STRING = "std_msgs/msg/String"

NEAR_MISSES = (
    "/chatter",
    "/global",
    "/global_x/y",
    "/globally/x",
    "/Global/x",
    "/local/global/x",
    "/robot/global/x",
    "/rt/global/x",
    "/tf2",
    "/tf/x",
    "/robot/tf",
    "/robot/tf_static",
)
"""Topics that Table 1 does not name, though they nearly look so."""

DEEP = "/global/deeper/than/the/schema/goes/x"
"""Crosses by ``rt/global/*``, whose ``*`` stands for slashes too."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Topic:
    """A topic of the experiment."""

    name: str  #: ROS name.
    type: str  #: ROS type.
    publishers: tuple[str, ...]  #: Parties that publish it.
    subscribers: tuple[str, ...]  #: Parties that subscribe it.
    latched: bool = False  #: Published once, transient local.


def in_table_1(dds_name: str) -> bool:
    """Return whether Table 1 of paper A names a DDS topic, said without its patterns."""
    prefix, _, rest = dds_name.partition("/")
    if prefix == "rt" and rest in {"tf", "tf_static"}:
        return True
    return prefix in {"rt", "rq", "rr"} and rest.startswith("global/")


def topics(agents: Sequence[str], others: Sequence[str], *, busy: int) -> Iterator[Topic]:
    """Yield every topic of a run.

    Args:
        agents: Parties behind routers.
        others: Parties in the global domain.
        busy: Further local topics of each agent.
    """
    everybody = (*agents, *others)
    yield Topic(name=TF, type=TRANSFORMS, publishers=everybody, subscribers=everybody)
    yield Topic(name=TF_STATIC, type=TRANSFORMS, publishers=everybody, subscribers=everybody, latched=True)
    for name in (_name(Scope.GLOBAL, None, Resource.MAP), DEEP, *NEAR_MISSES):
        yield Topic(name=name, type=STRING, publishers=everybody, subscribers=everybody)
    for party in everybody:
        for scope in Scope:
            name = _name(scope, party, Resource.STATE)
            yield Topic(name=name, type=STRING, publishers=(party,), subscribers=everybody)
    for agent in agents:
        for number in range(busy):
            name = f"{_name(Scope.LOCAL, agent, Resource.STATUS)}{number}"
            yield Topic(name=name, type=STRING, publishers=(agent,), subscribers=(agent, *others))


def service_names(party: str) -> tuple[str, str, str]:
    """Return the services that a party serves: one that crosses, a local one, and a near miss."""
    crossing, local = (_name(scope, party, Resource.GET_METADATA) for scope in (Scope.GLOBAL, Scope.LOCAL))
    return crossing, local, f"/globally/{party}/{Resource.GET_METADATA.value}"


def random_dds_names(count: int, *, rng: np.random.Generator) -> Iterator[str]:
    """Yield names that are made of the parts of Table 1 and of others, in any order."""
    heads = ("rt", "rq", "rr", "rs", "RT", "")
    parts = ("tf", "tf_static", "global", "local", "globally", "global_x", "a", "camera_front", "*", "")
    tails = ("", "Request", "Reply")
    for _ in range(count):
        middle = [parts[i] for i in rng.integers(len(parts), size=rng.integers(1, 5))]
        head, tail = heads[rng.integers(len(heads))], tails[rng.integers(len(tails))]
        yield "/".join((head, *middle)) + tail


def near_miss_dds_names() -> tuple[str, ...]:
    """Return what the near misses are called on the wire."""
    return tuple(dds_topic(name) for name in NEAR_MISSES)


def _name(scope: Scope, party: str | None, resource: Resource) -> str:
    builder = RosFqnBuilder().scope(scope)
    builder = builder.without_agent() if party is None else builder.agent(party)
    return str(builder.resource(resource).build())

"""Which remote agents there are, as the agent's discoverer says: Fig. 4's registration of agents.

The shell around `sfglab.fleet.discovery.listener`: it listens, and gives a discoverer that was started again
its grace.
"""

from __future__ import annotations

from contextlib import closing
from typing import TYPE_CHECKING

from sfglab.fleet.discovery.listener import DISCOVERY_EVENT, DISCOVERY_QOS, KnownAgents

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from sfglab.bus import Node
    from sfglab.fleet.discovery.listener import Change


async def agent_changes(node: Node, topic: str, known: KnownAgents | None = None) -> AsyncIterator[Change]:
    """Yield every change of what remote agents offer, those first that the discoverer has announced before.

    Args:
        node: Node in the agent's own domain.
        topic: Where its discoverer publishes.
        known: What is known, updated in place; None: nothing, and the usual grace.
    """
    known, clock = known or KnownAgents(), node.get_clock()
    with closing(node.create_subscription(DISCOVERY_EVENT, topic, qos=DISCOVERY_QOS)) as subscription:
        while True:
            due_ns = known.deadline_ns
            wait_s = None if due_ns is None else max(0.0, (due_ns - clock.now_ns()) / 1e9)
            try:
                event, info = await subscription.take_with_info(wait_s)
            except TimeoutError:
                pass
            else:
                change = known.feed(event, info.publisher_gid, now_ns=clock.now_ns())
                if change is not None:
                    yield change
            for withdrawn in known.expire(clock.now_ns()):
                yield withdrawn

"""How it stands with motion capture, told on a topic: `sfglab_interfaces/msg/MocapStatus`.

The topic's name is ours, by the schema of paper A, section 4.1: it is global, so it crosses the routers, and
the fleet's tools see from anywhere what the cameras see. Pure: turns the core's values into a message.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

from sfglab.messages import message_type, stamp_from_ns
from sfglab.names import Custom, RosFqnBuilder, Scope
from sfglab.qos import Durability, QoSProfile
from sfglab.spatial.mocap.tracking import TrackState, Verdict

if TYPE_CHECKING:
    from sfglab.spatial.mocap.core import BridgeCore, Latency, MocapObjectStatus


STATUS = "sfglab_interfaces/msg/MocapStatus"
STATUS_QOS = QoSProfile(depth=1, durability=Durability.TRANSIENT_LOCAL)
"""Late joiners get the last one."""
_OBJECT = "sfglab_interfaces/msg/MocapObject"


def status_topic(agent: str = "") -> str:
    """Return where a bridge tells its status.

    Args:
        agent: The agent on which the bridge runs; empty: it is nobody's in particular.
    """
    name = RosFqnBuilder().scope(Scope.GLOBAL).resource(Custom("mocap_status"))
    return str((name.agent(agent) if agent else name.without_agent()).build())


def status_message(core: BridgeCore, now_ns: int) -> Any:
    """Return a `sfglab_interfaces/msg/MocapStatus` of a bridge.

    Args:
        core: The bridge's decisions.
        now_ns: The present.
    """
    return message_type(STATUS)(
        stamp=stamp_from_ns(now_ns),
        world=core.world,
        captures=core.captures,
        dropped=core.dropped,
        unmapped=core.unmapped.total(),
        objects=[_object(status) for status in core.statuses],
    )


def _object(status: MocapObjectStatus) -> Any:
    make = message_type(_OBJECT)
    states = {state: getattr(make, state.name) for state in TrackState}
    return make(
        id=status.object_id,
        frame=status.frame,
        state=states[status.state],
        published=status.published,
        unplaced=status.unplaced,
        absent=status.absent,
        **{verdict.value: status.verdicts.get(verdict.value, 0) for verdict in Verdict},
        captured=stamp_from_ns(status.capture_ns or 0),
        receipt_latency_s=_seconds(status.receipt_latency),
        publication_latency_s=_seconds(status.publication_latency),
        problem=status.problem,
    )


def _seconds(latency: Latency) -> float:
    return math.nan if latency.median_ns is None else latency.median_ns / 1e9

"""The bridge as a node: a source in, /tf and a status out; every decision is the core's.

The status, `sfglab_interfaces/msg/MocapStatus`, has a topic by the schema of paper A, section 4.1: it is
global, so it crosses the routers, and the fleet's tools see from anywhere what the cameras see.
"""

from __future__ import annotations

import asyncio
import logging
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.messages import message_type, stamp_from_ns
from sfglab.names import TF, Custom, RosFqnBuilder, Scope
from sfglab.qos import Durability, QoSProfile
from sfglab.spatial.frames.buffer import FrameBuffer
from sfglab.spatial.frames.listener import TF_QOS, TRANSFORMS, FramesListener
from sfglab.spatial.mocap.core import BridgeCore
from sfglab.spatial.mocap.tracking import TrackState, Verdict
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from sfglab.bus import Node, Publisher
    from sfglab.spatial.mocap.core import Latency, MocapObjectStatus
    from sfglab.spatial.mocap.mapping import MocapMapping
    from sfglab.spatial.mocap.tracking import Capture, MocapSource


_log = logging.getLogger(__name__)

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
    return math.nan if latency.median_ns is None else latency.median_ns / NS_PER_S


@dataclass(frozen=True, slots=True, kw_only=True)
class BridgeOptions:
    """How a bridge behaves."""

    reach_s: float = 0.1  #: How far the agents' transforms may be continued when they lag behind the cameras.
    #: The agent on which the bridge runs, for the status topic's name; empty: nobody's in particular.
    agent: str = ""
    status_period_s: float = 1.0  #: Time between two messages about the status.


class MocapBridge:
    """Publishes where a capture system sees the agents, in a way that keeps their trees whole.

    ```python
    bridge = MocapBridge(node, ViconSource("192.168.10.1", clock=node.get_clock()), load_mapping(path))
    await bridge.run()
    ```

    Args:
        node: The node that listens to /tf and /tf_static and publishes on /tf, and its status on
            `status_topic`.
        source: Where captures come from.
        mapping: Which object stands for which frame.
        options: How it behaves.

    Attributes:
        buffer: All transforms heard, the bridge's own included.
        core: The decisions, with counts of captures.
    """

    def __init__(
        self, node: Node, source: MocapSource, mapping: MocapMapping, options: BridgeOptions | None = None
    ) -> None:
        self.buffer = FrameBuffer()
        self._node, self._source = node, source
        self._options = options or BridgeOptions()
        self.core = BridgeCore(mapping, self.buffer, reach_s=self._options.reach_s)
        self._said: set[tuple[str, str]] = set()

    @property
    def statuses(self) -> tuple[MocapObjectStatus, ...]:
        """How it stands with every object of the mapping."""
        return self.core.statuses

    async def run(self) -> None:
        """Run until the source ends, or until cancelled.

        Raises:
            MocapError: The source cannot be opened, or it broke.
        """
        publisher = self._node.create_publisher(TRANSFORMS, TF, TF_QOS)
        status = self._node.create_publisher(STATUS, status_topic(self._options.agent), STATUS_QOS)
        telling = asyncio.create_task(self._tell(status))
        try:
            async with FramesListener(self._node, self.buffer), self._source.captures() as captures:
                async for capture in captures:
                    self._pass_on(capture, publisher)
        finally:
            telling.cancel()
            await asyncio.gather(telling, return_exceptions=True)
            status.close()
            publisher.close()

    def _pass_on(self, capture: Capture, publisher: Publisher) -> None:
        if transforms := self.core.take(capture, self._node.get_clock().now_ns()):
            publisher.publish(message_type(TRANSFORMS)(transforms=[t.to_msg() for t in transforms]))
        self._say_problems()

    async def _tell(self, status: Publisher) -> None:
        clock = self._node.get_clock()
        while True:
            status.publish(status_message(self.core, clock.now_ns()))
            await clock.sleep_for(self._options.status_period_s)

    def _say_problems(self) -> None:
        """Log each kind of problem of each object once."""
        for status in self.core.statuses:
            key = (status.object_id, status.problem_kind)
            if status.problem and key not in self._said:
                self._said.add(key)
                _log.warning("object %r: %s", status.object_id, status.problem)

"""The bridge as a node: a source in, /tf out; every decision is the core's."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING

from sfglab.messages import message_type
from sfglab.names import TF
from sfglab.spatial.frames import TF_QOS, TRANSFORMS, FrameBuffer, FramesListener
from sfglab.spatial.mocap.core import BridgeCore

if TYPE_CHECKING:
    from sfglab.bus.api import Node
    from sfglab.spatial.mocap.capture import MocapSource
    from sfglab.spatial.mocap.core import MocapObjectStatus
    from sfglab.spatial.mocap.mapping import MocapMapping

__all__ = ["MocapBridge"]

_log = logging.getLogger(__name__)


class MocapBridge:
    """Publishes where a capture system sees the agents, in a way that keeps their trees whole.

    ```python
    bridge = MocapBridge(node, ViconSource("192.168.10.1", clock=node.get_clock()), load_mapping(path))
    await bridge.run()
    ```

    Args:
        node: The node that listens to /tf and /tf_static and publishes on /tf.
        source: Where captures come from.
        mapping: Which object stands for which frame.
        reach_s: How far the agents' transforms may be continued when they lag behind the cameras.

    Attributes:
        buffer: All transforms heard, the bridge's own included.
    """

    def __init__(self, node: Node, source: MocapSource, mapping: MocapMapping, *, reach_s: float = 0.1) -> None:
        self.buffer = FrameBuffer()
        self._node, self._source = node, source
        self._core = BridgeCore(mapping, self.buffer, reach_s=reach_s)
        self._said: set[tuple[str, str]] = set()
        self._published = asyncio.Event()

    @property
    def core(self) -> BridgeCore:
        """The decisions, with counts of captures."""
        return self._core

    @property
    def statuses(self) -> tuple[MocapObjectStatus, ...]:
        """How it stands with every object of the mapping."""
        return self._core.statuses

    async def wait_published(self, timeout_s: float = 5.0) -> None:
        """Return once a transform has left.

        Raises:
            TimeoutError: None has.
        """
        async with asyncio.timeout(timeout_s):
            await self._published.wait()

    async def run(self) -> None:
        """Run until the source ends, or until cancelled.

        Raises:
            MocapError: The source cannot be opened, or it broke.
        """
        make = message_type(TRANSFORMS)
        clock = self._node.get_clock()
        publisher = self._node.create_publisher(TRANSFORMS, TF, TF_QOS)
        try:
            async with FramesListener(self._node, self.buffer), self._source.captures() as captures:
                async for capture in captures:
                    if transforms := self._core.take(capture, clock.now_ns()):
                        publisher.publish(make(transforms=[t.to_msg() for t in transforms]))
                        self._published.set()
                    self._say_problems()
        finally:
            publisher.close()

    def _say_problems(self) -> None:
        """Log each kind of problem of each object once."""
        for object_id, (kind, text) in self._core.problems.items():
            if (object_id, kind) not in self._said:
                self._said.add((object_id, kind))
                _log.warning("object %r: %s", object_id, text)

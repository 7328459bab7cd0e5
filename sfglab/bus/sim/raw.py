"""Raw readers and writers for routers on the simulated bus; see `sfglab.bus.forwarding.ForwardingNode`."""

from __future__ import annotations

from typing import TYPE_CHECKING

from sfglab.bus.api import MessageInfo
from sfglab.bus.sim.reader import Reader
from sfglab.bus.sim.writer import Writer

if TYPE_CHECKING:
    from sfglab.bus.forwarding import RawEndpoint, Sink
    from sfglab.bus.queue import Sample
    from sfglab.bus.sim.core import SimCore


class SimInlet:
    """A raw reader that hands each sample to a sink.

    Args:
        core: Of the node.
        endpoint: What it is to be.
        sink: Called for each sample.
    """

    def __init__(self, core: SimCore, endpoint: RawEndpoint, sink: Sink) -> None:
        self._core = core
        self._sink = sink
        self._calls = core.calls(f"inlet {endpoint.dds_topic!r}")
        info = core.info(endpoint, writer=False)
        self._reader = Reader(core.participant, info, _ignore, push=self._push, ignores_own=True)
        core.own(self)
        self._reader.opened()

    @property
    def gid(self) -> bytes:
        """Its 16-byte GUID, as the graph shows it."""
        return self._reader.gid

    def close(self) -> None:
        """End it; again is harmless."""
        self._core.disown(self)
        self._reader.close()

    def _push(self, sample: Sample) -> None:
        cdr, source_ns, received_ns, gid = sample
        info = MessageInfo(source_timestamp_ns=source_ns, received_timestamp_ns=received_ns, publisher_gid=gid)
        self._calls.run(self._sink, cdr, info)


class SimOutlet:
    """A raw writer.

    Args:
        core: Of the node.
        endpoint: What it is to be.
    """

    def __init__(self, core: SimCore, endpoint: RawEndpoint) -> None:
        self._core = core
        info = core.info(endpoint, writer=True)
        self._writer = Writer(core.participant, info, _ignore, ignores_own=True)
        core.own(self)
        self._writer.opened()

    @property
    def gid(self) -> bytes:
        """Its 16-byte GUID, as the graph shows it."""
        return self._writer.gid

    def write(self, cdr: bytes, source_timestamp_ns: int) -> None:
        """Send one sample with the time stamp that its first publisher gave it."""
        if self._writer.is_open:
            self._writer.forward(cdr, source_timestamp_ns)

    def close(self) -> None:
        """End it; again is harmless."""
        self._core.disown(self)
        self._writer.close()


def _ignore() -> None:
    """Take no notice of a change of what matches."""

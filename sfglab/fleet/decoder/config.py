"""Configuration of a decoder. The module imports neither nodes nor codecs, so that it loads fast."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.bus.address import BusAddress
from sfglab.bus.api import ParameterTransport  # noqa: TC001 - read at run time


@dataclass(frozen=True, slots=True, kw_only=True)
class DecoderConfig:
    """Configuration of a decoder's process."""

    remote: BusAddress  #: Domain of the remote streams.
    local: BusAddress  #: Domain of the local subscribers.
    streams: tuple[str, ...] = ()  #: Remote topics that are offered from the start.
    discovery_topic: str = ""  #: Topic of discovery events; empty for none.
    idle_timeout_s: float = 1.0  #: Time that a pipeline is kept after its last subscriber left, s.
    #: Whether pipelines begin with the GOP replay of the stream's sender, not with the next key frame.
    replay: bool = True
    spare: bool = True  #: Whether a standby pipeline process waits for the next stream.
    #: Whether another standby process is started when a stream takes it. If false, one process serves one
    #: stream after the other, as a component container in the paper loads and unloads components.
    refill: bool = True
    #: Whether decodable topics are advertised before a subscription exists.
    advertise_unused_topics: bool = True
    #: Parameter services, with which ROS 2's tools read this configuration; None for none.
    parameters: ParameterTransport | None = None

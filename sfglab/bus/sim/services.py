"""Who asked: hands replies of services only to the participant that waits for them.

All clients of a service share its reply topic, so DDS gives every reply to all of them, and all but one ignore
it. With n clients of each of n services that is n**3 deliveries, which nobody needs to simulate one by one.
Knows how requests and replies are framed; refuses to know anything of their content.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from sfglab.bus.sim.channel import Network
    from sfglab.bus.sim.domain import Domain
    from sfglab.bus.sim.participant import Participant
    from sfglab.bus.sim.reader import Reader
    from sfglab.bus.sim.writer import Writer


# Behind the 4 bytes of encapsulation: the client's GUID and the request's number (`frame_service`).
_HEADER = slice(4, 20)


class Services:
    """Remembers who sent which request.

    Args:
        network: Says how long replies take.
    """

    def __init__(self, network: Network) -> None:
        self._network = network
        self._askers: dict[tuple[Domain, bytes], Participant] = {}

    def routes(self, writer: Writer, cdr: bytes) -> dict[int, tuple[Reader, ...]] | None:
        """Take note of a request, or return where a reply goes; None: to all, as any sample."""
        topic = writer.info.dds_topic
        if topic.startswith("rq/"):
            self._askers[writer.participant.domain, cdr[_HEADER]] = writer.participant
        elif topic.startswith("rr/"):
            asker = self._askers.pop((writer.participant.domain, cdr[_HEADER]), None)
            if asker is not None:
                return self._ways(writer, asker)
        return None

    def _ways(self, writer: Writer, asker: Participant) -> dict[int, tuple[Reader, ...]]:
        readers = writer.audience.readers_of(asker)
        self._charge(writer)
        return {self._network.delay_ns(writer, readers[0]): readers} if readers else {}

    def _charge(self, writer: Writer) -> None:
        """Let a reply cost everybody on average what it costs those who ignore it."""
        cost_ns = self._network.message_cost_ns
        domain = writer.participant.domain
        if cost_ns and domain.members:
            share = (writer.matched - 1) / len(domain.members)
            domain.crowd.occupy(writer.now_ns, round(share * cost_ns))

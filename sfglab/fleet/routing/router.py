"""The router between an agent's domain and the global one: paper A, section 4.1, Eq. 1 and Table 1.

A thin shell around `plan`: it listens to both graphs, feeds the plan and has the actions carried out, all in
one task. It runs on nodes of any backend.

Services pass between nodes that frame them as rmw_cyclonedds does. rmw_fastrtps finds the call of a reply by
RTPS sample identities, which a forwarded sample does not keep, so its services do not pass; its topics do.
"""

from __future__ import annotations

import asyncio
from collections import deque
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from sfglab.fleet.routing.carrier import Carrier
from sfglab.fleet.routing.frames import Frames
from sfglab.fleet.routing.interest import Interest
from sfglab.fleet.routing.plan import Plan
from sfglab.fleet.routing.policy import TABLE_1, ForwardRule, Policy, Side
from sfglab.fleet.routing.transforms import TransformGate
from sfglab.names import SHARED_FRAMES, validate_agent

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.bus import Node
    from sfglab.bus.api import EndpointEvent
    from sfglab.fleet.routing.carrier import PathStatus


STATUS_PERIOD_S = 5.0
"""How often the status is told when nothing changes, seconds."""

# Loops keep time in floats of seconds, or in milliseconds: this much before a deadline it counts as reached.
_RESOLUTION_NS = 1_000_000


@dataclass(frozen=True, slots=True, kw_only=True)
class RouterSettings:
    """What a router does."""

    agent: str  #: Whose router it is.
    rules: tuple[ForwardRule, ...] = TABLE_1  #: What crosses the border; by default Table 1 of paper A.
    linger_s: float = 1.0  #: How long a path outlives its last publisher or subscription, seconds.
    #: Whether transforms leave under the agent's prefix, and are dropped when they clash.
    prefix_frames: bool = True
    #: Frames that all agents mean by the same name and that are never prefixed.
    shared_frames: tuple[str, ...] = SHARED_FRAMES
    #: Frames of the agent, without prefix, that others may give a parent.
    placed_by_others: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        validate_agent(self.agent)

    @property
    def frames(self) -> Frames:
        """The names of the agent's frames."""
        return Frames(
            agent=self.agent,
            shared=frozenset(self.shared_frames),
            placed_by_others=frozenset(self.placed_by_others),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class RouterStatus:
    """What a router does now."""

    paths: tuple[PathStatus, ...] = ()  #: All open paths.
    clashed: int = 0  #: Transforms that were dropped because their frames clash.


class Router:
    """Forwards what the policy lets cross, on demand.

    Args:
        local: A node of its own on the agent's domain.
        remote: A node of its own on the global domain.
        settings: What it does.
        pair: Names the pair of domains among all routers, so that two on one pair know each other; empty is
            the agent's name.
        on_status: Given the status whenever paths change, and every `STATUS_PERIOD_S`.
    """

    def __init__(
        self,
        local: Node,
        remote: Node,
        settings: RouterSettings,
        *,
        pair: str = "",
        on_status: Callable[[RouterStatus], None] = lambda _: None,
    ) -> None:
        self._nodes = {Side.LOCAL: local, Side.GLOBAL: remote}
        self._on_status = on_status
        self._plan = Plan(
            Policy(rules=settings.rules),
            participants=frozenset(node.guid for node in self._nodes.values()),
            pair=pair or settings.agent,
            linger_ns=round(settings.linger_s * 1e9),
        )
        self._gate = TransformGate(settings.frames) if settings.prefix_frames else None
        self._carrier = Carrier(self._nodes, pair=pair or settings.agent, gate=self._gate)
        self._heard: deque[tuple[Side, EndpointEvent]] = deque()
        self._woken = asyncio.Event()

    @property
    def status(self) -> RouterStatus:
        """What it does now."""
        clashed = 0 if self._gate is None else self._gate.counts.clashed
        return RouterStatus(paths=self._carrier.paths, clashed=clashed)

    async def run(self, on_ready: Callable[[], None] = lambda: None) -> None:
        """Route until cancelled; everything it opened is closed when this returns.

        Args:
            on_ready: Called once when it listens.
        """
        local, remote = (self._nodes[side] for side in (Side.LOCAL, Side.GLOBAL))
        interest = Interest(remote.graph, partial(self._hear, Side.GLOBAL))

        def hear(event: EndpointEvent) -> None:
            if event.endpoint.participant != local.guid:
                interest.feed(event)
                self._hear(Side.LOCAL, event)

        end = local.graph.listen(hear)
        on_ready()
        try:
            await self._route()
        finally:
            end()
            interest.close()
            self._carrier.close()

    def _hear(self, side: Side, event: EndpointEvent) -> None:
        self._heard.append((side, event))
        self._woken.set()

    async def _route(self) -> None:
        report_ns = _now_ns()
        while True:
            self._woken.clear()
            now_ns = _now_ns()
            if self._catch_up(now_ns) or now_ns >= report_ns:
                report_ns = now_ns + round(STATUS_PERIOD_S * 1e9)
                self._on_status(self.status)
            await self._wait(report_ns)

    def _catch_up(self, now_ns: int) -> bool:
        """Take in what was heard and what lingered long enough; return whether that changed anything."""
        heard = list(self._heard)
        self._heard.clear()
        actions = self._plan.feed_all(heard, now_ns=now_ns)
        self._carrier.carry_out(actions)
        return bool(actions)

    async def _wait(self, report_ns: int) -> None:
        """Return when something was heard, when the plan's deadline is reached, or when a report is due."""
        deadline_ns = self._plan.deadline_ns
        due_ns = report_ns if deadline_ns is None else min(report_ns, deadline_ns)
        try:
            async with asyncio.timeout_at(due_ns / 1e9):
                await self._woken.wait()
        except TimeoutError:
            return


def _now_ns() -> int:
    """Return the loop's time, which no correction of the host's clock moves."""
    return round(asyncio.get_running_loop().time() * 1e9) + _RESOLUTION_NS

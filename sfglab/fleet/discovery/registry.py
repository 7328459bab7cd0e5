"""Registry of all remote agents: which input a heartbeat or an answer is, and when time is one.

Pure: the caller passes what was heard and `now_ns`, any clock that never goes back, and carries out what is
returned. A start of an agent is told from another by its incarnation, which grows; while one start is there,
heartbeats of an older one are not believed, and when it is lost they are, for a robot's clock may have been
set back while it was off.
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.errors import InvalidValueError
from sfglab.fleet.discovery.lifecycle import (
    ANNOUNCEMENTS,
    TRANSITIONS,
    Action,
    Asking,
    Input,
    Lifecycle,
    State,
    Told,
)
from sfglab.fleet.discovery.screening import Limits, Refusal, Screen
from sfglab.machine import BackOff

if TYPE_CHECKING:
    from collections.abc import Callable

    from sfglab.fleet.status.heartbeat import Heartbeat


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """How long a discoverer waits for what."""

    missed: float = 3.0  #: An agent is lost when this many of its announced periods pass without a heartbeat.
    slack_ns: int = 500_000_000  #: Time on top of that, for the network.
    backoff_ns: int = 250_000_000  #: Wait after the first failed query; it doubles with each further one.
    backoff_max_ns: int = 10_000_000_000  #: The longest wait between queries.
    forget_ns: int = 600_000_000_000  #: How long a lost agent is remembered.

    def __post_init__(self) -> None:
        for name in ("missed", "slack_ns", "backoff_ns", "backoff_max_ns", "forget_ns"):
            if not getattr(self, name) > 0:
                raise InvalidValueError(f"discovery, {name}", getattr(self, name), "positive numbers")


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """What the caller has to do about an agent: ask it, give that up, or tell local consumers of it."""

    action: Action  #: What; one that is an announcement names the event.
    agent: str  #: Whom to ask, or of whom to tell.
    #: Which query; no two are the same, and `Registry.answered` or `Registry.failed` is told of it.
    query: int | None = None
    incarnation: int = 0  #: Which start of the agent the description is from.
    metadata: Any = None  #: Its last known description.

    @property
    def event(self) -> str:
        """The event, by the name of a constant of ``AgentDiscoveryEvent``."""
        return self.action.name


@dataclass(frozen=True, slots=True, kw_only=True)
class Move:
    """A transition that was taken."""

    agent: str  #: Whose.
    before: State  #: State before.
    given: Input  #: Input.
    after: State  #: State after.
    actions: tuple[Action, ...]  #: What was done.


@dataclass(frozen=True, slots=True, kw_only=True)
class AgentStatus:
    """One remote agent as the registry sees it."""

    agent: str  #: Its name.
    state: State  #: Where it stands.
    incarnation: int  #: Which start of it was heard last.
    revision: int  #: Which revision of its description was heard last.
    failures: int  #: Queries that failed since the last one that did not.
    heard_ns: int  #: When it was heard last, on the caller's clock.


_OF_NO_USE = tuple(state for state, given in TRANSITIONS if given is Input.EXPIRED)


_Version = tuple[int, int]  #: Incarnation and revision of an agent's description.


@dataclass(slots=True)
class _Remote:
    """What is known of one agent."""

    life: Lifecycle
    backoff: BackOff
    wanted: _Version  #: What its heartbeats say that there is to know.
    held: _Version | None = None  #: What the description is of that was announced; None before the first.
    metadata: Any = None
    query: int | None = None  #: The outstanding query.
    heard_ns: int = 0
    silent_ns: int = 0
    retry_ns: int = 0
    expire_ns: int = 0


class Registry:
    """The agents other than the discoverer's own, and what has to be done about them.

    `on_move` is called with every transition.
    """

    def __init__(
        self,
        agent: str,
        *,
        timing: Timing | None = None,
        limits: Limits | None = None,
        on_move: Callable[[Move], None] | None = None,
    ) -> None:
        #: How often what happened: ``heard``, ``dropped_<reason>``, ``asked``, ``answered``, ``failed`` (of
        #: these ``mismatched``: answered with something else), ``abandoned``, ``ignored_answers`` (to queries
        #: that had been given up), ``evicted``, ``refused_parts`` (of descriptions).
        self.counts: Counter[str] = Counter()
        self._timing = timing or Timing()
        self._limits = limits or Limits()
        self._screen = Screen(agent, self._limits)
        self._on_move = on_move
        self._remotes: dict[str, _Remote] = {}
        self._queries = itertools.count(1)

    def heard(self, heartbeat: Heartbeat, publisher_gid: bytes, *, now_ns: int) -> list[Order]:
        """Take a heartbeat, as a value or message that may say anything, and return what has to be done."""
        refusal = self._screen.check(heartbeat, publisher_gid, now_ns=now_ns)
        if refusal is not None:
            return self.refuse(refusal)
        remote = self._remotes.get(heartbeat.agent)
        if remote is None:
            if not self._make_room():
                return self.refuse(Refusal.FULL)
            version = heartbeat.incarnation, heartbeat.revision
            remote = _Remote(Lifecycle(heartbeat.agent), self._fresh_backoff(), version)
            self._remotes[heartbeat.agent] = remote
        given = _input_of(heartbeat, remote)
        if given is None:
            return self.refuse(Refusal.STALE)
        self.counts["heard"] += 1
        if given is not Input.HEARD:
            remote.wanted = heartbeat.incarnation, heartbeat.revision
        if given is Input.RESTARTED:
            remote.backoff = self._fresh_backoff()
        remote.heard_ns = now_ns
        remote.silent_ns = (
            now_ns + round(self._timing.missed * heartbeat.period_s * 1e9) + self._timing.slack_ns
        )
        return self._feed(heartbeat.agent, given, now_ns)

    def refuse(self, why: Refusal) -> list[Order]:
        """Count a heartbeat that does not count otherwise; nothing has to be done."""
        self.counts[f"dropped_{why.value}"] += 1
        return []

    def answered(self, agent: str, query: int, metadata: Any, *, now_ns: int) -> list[Order]:
        """Take the ``AgentMetadata``, which may say anything, that answers a query of an order."""
        remote = self._asked(agent, query)
        if remote is None:
            return []
        if metadata.agent != agent or not _is_wanted(metadata, remote.wanted):
            self.counts["mismatched"] += 1
            return self.failed(agent, query, now_ns=now_ns)
        anew = remote.held is not None and remote.held[0] != metadata.incarnation
        remote.held = remote.wanted = metadata.incarnation, metadata.revision
        remote.metadata, remote.query = metadata, None
        remote.backoff = self._fresh_backoff()
        self.counts["answered"] += 1
        return self._feed(agent, Input.ANSWERED_ANEW if anew else Input.ANSWERED, now_ns)

    def failed(self, agent: str, query: int, *, now_ns: int) -> list[Order]:
        """Take it that a query failed or was not answered in time; see `answered`."""
        remote = self._asked(agent, query)
        if remote is None:
            return []
        remote.query = None
        self.counts["failed"] += 1
        return self._feed(agent, Input.FAILED, now_ns)

    def due(self, now_ns: int) -> list[Order]:
        """Do what time brings, and return what has to be done."""
        orders: list[Order] = []
        for agent, remote in list(self._remotes.items()):
            given = next((given for at_ns, given in _deadlines(remote) if now_ns >= at_ns), None)
            if given is not None:
                orders += self._feed(agent, given, now_ns)
        return orders

    def overslept(self, since_ns: int, now_ns: int) -> None:
        """Count nothing of the time in which the caller itself stood still as an agent's silence."""
        for remote in self._remotes.values():
            left_ns = remote.silent_ns - max(remote.heard_ns, since_ns)
            remote.silent_ns = max(remote.silent_ns, now_ns + left_ns)

    @property
    def deadline_ns(self) -> int | None:
        """When `due` has to be called, on the caller's clock; None while nothing is waited for."""
        return min((d for r in self._remotes.values() for d, _ in _deadlines(r)), default=None)

    def agents(self) -> tuple[AgentStatus, ...]:
        """Return all remote agents that are kept track of, by name."""
        return tuple(
            AgentStatus(
                agent=agent,
                state=remote.life.state,
                incarnation=remote.wanted[0],
                revision=remote.wanted[1],
                failures=remote.backoff.failures,
                heard_ns=remote.heard_ns,
            )
            for agent, remote in sorted(self._remotes.items())
        )

    def announcement(self, agent: str) -> Order | None:
        """Return the news of an agent that is there, for those who have not heard of it; None if it is not."""
        remote = self._remotes.get(agent)
        if remote is None or remote.life.state.told is not Told.PRESENT:
            return None
        return _order(Action.DISCOVERED, agent, remote)

    def _make_room(self) -> bool:
        """Evict who has been silent longest of those that are no use to anybody, if there is no place."""
        if len(self._remotes) < self._limits.max_agents:
            return True
        idle = [agent for agent, remote in self._remotes.items() if remote.life.state in _OF_NO_USE]
        if not idle:
            return False
        oldest = min(idle, key=lambda agent: self._remotes[agent].heard_ns)
        self.counts["evicted"] += 1
        self._feed(oldest, Input.EXPIRED, self._remotes[oldest].heard_ns)
        return True

    def _asked(self, agent: str, query: int) -> _Remote | None:
        remote = self._remotes.get(agent)
        if remote is None or remote.query != query:
            self.counts["ignored_answers"] += 1
            return None
        return remote

    def _feed(self, agent: str, given: Input, now_ns: int) -> list[Order]:
        remote = self._remotes[agent]
        before = remote.life.state
        actions = remote.life.feed(given)
        if self._on_move is not None:
            move = Move(agent=agent, before=before, given=given, after=remote.life.state, actions=actions)
            self._on_move(move)
        if remote.life.state is State.LOST and before is not State.LOST:
            # Whoever comes back is compared with what consumers know, not with what was being asked for.
            assert remote.held is not None
            remote.wanted, remote.expire_ns = remote.held, now_ns + self._timing.forget_ns
        orders = [self._order(action, agent, remote, now_ns) for action in actions]
        return [order for order in orders if order is not None]

    def _order(self, action: Action, agent: str, remote: _Remote, now_ns: int) -> Order | None:
        """Return an action as an order to the caller; None for what is done here."""
        if action is Action.BACK_OFF:
            remote.retry_ns = now_ns + remote.backoff.next_ns(0)
            return None
        if action is Action.FORGET:
            del self._remotes[agent]
            return None
        if action is Action.QUERY:
            self.counts["asked"] += 1
            remote.query = next(self._queries)
        order = _order(action, agent, remote)
        if action is Action.ABANDON:
            self.counts["abandoned"] += 1
            remote.query = None
        return order

    def _fresh_backoff(self) -> BackOff:
        timing = self._timing
        return BackOff(first_ns=timing.backoff_ns, limit_ns=timing.backoff_max_ns, stable_ns=1)


def _is_wanted(metadata: Any, wanted: _Version) -> bool:
    """Return whether an answer is from the start that was heard, and not older than what was heard of it."""
    return bool(metadata.incarnation == wanted[0] and metadata.revision >= wanted[1])


def _input_of(heartbeat: Heartbeat, remote: _Remote) -> Input | None:
    """Return which input a heartbeat is; None when it is from a start that has been followed by another."""
    incarnation, revision = remote.wanted
    if heartbeat.incarnation == incarnation:
        return Input.CHANGED if heartbeat.revision > revision else Input.HEARD
    older = heartbeat.incarnation < incarnation
    return None if older and remote.life.state is not State.LOST else Input.RESTARTED


def _deadlines(remote: _Remote) -> list[tuple[int, Input]]:
    """Return what time will bring to an agent, and when."""
    state = remote.life.state
    if state is State.LOST:
        return [(remote.expire_ns, Input.EXPIRED)]
    silent = (remote.silent_ns, Input.SILENT)
    return [silent, (remote.retry_ns, Input.RETRY)] if state.asking is Asking.BACKING_OFF else [silent]


def _order(action: Action, agent: str, remote: _Remote) -> Order:
    if action not in ANNOUNCEMENTS:
        return Order(action=action, agent=agent, query=remote.query)
    assert remote.held is not None
    return Order(action=action, agent=agent, incarnation=remote.held[0], metadata=remote.metadata)

"""Registry of all remote agents: which input a heartbeat or an answer is, and when time is one.

Pure: the caller passes what was heard and `now_ns`, and carries out what is returned. A start of an agent is
told from another by its incarnation, which grows; an older one is believed only when the newer one is lost, for
a robot's clock may have been set back. A claim counts when the agent's service has answered so (`sources`).
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

from sfglab.fields import between, check_bounds
from sfglab.fleet.discovery.lifecycle import (
    ANNOUNCEMENTS,
    TRANSITIONS,
    Action,
    Announced,
    Input,
    Lifecycle,
    QueryState,
    State,
)
from sfglab.fleet.discovery.screening import Bucket, Limits, Refusal, Screen
from sfglab.fleet.discovery.sources import Source, Sources
from sfglab.fleet.status.description import MAX_TEXT
from sfglab.machine import BackOff

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from sfglab.fleet.status.heartbeat import Heartbeat


@dataclass(frozen=True, slots=True, kw_only=True)
class Timing:
    """How long a discoverer waits for what."""

    #: Announced periods without a heartbeat: an agent is lost.
    missed: float = between(3.0, without=(0,))
    slack_ns: int = between(500_000_000, without=(0,))  #: Time on top of that, for the network.
    #: Wait after the first failed query; it doubles with each further one.
    backoff_ns: int = between(250_000_000, without=(0,))
    #: The longest wait between queries.
    backoff_max_ns: int = between(10_000_000_000, without=(0,))
    forget_ns: int = between(600_000_000_000, without=(0,))  #: How long a lost agent is remembered.

    def __post_init__(self) -> None:
        check_bounds(self, "discovery, ")


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """What the caller has to do about an agent: ask it, give that up, or tell local consumers of it."""

    action: Action  #: What; one that is an announcement names the event.
    agent: str  #: Whom to ask, or of whom to tell.
    #: Which query, for `Registry.answered` or `failed`; no two are the same.
    query: int | None = None
    incarnation: int = 0  #: Which start of the agent the description is from.
    metadata: Any = None  #: Its last known description.
    publisher: bytes = b""  #: Who was heard, when an agent has to be asked.
    failures: int = 0  #: How many queries of it have failed since one was answered.
    #: Which incarnation and revision it said to be, when it has to be asked.
    wanted: tuple[int, int] = (0, 0)

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


_CLAIMS_PER_S, _CLAIMS = (
    0.1,
    5,
)  # claims to be another start that are followed, for long and at once
_DOUBTS = 3  # failed queries after which who was not believed before is no sign of life


_Version = tuple[int, int]  #: Incarnation and revision of an agent's description.


@dataclass(slots=True)
class _Remote:
    """What is known of one agent."""

    life: Lifecycle
    backoff: BackOff
    wanted: _Version  #: What its heartbeats say that there is to know.
    claims: Bucket
    sources: Sources = field(default_factory=Sources)
    publisher: bytes = b""
    doubts: int = 0
    #: What the description is of that was announced; None before the first.
    held: _Version | None = None
    metadata: Any = None
    query: int | None = None  #: The outstanding query.
    heard_ns: int = 0
    retry_ns: int = 0
    expire_ns: int = 0
    due: list[tuple[int, Input]] | None = None  #: What time will bring; None: to be found out anew.

    @property
    def silent_ns(self) -> int:
        held = (
            self.held[0]
            if self.held is not None and self.life.state.announced is Announced.PRESENT
            else None
        )
        return self.sources.silent_ns(
            held, doubted=self.held is not None and self.doubts >= _DOUBTS
        )


class Registry:
    """The agents other than the discoverer's own, and what to do about them; `on_move` hears of transitions."""

    def __init__(
        self,
        agent: str,
        *,
        timing: Timing | None = None,
        limits: Limits | None = None,
        on_move: Callable[[Move], None] | None = None,
        on_alarm: Callable[[Hashable, str], None] = lambda _key, _sentence: None,
    ) -> None:
        self._on_alarm = on_alarm
        self._own = Sources()  # who bears the own agent's name
        #: How often what happened: ``heard``, ``dropped_<reason>``, ``asked``, ``answered``, ``failed`` (of
        #: these ``mismatched``: answered with something else), ``abandoned``, ``ignored_answers`` (to queries
        #: that had been given up), ``evicted``, ``refused_parts`` (of descriptions), ``twins`` (heartbeats of a
        #: name that is used twice).
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
        version = heartbeat.incarnation, heartbeat.revision
        if refusal in (Refusal.OWN, Refusal.SPOOFED):
            key = publisher_gid, heartbeat.incarnation
            self._own.note(key, now_ns=now_ns, silent_ns=now_ns, revision=heartbeat.revision)
            self._tell_twins(heartbeat.agent, self._own)
        if refusal is not None:
            return self.refuse(refusal, heartbeat.agent, publisher_gid)
        remote = self._remotes.get(heartbeat.agent)
        if remote is None:
            if not self._make_room():
                return self.refuse(Refusal.FULL, heartbeat.agent, publisher_gid)
            claims = Bucket(_CLAIMS_PER_S, _CLAIMS, now_ns)
            remote = _Remote(Lifecycle(heartbeat.agent), self._fresh_backoff(), version, claims)
            self._remotes[heartbeat.agent] = remote
        silent_ns = (
            now_ns + round(self._timing.missed * heartbeat.period_s * 1e9) + self._timing.slack_ns
        )
        key = publisher_gid, heartbeat.incarnation
        source = remote.sources.note(
            key, now_ns=now_ns, silent_ns=silent_ns, revision=heartbeat.revision
        )
        remote.due = None
        self._tell_twins(heartbeat.agent, remote.sources)
        given = _input_of(version, remote, source, now_ns)
        if isinstance(given, Refusal):
            source.trust = False
            return self.refuse(given, heartbeat.agent, publisher_gid)
        self.counts["heard"] += 1
        if given is Input.RESTARTED:
            remote.backoff = self._fresh_backoff()
        if given is not Input.HEARD and not source.trust:
            source.trust = None  # it is being asked about
        if given is Input.RESTARTED or version > remote.wanted:
            remote.wanted = version
        remote.heard_ns, remote.publisher = now_ns, publisher_gid
        return self._feed(heartbeat.agent, given, now_ns)

    def refuse(self, why: Refusal, agent: str = "", publisher: bytes = b"") -> list[Order]:
        """Count a heartbeat that does not count otherwise; nothing has to be done."""
        self.counts[f"dropped_{why.value}"] += 1
        if why not in (Refusal.OWN, Refusal.STALE):
            who = f"{agent[:MAX_TEXT]!r}, by {publisher.hex() or 'somebody'}"
            self._on_alarm((why, publisher), f"a heartbeat of {who}, does not count: {why.value}")
        return []

    def _tell_twins(self, agent: str, sources: Sources) -> None:
        """Say that an agent's name is used twice at once."""
        if twins := sources.twins():
            self.counts["twins"] += 1
            who = " and ".join(
                f"{publisher.hex()} (start {start})" for publisher, start in twins[:2]
            )
            said = (
                f"two speak for agent {agent!r} at once, {who}: its name is used twice, or spoofed"
            )
            self._on_alarm(("twins", agent), said)

    def answered(self, agent: str, query: int, metadata: Any, *, now_ns: int) -> list[Order]:
        """Take the ``AgentMetadata``, which may say anything, that answers a query of an order."""
        remote = self._asked(agent, query)
        if remote is None:
            return []
        version = metadata.incarnation, metadata.revision
        if metadata.agent != agent or not remote.sources.says(*version):
            self.counts["mismatched"] += 1
            return self.failed(agent, query, now_ns=now_ns)
        anew, again = (
            remote.held is not None and remote.held[0] != version[0],
            remote.held == version,
        )
        remote.sources.answered(*version)
        remote.held, remote.wanted, remote.doubts = version, version, 0
        remote.metadata, remote.query = metadata, None
        remote.backoff = self._fresh_backoff()
        self.counts["answered"] += 1
        orders = self._feed(agent, Input.ANSWERED_ANEW if anew else Input.ANSWERED, now_ns)
        return [order for order in orders if not (again and order.action is Action.UPDATED)]

    def failed(self, agent: str, query: int, *, now_ns: int) -> list[Order]:
        """Take it that a query failed or was not answered in time; see `answered`."""
        remote = self._asked(agent, query)
        if remote is None:
            return []
        remote.query, remote.doubts = None, remote.doubts + 1
        self.counts["failed"] += 1
        return self._feed(agent, Input.FAILED, now_ns)

    def due(self, now_ns: int) -> list[Order]:
        """Do what time brings, and return what has to be done."""
        orders: list[Order] = []
        for agent, remote in list(self._remotes.items()):
            given = next((given for at_ns, given in _deadlines(remote) if now_ns >= at_ns), None)
            doubted = (
                remote.doubts >= _DOUBTS or remote.life.state.announced is not Announced.PRESENT
            )
            if given is Input.SILENT and not doubted and remote.sources.outlive(now_ns):
                given = Input.CHANGED  # the others have to prove that it is there
            if given is not None:
                orders += self._feed(agent, given, now_ns)
        return orders

    def overslept(self, since_ns: int, now_ns: int) -> None:
        """Count nothing of the time in which the caller itself stood still as an agent's silence."""
        for remote in self._remotes.values():
            remote.sources.overslept(since_ns, now_ns)
            remote.due = None

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
        if remote is None or remote.life.state.announced is not Announced.PRESENT:
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
        before, remote.due = remote.life.state, None
        actions = remote.life.feed(given)
        if self._on_move is not None:
            move = Move(
                agent=agent, before=before, given=given, after=remote.life.state, actions=actions
            )
            self._on_move(move)
        if remote.life.state is State.LOST and before is not State.LOST:
            # Whoever comes back is compared with what consumers know, not with what was being asked for.
            assert remote.held is not None
            remote.wanted, remote.doubts = remote.held, 0
            remote.expire_ns = now_ns + self._timing.forget_ns
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


def _input_of(version: _Version, remote: _Remote, source: Source, now_ns: int) -> Input | Refusal:
    """Return which input a heartbeat is, or why it is none: it claims a start that nobody has to believe."""
    state, wanted = remote.life.state, remote.wanted
    idle = state.query is QueryState.NONE and remote.held is not None
    if version[0] == wanted[0]:
        if version[1] > wanted[1]:
            refused = idle and not source.trust and not remote.claims.take(now_ns)
            return Refusal.CLAIMED if refused else Input.CHANGED
        known = source.trust if state is State.LOST else remote.sources.believed()
        return Input.CHANGED if idle and not known else Input.HEARD
    if remote.held is not None and version[0] == remote.held[0]:
        return Input.HEARD  # another start is being asked about, and this one is still there
    if version[0] < wanted[0] and state.announced is not Announced.LOST:
        return Refusal.STALE if state.announced is Announced.PRESENT else Input.HEARD
    if remote.claims.take(now_ns):
        return Input.RESTARTED
    return Input.HEARD if state.announced is Announced.NOTHING else Refusal.CLAIMED


def _deadlines(remote: _Remote) -> list[tuple[int, Input]]:
    """Return what time will bring to an agent, and when; asked of all agents whenever one is heard."""
    if remote.due is None:
        state, lost = remote.life.state, [(remote.expire_ns, Input.EXPIRED)]
        remote.due = lost if state is State.LOST else [(remote.silent_ns, Input.SILENT)]
        remote.due += (
            [(remote.retry_ns, Input.RETRY)] if state.query is QueryState.BACKING_OFF else []
        )
    return remote.due


def _order(action: Action, agent: str, remote: _Remote) -> Order:
    if action in ANNOUNCEMENTS:
        assert remote.held is not None
        return Order(
            action=action, agent=agent, incarnation=remote.held[0], metadata=remote.metadata
        )
    order = Order(action=action, agent=agent, query=remote.query)
    if action is not Action.QUERY:
        return order
    return replace(
        order, publisher=remote.publisher, failures=remote.backoff.failures, wanted=remote.wanted
    )

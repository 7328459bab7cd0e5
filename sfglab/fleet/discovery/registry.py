"""Registry of all remote agents: it turns heartbeats, answers and deadlines into inputs of their life cycles.

The registry has no clock and no endpoints: the caller passes `now_ns` and executes the returned orders. The
incarnation identifies one run of an agent, and grows. An older incarnation is accepted only after the newer one
is lost, because a robot's clock may have been set back. A claimed incarnation counts once the agent has answered
with it (`speakers`).
"""

from __future__ import annotations

import itertools
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from sfglab.fleet.discovery.config import MAX_AGENTS, Timing
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
from sfglab.fleet.discovery.speakers import Source, Speakers
from sfglab.fleet.discovery.validation import Rates, Refusal, TokenBucket, is_valid_heartbeat
from sfglab.fleet.status.description import MAX_TEXT
from sfglab.machine import BackOff

if TYPE_CHECKING:
    from collections.abc import Callable, Hashable

    from sfglab.fleet.status.heartbeat import Heartbeat

_Version = tuple[int, int]  # incarnation and revision of an agent's description

_USELESS = frozenset(state for state, given in TRANSITIONS if given is Input.EXPIRED)
_CLAIMS_PER_S = 0.1  # claims of another incarnation that cause a query, on average
_CLAIMS_BURST = 5  # the same at once
_MAX_DOUBTS = 3  # failed queries after which only trusted sources keep an agent alive


@dataclass(frozen=True, slots=True, kw_only=True)
class Order:
    """Order to the caller: start or abandon a query, or announce an event."""

    action: Action  #: `QUERY`, `ABANDON` or an announcement, whose name is the event's.
    agent: str  #: The agent that is queried or announced.
    query: int | None = None  #: Unique number of the query; None for an announcement.
    incarnation: int = 0  #: Incarnation of the announced description.
    metadata: Any = None  #: The announced description.
    failures: int = 0  #: Failed queries of the agent since the last answer.
    wanted: _Version = (0, 0)  #: Oldest incarnation and revision that answer a query.

    @property
    def event(self) -> str:
        """The event, as the name of a constant of ``AgentDiscoveryEvent``."""
        return self.action.name


@dataclass(frozen=True, slots=True, kw_only=True)
class Move:
    """One transition of a remote agent's life cycle, as reported to `Registry`'s `on_move`."""

    agent: str  #: Name of the agent.
    before: State  #: State before the transition.
    given: Input  #: Input that caused the transition.
    after: State  #: State after the transition.
    actions: tuple[Action, ...]  #: Actions of the transition, in order.


@dataclass(slots=True)
class _Remote:
    """Data about one remote agent."""

    life: Lifecycle
    backoff: BackOff
    claims: TokenBucket
    wanted: _Version  # newest version in its heartbeats
    speakers: Speakers = field(default_factory=Speakers)
    doubts: int = 0  # failed queries since the last answer or loss
    held: _Version | None = None  # version of the announced description; None before the first one
    metadata: Any = None
    query: int | None = None  # the outstanding query
    heard_ns: int = 0
    retry_ns: int = 0
    expire_ns: int = 0
    due: list[tuple[int, Input]] | None = None  # cached deadlines; None after a change

    @property
    def is_present(self) -> bool:
        return self.life.state.announced is Announced.PRESENT

    def deadlines(self) -> list[tuple[int, Input]]:
        """Return the times at which inputs are due; the first entry has priority."""
        if self.due is None:
            self.due = self._deadlines()
        return self.due

    def _deadlines(self) -> list[tuple[int, Input]]:
        if self.life.state is State.LOST:
            return [(self.expire_ns, Input.EXPIRED)]
        held = self.held[0] if self.held is not None and self.is_present else None
        doubted = self.held is not None and self.doubts >= _MAX_DOUBTS
        due = [(self.speakers.silent_ns(held, doubted=doubted), Input.SILENT)]
        if self.life.state.query is QueryState.BACKING_OFF:
            due.append((self.retry_ns, Input.RETRY))
        return due


class Registry:
    """Life cycles and descriptions of all remote agents that a discoverer knows."""

    def __init__(
        self,
        agent: str,
        *,
        timing: Timing | None = None,
        max_agents: int = MAX_AGENTS,
        on_move: Callable[[Move], None] | None = None,
        on_alarm: Callable[[Hashable, str], None] = lambda _key, _sentence: None,
    ) -> None:
        """Create an empty registry.

        Args:
            agent: The discoverer's own agent.
            timing: Timeouts and waits.
            max_agents: Maximum number of remote agents.
            on_move: Called after each transition.
            on_alarm: Called with a warning and a key that equal warnings share.
        """
        #: Numbers of events: ``heard``, ``dropped_<reason>``, ``asked``, ``failed`` (among them ``mismatched``:
        #: another agent or incarnation answered), ``ignored_answers`` (to abandoned queries), ``twins``
        #: (heartbeats of a duplicate agent name).
        self.counts: Counter[str] = Counter()
        self._agent = agent
        self._own_speakers = Speakers()
        self._own_newest: tuple[int, bytes] = (-1, b"")  # incarnation and publisher
        self._timing = timing or Timing()
        self._max_agents = max_agents
        self._rates = Rates(2 * max_agents)
        self._on_move = on_move
        self._on_alarm = on_alarm
        self._remotes: dict[str, _Remote] = {}
        self._queries = itertools.count(1)

    def heard(self, heartbeat: Heartbeat, publisher_gid: bytes, *, now_ns: int) -> list[Order]:
        """Process a heartbeat, or an ``AgentHeartbeat`` with any values, and return orders."""
        agent = heartbeat.agent
        if not self._rates.take(publisher_gid, now_ns):
            return self.refuse(Refusal.FLOOD, agent, publisher_gid)
        if not is_valid_heartbeat(heartbeat):
            return self.refuse(Refusal.MALFORMED, agent, publisher_gid)
        if agent == self._agent:
            self._record(self._own_speakers, heartbeat, publisher_gid, now_ns)
            return self.refuse(self._own_refusal(heartbeat, publisher_gid), agent, publisher_gid)
        if agent not in self._remotes and not self._add(heartbeat, now_ns):
            return self.refuse(Refusal.FULL, agent, publisher_gid)
        remote = self._remotes[agent]
        source = self._record(remote.speakers, heartbeat, publisher_gid, now_ns)
        remote.due = None
        version = heartbeat.incarnation, heartbeat.revision
        given = _input_of(version, remote, source, now_ns)
        if isinstance(given, Refusal):
            source.trust = False
            return self.refuse(given, agent, publisher_gid)
        self.counts["heard"] += 1
        remote.heard_ns = now_ns
        if given is Input.RESTARTED:
            remote.backoff = self._new_backoff()
        if given is Input.RESTARTED or version > remote.wanted:
            remote.wanted = version
        if given is not Input.HEARD and not source.trust:
            source.trust = None  # a query is under way
        return self._feed(agent, given, now_ns)

    def refuse(self, why: Refusal, agent: str = "", publisher_gid: bytes = b"") -> list[Order]:
        """Count a dropped heartbeat, warn unless an honest agent may have sent it, and return no orders."""
        self.counts[f"dropped_{why.value}"] += 1
        if why not in (Refusal.OWN, Refusal.STALE):
            publisher = publisher_gid.hex() or "an unknown publisher"
            sentence = f"dropped a heartbeat of agent {agent[:MAX_TEXT]!r} from {publisher}"
            self._on_alarm((why, publisher_gid), f"{sentence}: {why.value}")
        return []

    def answered(self, agent: str, query: int, metadata: Any, *, now_ns: int) -> list[Order]:
        """Process the answer to a query, an ``AgentMetadata`` with any values, and return orders."""
        remote = self._queried(agent, query)
        if remote is None:
            return []
        version = metadata.incarnation, metadata.revision
        if metadata.agent != agent or not remote.speakers.is_claimed(*version):
            self.counts["mismatched"] += 1
            return self.failed(agent, query, now_ns=now_ns)
        before = remote.held
        remote.speakers.confirm(*version)
        remote.held = remote.wanted = version
        remote.metadata, remote.query, remote.doubts = metadata, None, 0
        remote.backoff = self._new_backoff()
        if before is not None and before[0] != version[0]:
            return self._feed(agent, Input.ANSWERED_ANEW, now_ns)
        orders = self._feed(agent, Input.ANSWERED, now_ns)
        if before == version:  # a source was confirmed, and the description is the same
            orders = [order for order in orders if order.action is not Action.UPDATED]
        return orders

    def is_claimed(self, metadata: Any) -> bool:
        """Return whether a heartbeat of the agent has claimed the version of an ``AgentMetadata``."""
        remote = self._remotes.get(metadata.agent)
        version = metadata.incarnation, metadata.revision
        return remote is not None and remote.speakers.is_claimed(*version)

    def failed(self, agent: str, query: int, *, now_ns: int) -> list[Order]:
        """Process the failure or the timeout of a query, given by number; return the orders that follow."""
        remote = self._queried(agent, query)
        if remote is None:
            return []
        self.counts["failed"] += 1
        remote.query = None
        remote.doubts += 1
        return self._feed(agent, Input.FAILED, now_ns)

    def due(self, now_ns: int) -> list[Order]:
        """Process the deadlines that have passed, and return orders."""
        orders: list[Order] = []
        for agent, remote in list(self._remotes.items()):
            given = next((given for at_ns, given in remote.deadlines() if at_ns <= now_ns), None)
            can_prove = remote.is_present and remote.doubts < _MAX_DOUBTS
            if given is Input.SILENT and can_prove and remote.speakers.drop_silent(now_ns):
                given = Input.CHANGED  # the remaining sources must prove that the agent is present
            if given is not None:
                orders += self._feed(agent, given, now_ns)
        return orders

    def compensate_pause(self, since_ns: int, now_ns: int) -> None:
        """Extend the time-outs of all agents by a pause of this process, in which it could receive no heartbeats."""
        for remote in self._remotes.values():
            remote.speakers.compensate_pause(since_ns, now_ns)
            remote.due = None

    @property
    def deadline_ns(self) -> int | None:
        """Time at which `due` must be called, ns on the caller's clock; None if nothing is due."""
        deadlines = [at_ns for r in self._remotes.values() for at_ns, _ in r.deadlines()]
        return min(deadlines, default=None)

    @property
    def states(self) -> dict[str, State]:
        """States of all agents in the table, sorted by name."""
        return {agent: remote.life.state for agent, remote in sorted(self._remotes.items())}

    def announcement(self, agent: str) -> Order | None:
        """Return the event that announces an agent to late joiners; None if it is not present."""
        remote = self._remotes.get(agent)
        if remote is None or not remote.is_present:
            return None
        return _announcement(Action.DISCOVERED, agent, remote)

    def _own_refusal(self, heartbeat: Heartbeat, publisher_gid: bytes) -> Refusal:
        """Return `OWN` for the newest incarnation of the own agent, and `SPOOFED` for others."""
        if heartbeat.incarnation > self._own_newest[0]:
            self._own_newest = heartbeat.incarnation, publisher_gid
        return Refusal.OWN if publisher_gid == self._own_newest[1] else Refusal.SPOOFED

    def _record(
        self, speakers: Speakers, heartbeat: Heartbeat, publisher_gid: bytes, now_ns: int
    ) -> Source:
        """Record the source of a heartbeat, and warn if the agent's name is used twice."""
        period_ns = round(self._timing.missed * heartbeat.period_s * 1e9)
        source = speakers.record(
            (publisher_gid, heartbeat.incarnation),
            now_ns=now_ns,
            silent_ns=now_ns + period_ns + self._timing.slack_ns,
            revision=heartbeat.revision,
        )
        sources = speakers.conflicting_sources()
        if sources:
            self.counts["twins"] += 1
            names = [f"{gid.hex()} (incarnation {claimed})" for gid, claimed in sources[:2]]
            sentence = (
                f"two publishers send heartbeats of agent {heartbeat.agent!r} at once, "
                f"{' and '.join(names)}: its name is used twice, or spoofed"
            )
            self._on_alarm(("twins", heartbeat.agent), sentence)
        return source

    def _add(self, heartbeat: Heartbeat, now_ns: int) -> bool:
        """Add an agent to the table, and return whether there is a place.

        In a full table it takes the place of the agent that is lost, or never answered, and was silent longest.
        """
        if len(self._remotes) >= self._max_agents:
            useless = [a for a, remote in self._remotes.items() if remote.life.state in _USELESS]
            if not useless:
                return False
            oldest = min(useless, key=lambda agent: self._remotes[agent].heard_ns)
            self._feed(oldest, Input.EXPIRED, now_ns)
        self._remotes[heartbeat.agent] = _Remote(
            life=Lifecycle(heartbeat.agent),
            backoff=self._new_backoff(),
            claims=TokenBucket(_CLAIMS_PER_S, _CLAIMS_BURST, now_ns),
            wanted=(heartbeat.incarnation, heartbeat.revision),
        )
        return True

    def _queried(self, agent: str, query: int) -> _Remote | None:
        remote = self._remotes.get(agent)
        if remote is None or remote.query != query:
            self.counts["ignored_answers"] += 1
            return None
        return remote

    def _feed(self, agent: str, given: Input, now_ns: int) -> list[Order]:
        remote = self._remotes[agent]
        before = remote.life.state
        remote.due = None
        actions = remote.life.feed(given)
        after = remote.life.state
        if self._on_move is not None:
            move = Move(agent=agent, before=before, given=given, after=after, actions=actions)
            self._on_move(move)
        if after is State.LOST and before is not State.LOST:
            # An agent that comes back is compared with the announced version, not with the queried one.
            assert remote.held is not None
            remote.wanted, remote.doubts = remote.held, 0
            remote.expire_ns = now_ns + self._timing.forget_ns
        orders: list[Order] = []
        for action in actions:
            if action is Action.BACK_OFF:
                remote.retry_ns = now_ns + remote.backoff.next_ns(0)
            elif action is Action.FORGET:
                del self._remotes[agent]
            else:
                orders.append(self._order(action, agent, remote))
        return orders

    def _order(self, action: Action, agent: str, remote: _Remote) -> Order:
        """Return an order, and keep track of the outstanding query."""
        if action in ANNOUNCEMENTS:
            return _announcement(action, agent, remote)
        if action is Action.ABANDON:
            abandoned, remote.query = remote.query, None
            return Order(action=action, agent=agent, query=abandoned)
        self.counts["asked"] += 1
        remote.query = next(self._queries)
        return Order(
            action=action,
            agent=agent,
            query=remote.query,
            failures=remote.backoff.failures,
            wanted=remote.wanted,
        )

    def _new_backoff(self) -> BackOff:
        timing = self._timing
        return BackOff(first_ns=timing.backoff_ns, limit_ns=timing.backoff_max_ns, stable_ns=1)


def _input_of(version: _Version, remote: _Remote, source: Source, now_ns: int) -> Input | Refusal:
    """Return the input that a heartbeat is, or why its claim is not followed."""
    state, wanted = remote.life.state, remote.wanted
    is_idle = state.query is QueryState.NONE and remote.held is not None
    if version[0] == wanted[0]:
        if version[1] > wanted[1]:
            is_refused = is_idle and not source.trust and not remote.claims.take(now_ns)
            return Refusal.CLAIMED if is_refused else Input.CHANGED
        is_trusted = source.trust if state is State.LOST else remote.speakers.any_trusted()
        return Input.CHANGED if is_idle and not is_trusted else Input.HEARD
    if remote.held is not None and version[0] == remote.held[0]:
        return Input.HEARD  # another incarnation is being queried, and this one is still present
    if version[0] < wanted[0] and state.announced is not Announced.LOST:
        return Refusal.STALE if remote.is_present else Input.HEARD
    if remote.claims.take(now_ns):
        return Input.RESTARTED
    return Input.HEARD if state.announced is Announced.NOTHING else Refusal.CLAIMED


def _announcement(event: Action, agent: str, remote: _Remote) -> Order:
    assert remote.held is not None
    incarnation = remote.held[0]
    return Order(action=event, agent=agent, incarnation=incarnation, metadata=remote.metadata)

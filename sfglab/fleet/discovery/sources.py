"""Sources of one agent's name: who speaks for it, each publisher with each start of the agent that it claims.

Anybody can send heartbeats. So a source is believed once the agent's service has answered with the start that
it claims. When one of several falls silent, the others have to prove anew that the agent is there: a period
that somebody else announces hides no death, and a short one makes none. Two side by side are two agents of one
name, or somebody speaks for another. Pure: refuses to know messages and states.
"""

from __future__ import annotations

from dataclasses import dataclass

_Key = tuple[bytes, int]  # a publisher's gid and the start that it claims

#: How many are kept track of for a name; of those not believed the longest unheard goes.
MAX_SOURCES = 8
_TWINS = 2  # how often another one is heard between two beats of each before that is no restart


@dataclass(slots=True)
class Source:
    """One publisher's claim to be one start of the agent."""

    silent_ns: int = 0  #: When it has been unheard for too long, by the period that it announced.
    revision: int = 0  #: Which revision of its description it has announced.
    #: Whether it is believed; None: nobody asked; False: the answer was another.
    trust: bool | None = None
    heard_ns: int = 0  #: When it was heard last.
    beats: int = 0  #: How often it was heard.
    place: int = 0  #: Which of all beats of the name was its last.
    mixed: int = 0  #: How often another source was heard between two beats of it.


class Sources:
    """Everybody who speaks for one name, bounded."""

    def __init__(self) -> None:
        self._known: dict[_Key, Source] = {}
        self._beats = 0

    def note(self, key: _Key, *, now_ns: int, silent_ns: int, revision: int) -> Source:
        """Take note of a beat by a publisher's gid and the start that it claims."""
        source = self._known.setdefault(key, Source())
        self._beats += 1
        source.mixed += bool(source.beats) and self._beats > source.place + 1
        source.beats, source.place = source.beats + 1, self._beats
        source.heard_ns, source.silent_ns, source.revision = now_ns, silent_ns, revision
        if len(self._known) > MAX_SOURCES:
            others = [k for k, s in self._known.items() if not s.trust and k != key]
            del self._known[min(others or self._known, key=lambda k: self._known[k].place)]
        return source

    def twins(self) -> tuple[_Key, ...]:
        """Return those that go on side by side; none if there is one, or one after the other."""
        mixed = tuple(sorted(key for key, source in self._known.items() if source.mixed >= _TWINS))
        return mixed if len(mixed) > 1 else ()

    def says(self, incarnation: int, revision: int) -> bool:
        """Return whether somebody claims this start, and no later revision of it."""
        return any(
            key[1] == incarnation and s.revision <= revision for key, s in self._known.items()
        )

    def answered(self, incarnation: int, revision: int) -> None:
        """Believe those that claim the start that has answered, and nobody else."""
        for (_, claimed), source in self._known.items():
            if claimed != incarnation:
                source.trust = False
            elif source.revision <= revision:
                source.trust = True

    def believed(self) -> bool:
        """Return whether anybody is."""
        return any(source.trust for source in self._known.values())

    def silent_ns(self, held: int | None, *, doubted: bool) -> int:
        """Return when somebody who counts has been unheard for too long.

        Where a start of the agent is there, that is the first of its regular or believed claims; else the last
        of all who may still prove themselves, or when asking has come to nothing (`doubted`) of the believed.
        """
        counted = {
            k: s for k, s in self._known.items() if s.trust or not (doubted or s.trust is False)
        }
        regular = [
            s.silent_ns for (_, at), s in counted.items() if at == held and (s.trust or s.beats > 1)
        ]
        return min(regular, default=max((s.silent_ns for s in counted.values()), default=0))

    def outlive(self, now_ns: int) -> bool:
        """Drop who has been unheard for too long and believe no others; return whether there are any."""
        known = {
            key: s
            for key, s in self._known.items()
            if s.silent_ns > now_ns and s.trust is not False
        }
        if known:
            self._known = known
            for source in known.values():
                source.trust = None
        return bool(known)

    def overslept(self, since_ns: int, now_ns: int) -> None:
        """Count nothing of the time in which the listener itself stood still as silence."""
        for source in self._known.values():
            left_ns = source.silent_ns - max(source.heard_ns, since_ns)
            source.silent_ns = max(source.silent_ns, now_ns + left_ns)

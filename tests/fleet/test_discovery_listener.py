"""What a local consumer knows from discovery events, also when the discoverer is replaced."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.fleet.discovery import listener
from sfglab.messages import default_message
from sfglab.names import FqnError

OLD, NEW, NOBODY = b"o" * 16, b"n" * 16, bytes(16)


def event(agent: str, kind: str = "DISCOVERED", incarnation: int = 1):
    message = default_message(listener.DISCOVERY_EVENT)
    message.agent, message.event = agent, getattr(message, kind)
    message.metadata.agent, message.metadata.incarnation = agent, incarnation
    return message


def known(*agents: str, grace_ns: int = 100) -> listener.KnownAgents:
    """Return what is known after an old discoverer has announced some agents."""
    known_agents = listener.KnownAgents(grace_ns=grace_ns)
    for agent in agents:
        known_agents.feed(event(agent), OLD, now_ns=0)
    return known_agents


def test_the_topic_is_the_papers():
    assert listener.discovery_topic("station") == "/local/station/agent_discovery_event"
    with pytest.raises(FqnError):
        listener.discovery_topic("camera")


def test_agents_are_offered_once_or_when_they_say_something_else_and_a_lost_one_withdrawn():
    agents = listener.KnownAgents()
    first = event("go2")
    assert agents.feed(first, OLD, now_ns=0) == listener.Offered(
        agent="go2", metadata=first.metadata
    )
    assert agents.feed(event("go2"), OLD, now_ns=1) is None
    assert agents.feed(event("go2", "RETURNED"), OLD, now_ns=1) is None
    for kind, incarnation in (("UPDATED", 2), ("RESTARTED", 3)):
        change = agents.feed(event("go2", kind, incarnation), OLD, now_ns=2)
        assert (change.agent, change.metadata.incarnation) == ("go2", incarnation)
    agents = known("go2")
    assert agents.feed(event("go2", "LOST"), OLD, now_ns=1) == listener.Withdrawn(agent="go2")
    assert agents.feed(event("go2", "LOST"), OLD, now_ns=1) is None
    assert isinstance(agents.feed(event("go2", "RETURNED"), OLD, now_ns=2), listener.Offered)


def test_whom_a_new_discoverer_does_not_announce_in_time_is_withdrawn_and_nobody_else():
    agents = known("go2", "husky", "drone1x")
    assert agents.deadline_ns is None
    assert agents.feed(event("go2"), NEW, now_ns=50) is None, (
        "nothing changes for who is announced again"
    )
    assert agents.deadline_ns == 150
    agents.feed(event("drone1x", "LOST"), NEW, now_ns=60)
    assert agents.expire(149) == ()
    assert agents.expire(150) == (listener.Withdrawn(agent="husky"),)
    assert set(agents.agents) == {"go2"}
    assert agents.deadline_ns is None
    agents = known("go2", "husky")
    agents.feed(event("go2"), NEW, now_ns=0)
    agents.feed(event("husky"), NEW, now_ns=99)
    assert agents.deadline_ns is None
    assert agents.expire(10**12) == ()


def test_what_the_old_discoverer_says_does_not_count_but_one_whose_publisher_is_gone():
    agents = known("go2")
    agents.feed(event("go2"), NEW, now_ns=0)
    assert agents.feed(event("go2", "LOST"), OLD, now_ns=1) is None
    assert set(agents.agents) == {"go2"}
    agents = known("go2")
    assert isinstance(agents.feed(event("husky"), NOBODY, now_ns=0), listener.Offered)
    assert agents.deadline_ns is None


EVENTS = st.tuples(
    st.sampled_from(["go2", "husky", "drone1x"]),
    st.sampled_from(["DISCOVERED", "UPDATED", "LOST", "RETURNED", "RESTARTED"]),
    st.integers(1, 3),
)


@given(
    before=st.lists(st.lists(EVENTS, max_size=8), max_size=3),
    last=st.lists(EVENTS, min_size=1, max_size=8),
)
def test_in_the_end_the_last_discoverer_alone_decides(before, last):
    agents, folded = listener.KnownAgents(grace_ns=100), {}
    for number, events in enumerate([*before, last]):
        for agent, kind, incarnation in events:
            change = agents.feed(
                event(agent, kind, incarnation), bytes([number + 1]) * 16, now_ns=number
            )
            if isinstance(change, listener.Offered):
                folded[change.agent] = change.metadata
            elif change is not None:
                del folded[change.agent]
    for withdrawn in agents.expire(10**6):
        del folded[withdrawn.agent]
    final = {agent: kind for agent, kind, _ in last}
    assert set(agents.agents) == {agent for agent, kind in final.items() if kind != "LOST"}
    assert folded == dict(agents.agents), "the changes tell the same as the whole"

"""A local consumer follows discovery events, also when the discoverer is replaced."""

from sfglab.fleet.discovery import listener
from sfglab.fleet.discovery.listener import KnownAgents, Withdrawn
from sfglab.messages import default_message

OLD, NEW, UNKNOWN = b"o" * 16, b"n" * 16, bytes(16)


def event(agent, kind="DISCOVERED", incarnation=1):
    message = default_message(listener.DISCOVERY_EVENT)
    message.agent, message.event = agent, getattr(message, kind)
    message.metadata.agent, message.metadata.incarnation = agent, incarnation
    return message


def test_agents_that_a_new_discoverer_does_not_announce_in_time_are_withdrawn():
    agents = KnownAgents(grace_ns=100)
    for agent in ("go2", "husky", "drone1x"):
        agents.feed(event(agent), OLD, now_ns=0)
    assert agents.feed(event("go2", "LOST"), UNKNOWN, now_ns=1) == Withdrawn(agent="go2")
    assert agents.deadline_ns is None, "an unknown publisher is no new discoverer"
    assert agents.feed(event("husky"), NEW, now_ns=50) is None
    news = agents.feed(event("husky", "RESTARTED", 2), NEW, now_ns=50)
    assert (news.agent, news.metadata.incarnation) == ("husky", 2)
    assert agents.feed(event("husky", "LOST"), OLD, now_ns=51) is None, "it has been replaced"
    assert (agents.deadline_ns, agents.expire(149)) == (150, ())
    assert agents.expire(150) == (Withdrawn(agent="drone1x"),)
    assert agents.deadline_ns is None
    agents.feed(event("husky"), b"third", now_ns=200)
    assert agents.deadline_ns is None, "all were announced"

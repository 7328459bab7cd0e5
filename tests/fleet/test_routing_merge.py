"""QoS across the border: whoever would match directly matches through the router, and is served as well."""

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from sfglab import qos
from sfglab.fleet.policy import QUEUE_DEPTH, announced_qos, offered_qos, requested_qos

profiles = st.builds(
    qos.QoSProfile,
    reliability=st.sampled_from(qos.Reliability),
    durability=st.sampled_from(qos.Durability),
    history=st.sampled_from(qos.History),
    depth=st.integers(1, 2000),
    deadline_ns=st.none() | st.integers(1, 10**12),
    lifespan_ns=st.none() | st.integers(1, 10**12),
    liveliness=st.sampled_from(qos.Liveliness),
    lease_ns=st.none() | st.integers(1, 10**12),
)
topics = st.sampled_from(["rt/tf", "rq/global/a/xRequest", "rr/global/a/xReply"])


@given(topics, profiles, st.lists(profiles))
def test_the_reader_of_a_source_always_matches_it(topic, source, sinks):
    requested = requested_qos(topic, source, sinks)
    assert qos.incompatibilities(offered=source, requested=requested) == ()
    assert requested.history is qos.History.KEEP_ALL or requested.depth >= QUEUE_DEPTH


@given(profiles, profiles)
def test_the_writer_matches_exactly_whom_the_source_would(source, sink):
    direct = qos.incompatibilities(offered=source, requested=sink)
    assert qos.incompatibilities(offered=offered_qos(source), requested=sink) == direct


@given(profiles)
def test_the_writer_keeps_a_latched_history_exactly_and_a_volatile_one_at_least(source):
    offered = offered_qos(source)
    assert replace(offered, depth=source.depth) == source
    if source.durability is qos.Durability.TRANSIENT_LOCAL or source.history is qos.History.KEEP_ALL:
        assert offered == source
    assert offered.depth >= source.depth


def test_best_effort_causes_no_reliable_hop_latched_is_fetched_and_the_strongest_announced():
    reliability = {
        (source.reliability, sink.reliability): requested_qos("rt/x", source, [sink]).reliability
        for source in (qos.DEFAULT, qos.SENSOR_DATA)
        for sink in (qos.DEFAULT, qos.SENSOR_DATA)
    }
    reliable, best_effort = qos.Reliability.RELIABLE, qos.Reliability.BEST_EFFORT
    assert [pair for pair, hop in reliability.items() if hop is reliable] == [(reliable, reliable)]
    assert set(reliability.values()) == {reliable, best_effort}
    deep = replace(qos.LATCHED, depth=300)
    assert requested_qos("rt/x", deep, [qos.SENSOR_DATA]) == deep
    assert offered_qos(deep) == deep
    strongest = announced_qos("rt/tf", [qos.SENSOR_DATA, qos.DEFAULT, replace(qos.SENSOR_DATA, depth=1)])
    assert (strongest.reliability, strongest.durability) == (qos.Reliability.RELIABLE, qos.Durability.VOLATILE)
    assert announced_qos("rt/tf", [qos.DEFAULT, qos.LATCHED]).durability is qos.Durability.TRANSIENT_LOCAL
    assert announced_qos("rt/tf", [qos.SENSOR_DATA]).reliability is qos.Reliability.BEST_EFFORT
    assert announced_qos("rq/global/a/xRequest", [qos.DEFAULT]).history is qos.History.KEEP_ALL

"""Table 1 and Eq. 1 of paper A: what crosses, checked against a formulation of its own."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.fleet.policy import TABLE_1, Crossing, Direction, ForwardRule, Policy, Side
from sfglab.names import Resource, ResourceKind, RosFqnBuilder, Scope, all_standard_fqns, dds_names

BOTH = frozenset(Side)


def in_f_forward(dds_name: str) -> bool:
    """Table 1 without patterns: three prefixes, one scope, and the two transform topics."""
    prefix, _, rest = dds_name.partition("/")
    if prefix == "rt" and rest in {"tf", "tf_static"}:
        return True
    return prefix in {"rt", "rq", "rr"} and rest.startswith("global/")


segments = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,8}", fullmatch=True)
near = st.sampled_from(["global", "local", "tf", "tf_static", "globally", "global_x", "GLOBAL", "tf2"])
ros_names = st.lists(near | segments, min_size=1, max_size=5).map("/".join)
tails = st.sampled_from(["", "Request", "Reply", "/_action/feedback"])
prefixes = st.sampled_from(["rt", "rq", "rr", "rs", "rp", "RT", "rt ", ""])
dds = st.builds(lambda p, n, t: f"{p}/{n}{t}", prefixes, ros_names, tails) | st.text(max_size=30)


@given(dds, st.sampled_from(Direction))
def test_a_name_crosses_exactly_if_it_is_in_table_1_and_both_ways(name, way):
    assert Policy().crosses(name, way) is in_f_forward(name)


@given(dds)
def test_eq_1_a_message_is_heard_in_both_domains_or_stays_where_it_is(name):
    for side in Side:
        expected = BOTH if in_f_forward(name) else frozenset({side})
        assert Policy().domains(name, side) == expected


def test_of_all_standard_names_the_global_ones_cross_whole_and_the_local_ones_not_at_all():
    fqns = list(all_standard_fqns("go2"))
    assert len(fqns) > 10_000
    for fqn in fqns:
        for way in Direction:
            crossing = Policy().crossing(str(fqn), fqn.kind, way)
            assert crossing is (Crossing.WHOLE if fqn.scope is Scope.GLOBAL else Crossing.NONE), fqn
        assert all(in_f_forward(name) is fqn.is_global for name in fqn.dds_names)


@given(ros_names, st.sampled_from(ResourceKind))
def test_no_local_name_ever_crosses(rest, kind):
    plain = rest.replace("_", "x")
    for name in (f"/local/{plain}", f"/local/global/{plain}"):
        assert not any(Policy().crosses(part, way) for part in dds_names(name, kind) for way in Direction)


@pytest.mark.parametrize(
    "name",
    [
        "rt/tf2",
        "rt/tf_static2",
        "rt/tf/x",
        "rt/go2/tf",
        "rt/global",
        "rt/globally/x",
        "rt/global_x",
        "rt/local/global/x",
        "rt/GLOBAL/x",
        "rq/tf",
        "rr/tf_static",
        "rq/local/go2/resetRequest",
        "rs/global/x",
        "xrt/global/x",
        "ros_discovery_info",
        "rt/rosout",
        "rt/parameter_events",
    ],
)
def test_near_misses_stay(name):
    assert not any(Policy().crosses(name, way) for way in Direction)


def test_the_names_of_the_paper_cross():
    heartbeat = RosFqnBuilder().scope(Scope.GLOBAL).without_agent().resource(Resource.AGENT_HEARTBEAT).build()
    metadata = RosFqnBuilder().scope(Scope.GLOBAL).agent("go2").resource(Resource.GET_METADATA).build()
    event = RosFqnBuilder().scope(Scope.LOCAL).agent("go2").resource(Resource.AGENT_DISCOVERY_EVENT).build()
    crossing = [Policy().crossing(str(f), f.kind, Direction.OUTWARD) for f in (heartbeat, metadata, event)]
    assert crossing == [Crossing.WHOLE, Crossing.WHOLE, Crossing.NONE]


def test_table_1_has_the_papers_five_rows():
    patterns = [rule.pattern for rule in TABLE_1]
    assert patterns == ["rt/tf", "rt/tf_static", "rt/global/*", "rq/global/*", "rr/global/*"]
    assert all(rule.directions == frozenset(Direction) for rule in TABLE_1)


@given(dds)
def test_a_rule_of_one_direction_lets_nothing_cross_against_it(name):
    outward = tuple(
        ForwardRule(pattern=r.pattern, description="", directions=frozenset({Direction.OUTWARD}))
        for r in TABLE_1
    )
    policy = Policy(rules=outward)
    assert policy.crosses(name, Direction.OUTWARD) is in_f_forward(name)
    assert not policy.crosses(name, Direction.INWARD)
    assert policy.domains(name, Side.GLOBAL) == frozenset({Side.GLOBAL})


def test_a_service_whose_replies_stay_is_half_open():
    policy = Policy(rules=tuple(rule for rule in TABLE_1 if rule.pattern != "rr/global/*"))
    crossing = policy.crossing("/global/go2/get_metadata", ResourceKind.SERVICE, Direction.OUTWARD)
    assert crossing is Crossing.HALF


@given(
    st.lists(st.sampled_from([rule.pattern for rule in TABLE_1] + ["rt/local/*", "*", "rt/??"]), max_size=3),
    dds,
)
def test_more_rules_never_let_less_cross(patterns, name):
    rules = tuple(ForwardRule(pattern=pattern, description="") for pattern in patterns)
    more = Policy(rules=(*TABLE_1, *rules))
    for way in Direction:
        assert more.crosses(name, way) >= Policy().crosses(name, way)

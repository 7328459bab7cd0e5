"""Table 1 and Eq. 1 of paper A: what crosses, checked against a formulation of its own."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from sfglab.fleet.policy import TABLE_1, Crossing, Direction, ForwardRule, Policy, Side
from sfglab.lab.checks.routing import in_table_1
from sfglab.names import Resource, ResourceKind, RosFqnBuilder, Scope

BOTH = frozenset(Side)


segments = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,8}", fullmatch=True)
near = st.sampled_from(["global", "local", "tf", "tf_static", "globally", "global_x", "GLOBAL", "tf2"])
ros_names = st.lists(near | segments, min_size=1, max_size=5).map("/".join)
tails = st.sampled_from(["", "Request", "Reply", "/_action/feedback"])
prefixes = st.sampled_from(["rt", "rq", "rr", "rs", "rp", "RT", "rt ", ""])
dds = st.builds(lambda p, n, t: f"{p}/{n}{t}", prefixes, ros_names, tails) | st.text(max_size=30)


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
    assert policy.crosses(name, Direction.OUTWARD) is in_table_1(name)
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

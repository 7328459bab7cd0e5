"""Policies other than Table 1: rules of one direction, half of a service, and more rules."""

from dataclasses import replace

from hypothesis import given
from hypothesis import strategies as st

from sfglab.fleet.policy import TABLE_1, Crossing, Direction, ForwardRule, Policy, Side
from sfglab.lab.checks.routing import in_table_1
from sfglab.names import ResourceKind

segments = st.from_regex(r"[A-Za-z_][A-Za-z0-9_]{0,8}", fullmatch=True)
near = st.sampled_from(["global", "local", "tf", "tf_static", "globally", "global_x", "GLOBAL", "tf2"])
ros_names = st.lists(near | segments, min_size=1, max_size=5).map("/".join)
tails = st.sampled_from(["", "Request", "Reply", "/_action/feedback"])
prefixes = st.sampled_from(["rt", "rq", "rr", "rs", "rp", "RT", "rt ", ""])
dds = st.builds(lambda p, n, t: f"{p}/{n}{t}", prefixes, ros_names, tails) | st.text(max_size=30)


@given(dds)
def test_a_rule_of_one_direction_lets_nothing_cross_against_it(name):
    outward = tuple(replace(rule, directions=frozenset({Direction.OUTWARD})) for rule in TABLE_1)
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

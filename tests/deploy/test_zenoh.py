"""Zenoh configurations: what is generated is the policy, and the checker finds what opens or breaks them."""

import json

import json5
import pytest
from esslingen import LAB, codes, fleet_of, json_values, rule
from hypothesis import assume, given
from hypothesis import strategies as st

from sfglab.deploy.errors import DeployError
from sfglab.deploy.routers.targets import check_file
from sfglab.deploy.routers.zenoh import KINDS, render_zenoh_acl, render_zenoh_bridge
from sfglab.deploy.routers.zenoh_check import (
    bridges,
    check_zenoh,
    includes,
    permits,
    policy_bridges,
)
from sfglab.deploy.shapes import read_json5
from sfglab.documents import DocumentError
from sfglab.fleet.lint import Severity
from sfglab.fleet.policy import TABLE_1, Direction, Policy
from sfglab.names import FqnError

AGENTS = [agent.name for agent in LAB.agents]
WRITERS = {"bridge": render_zenoh_bridge, "acl": render_zenoh_acl}


def values_of(text: str):
    """What stands below the comments at the top, which is plain JSON."""
    return json.loads("\n".join(line for line in text.splitlines() if not line.startswith("//")))


def plugin_of(fleet):
    return values_of(render_zenoh_bridge(fleet, "go2"))["plugins"]["ros2dds"]


def control_of(fleet):
    return values_of(render_zenoh_acl(fleet, "go2"))["access_control"]


def bridge(**plugin) -> str:
    return json.dumps({"plugins": {"ros2dds": plugin}})


@pytest.mark.parametrize("agent", AGENTS)
@pytest.mark.parametrize("target", WRITERS)
def test_what_is_generated_says_from_what_and_passes_the_checker(agent, target):
    text = WRITERS[target](LAB, agent)
    assert f"agent {agent} in fleet lab" in text.partition("{")[0]
    assert check_zenoh(text, policy=LAB.policy) == ()
    assert json5.loads(text) == values_of(text)


def test_a_bridge_of_table_1_says_domain_names_and_no_namespace():
    plugin = plugin_of(LAB)
    assert (plugin["domain"], plugin["namespace"]) == (1, "/")
    assert plugin["allow"]["publishers"] == ["/global/.*", "/tf", "/tf_static"]
    assert plugin["allow"]["service_clients"] == ["/global/.*"]
    assert set(plugin["allow"]) == set(KINDS)


OTHERS = (
    "rt/global/a rt/glob* rq/glob* rr/glob* rr/global/a* rq/global/aRequest rr/global/aReply rt/*"
)
simple = st.sampled_from([*(r.pattern for r in TABLE_1), *OTHERS.split()])
ways = st.sampled_from([(), (Direction.INWARD,), (Direction.OUTWARD,)])
policies = st.lists(st.builds(lambda p, w: rule(p, *w), simple, ways), min_size=1, max_size=6)
parts = st.sampled_from(
    ["tf", "tf_static", "global", "local", "glob", "a", "ab", "b", "x", "globally"]
)
names = st.lists(parts, min_size=1, max_size=4).map(lambda p: "/" + "/".join(p))


@given(policies, names, st.sampled_from(KINDS))
def test_a_generated_bridge_routes_exactly_what_the_policy_lets_cross(rules, name, kind):
    fleet = fleet_of(*rules)
    # An action that bears the beginning of a rule as its whole name is left out, see `bridged_names`.
    odd = any(r.pattern in {f"rq{name}/*", "rq/glob*"} for r in rules)
    assume(not (kind.startswith("action") and odd))
    assert bridges(plugin_of(fleet), kind, name) is policy_bridges(fleet.policy, kind, name)


@given(policies, names)
def test_generated_access_control_lets_exactly_the_policys_messages_pass(rules, name):
    fleet = fleet_of(*rules)
    control, key = control_of(fleet), name[1:]
    for way, flow in ((Direction.OUTWARD, "egress"), (Direction.INWARD, "ingress")):
        assert permits(control, "put", flow, key) is fleet.policy.crosses(f"rt{name}", way)
    for kind, flow in (("service_clients", "egress"), ("service_servers", "ingress")):
        assert permits(control, "query", flow, key) is policy_bridges(fleet.policy, kind, name)


@pytest.mark.parametrize(
    "pattern",
    [
        "*",
        "rt/a*b",
        "rt/[ab]",
        "rt/?",
        "ros_discovery_info",
        "rt/global/x/_action/*",
        "rq/global/Re*",
        "tf",
    ],
)
def test_what_ros_names_cannot_say_is_refused_instead_of_approximated(pattern):
    for write in WRITERS.values():
        with pytest.raises(DeployError, match="rule"):
            write(fleet_of(rule(pattern)), "go2")


@pytest.mark.parametrize(
    ("rules", "kinds"),
    [
        ([rule(r.pattern, Direction.OUTWARD) for r in TABLE_1], {"publishers"}),
        ([rule("rt/global/*"), rule("rq/global/*")], {"publishers", "subscribers"}),
    ],
)
def test_an_outward_policy_has_no_subscribers_and_a_service_whose_replies_stay_is_not_bridged(
    rules, kinds
):
    allow = plugin_of(fleet_of(*rules))["allow"]
    assert {kind for kind in KINDS if allow[kind]} == kinds


@pytest.mark.parametrize(
    ("expression", "key", "expected"),
    [
        ("global/*/**", "global", False),
        ("global/*/**", "global/x", True),
        ("global/*/**", "global/x/y/z", True),
        ("global/*/**", "global/x/@adv/pub", False),
        ("global/*/**/@adv/**", "global/x/y/@adv/pub/1/2/_", True),
        ("tf", "tf_static", False),
        ("global/cam$*/**", "global/camera/x", True),
        ("global/cam$*/**", "global/x/camera", False),
        ("@/*/@ros2_lv/MP/global§$*/**", "@/ab/@ros2_lv/MP/global§x/T/q", True),
        ("@/*/@ros2_lv/MP/global§$*/**", "@/ab/@ros2_lv/MP/local§x/T/q", False),
        ("**", "a/b", True),
        ("**", "@/a", False),
    ],
)
def test_key_expressions_mean_what_they_mean_to_zenoh(expression, key, expected):
    assert includes(expression, key) is expected  # the same answers as eclipse-zenoh 1.10


def test_access_control_keeps_what_late_joiners_need_and_announcements_of_crossing_names_only():
    control = control_of(LAB)
    assert permits(control, "query", "ingress", "tf_static/@adv/pub/1/2/_")
    assert permits(control, "declare_liveliness_subscriber", "ingress", "@/1/@ros2_lv/x")
    assert permits(control, "liveliness_token", "egress", "@/1/@ros2_lv/MP/tf/T/q")
    assert not permits(control, "liveliness_token", "egress", "@/1/@ros2_lv/MP/local§go2§x/T/q")


RULE = {"id": "r", "permission": "allow", "messages": ["put"], "key_exprs": ["tf"]}


def control(**changes) -> str:
    whole = {
        "enabled": True,
        "default_permission": "deny",
        "rules": [{**RULE, "flows": ["egress"]}],
        "subjects": [{"id": "s"}],
        "policies": [{"rules": ["r"], "subjects": ["s"]}],
    }
    return json.dumps({"access_control": {**whole, **changes}})


@pytest.mark.parametrize(
    ("text", "code"),
    [
        (bridge(domain=1), "open-router"),
        (bridge(allow={}, deny={}), "schema"),
        (bridge(alow={}), "unknown-key"),
        (bridge(allow={"publisher": []}), "unknown-key"),
        (bridge(allow={"publishers": ["["]}), "schema"),
        (bridge(allow={"publishers": ["(?!/local).*"]}), "schema"),
        (bridge(allow={"publishers": ["/tf|/global/.*"]}), "loose-regex"),
        (bridge(allow={"publishers": "/tf|/x"}), "loose-regex"),
        (bridge(allow={}, domain=233), "schema"),
        (bridge(allow={}, pub_priorities=["/tf=8"]), "schema"),
        (bridge(allow={}, pub_max_frequencies=["/tf"]), "schema"),
        (bridge(allow={}, queries_timeout={"actions": {"goal": 1}}), "unknown-key"),
        (control(enabled=False), "open-router"),
        (control(rules=[RULE, RULE]), "duplicate"),
        (control(subjects=[{"id": "s"}, {"id": "s"}]), "duplicate"),
        (control(policies=[{"rules": ["q"], "subjects": ["s"]}]), "reference"),
        (control(rules=[{**RULE, "messages": ["publish"]}]), "schema"),
        (control(rules=[{**RULE, "flows": ["out"]}]), "schema"),
        (control(rules=[{**RULE, "key_exprs": ["/tf"]}]), "key-expression"),
        (control(rules=[{**RULE, "key_exprs": ["a*/b"]}]), "key-expression"),
        (control(rules=[{**RULE, "key_exprs": []}]), "schema"),
        (control(subjects=[{"id": "s", "interfaces": []}]), "schema"),
        (control(default_permision="deny"), "unknown-key"),
        ('{"access_control": {"enabled": true}}', "missing-key"),
        ("[]", "schema"),
        ("{}", "nothing-filtered"),
    ],
)
def test_a_wrong_bridge_or_access_control_is_an_error_of_its_kind(text, code):
    assert codes(check_zenoh(text)) == {code}


def test_a_filter_that_denies_is_loose_or_one_sided_is_warned_of_and_lets_more_cross():
    plugin = {"allow": {"publishers": ["/tf|/global/.*"]}}
    assert bridges(plugin, "publishers", "/tf_secret")
    assert bridges(plugin, "publishers", "/local/global/x")
    assert not codes(
        check_zenoh(bridge(allow={"publishers": ["(?:/tf|/global/.*)", "/a[|]b", r"/a\|b"]}))
    )
    denied = check_zenoh(bridge(deny={"publishers": ["/rosout"]}))
    assert codes(denied, Severity.WARNING) == {"open-router"}
    loose = check_zenoh(
        bridge(allow={"publishers": ["/tf"]}, pub_max_frequencies=["/tf=10"], namespace="/go2")
    )
    assert codes(loose, Severity.WARNING) == {"loose-regex"}
    assert codes(loose) == {"namespace"}
    assert "also finds /tf_static" in next(f.why for f in loose if f.code == "loose-regex")
    assert (
        check_zenoh(bridge(allow={"publishers": ["/tf"]}, pub_max_frequencies=["^/tf$=10"])) == ()
    )
    half = check_zenoh(bridge(allow={"service_servers": [".*/reset"]}))
    assert codes(half, Severity.WARNING) == {"half-open"}


@pytest.mark.parametrize("kind", KINDS)
def test_every_list_that_differs_from_the_policy_is_found(kind):
    config = json5.loads(render_zenoh_bridge(LAB, "go2"))
    config["plugins"]["ros2dds"]["allow"][kind].append("/local/.*")
    found = [f for f in check_zenoh(json.dumps(config), policy=LAB.policy) if f.code == "policy"]
    assert [f.place.key for f in found] == [f"plugins.ros2dds.allow.{kind}"]
    config["plugins"]["ros2dds"]["allow"][kind] = []
    assert "policy" in codes(check_zenoh(json.dumps(config), policy=LAB.policy))


def test_access_control_that_is_not_the_policy_is_found_and_a_denying_rule_wins():
    assert codes(check_zenoh(control(), policy=Policy())) == {"policy"}
    assert codes(check_zenoh(control(default_permission="allow")), Severity.WARNING) == {
        "open-router"
    }
    rules = [RULE, {**RULE, "id": "no", "permission": "deny"}]
    both = json.loads(control(rules=rules, policies=[{"rules": ["r", "no"], "subjects": ["s"]}]))
    assert not permits(both["access_control"], "put", "egress", "tf")


@pytest.mark.parametrize(
    "text",
    [
        "{a: 1, // one\n 'b': \"x // no comment\", /* two\nlines */ c: [1, 2,], }",
        '{"a":{"b":[true,false,null,1.5e3]},}',
        "{\tplugins: {\n\t\tx: 'it\\'s \"so\"' } }",
        "[]",
    ],
)
def test_json5_is_read_as_other_readers_do(text):
    assert read_json5(text, "x.json5").value == json5.loads(text)


@given(json_values)
def test_every_json_document_is_read_back(value):
    assert read_json5(json.dumps(value, indent=1), "x.json").value == value


def test_lines_are_those_of_the_file_and_what_is_no_json5_is_refused(tmp_path):
    found = check_zenoh(
        "{\n  // a comment\n  plugins: {ros2dds: {\n    alow: {},\n  }},\n}", file="b.json5"
    )
    assert found[0].place.line == 4
    with pytest.raises(DocumentError):
        check_zenoh("{a: [}")
    path = tmp_path / "bridge.json5"
    path.write_text(render_zenoh_bridge(LAB, "go2"))
    assert check_file(path, policy=LAB.policy) == ()


def test_names_that_are_invalid_for_their_kind_say_so():
    with pytest.raises(FqnError):
        policy_bridges(Policy(), "publishers", "no/slash")

"""DDS Router configurations: what is generated is the policy; the checker knows schema, reader and meaning."""

import copy

import pytest
import yaml
from esslingen import LAB, codes, fleet_of, rule
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.deploy.errors import DeployError
from sfglab.deploy.routers.dds_router import accepts, render_dds_router
from sfglab.deploy.routers.dds_router_check import check_dds_router
from sfglab.deploy.shapes import _validator, check_shape
from sfglab.documents import Document
from sfglab.errors import InvalidValueError
from sfglab.fleet.lint import Severity
from sfglab.fleet.policy import TABLE_1, Direction, Policy

AGENTS = [agent.name for agent in LAB.agents]

MINIMAL = {
    "version": "v5.0",
    "allowlist": [{"name": rule.pattern} for rule in TABLE_1],
    "specs": {"remove-unused-entities": False, "qos": {"history-depth": 10}},
    "participants": [
        {"name": "local", "kind": "local", "domain": 7},
        {"name": "global", "kind": "local", "domain": 0},
    ],
}


def changed(**changes):
    return {**copy.deepcopy(MINIMAL), **changes}


def check(config, policy=None):
    return check_dds_router(yaml.safe_dump(config), policy=policy)


@pytest.mark.parametrize("agent", AGENTS)
def test_what_is_generated_passes_the_checker_and_the_policy(agent):
    assert check_dds_router(render_dds_router(LAB, agent), policy=LAB.policy) == ()


def test_it_says_what_table_1_and_the_paper_ask_for_and_from_what():
    text = render_dds_router(LAB, "go2")
    head = text.partition("\n\n")[0]
    assert "agent go2 in fleet lab" in head
    assert "rt/tf, rt/tf_static, rt/global/*, rq/global/*, rr/global/*" in head
    config = yaml.safe_load(text)
    assert config["version"] == "v5.0"
    assert [item["name"] for item in config["allowlist"]] == [r.pattern for r in TABLE_1]
    assert config["specs"]["remove-unused-entities"] is False
    assert {p["name"]: p["domain"] for p in config["participants"]} == {"local": 1, "global": 0}
    assert "routes" not in config
    local, outside = config["participants"]
    # Interfaces become addresses or a remark, never a name that is passed over.
    assert local["whitelist-interfaces"] == ["127.0.0.1"]
    assert "whitelist-interfaces" not in outside
    assert "# To keep to wlan0" in text


PATTERNS = [
    *(r.pattern for r in TABLE_1),
    "rt/local/x",
    "rt/*map",
    "r?/global/[ab]*",
    "rq/a*/b",
    "*",
]
patterns = st.lists(st.sampled_from(PATTERNS), min_size=1, max_size=4, unique=True)
PARTS = "rt rq rr tf tf_static global local a b map aRequest x"
parts = st.sampled_from(PARTS.split())
topics = st.lists(parts, min_size=1, max_size=5).map("/".join) | st.text(max_size=12)


@given(patterns, topics)
def test_a_generated_router_accepts_exactly_what_the_policy_lets_cross(chosen, name):
    fleet = fleet_of(*map(rule, chosen))
    config = yaml.safe_load(render_dds_router(fleet, "go2"))
    assert accepts(config, name) is any(fleet.policy.crosses(name, way) for way in Direction)


@given(patterns, patterns)
def test_the_checker_finds_every_difference_between_allowlist_and_policy_that_a_name_shows(
    written, meant
):
    policy = Policy(rules=tuple(map(rule, meant)))
    config = changed(allowlist=[{"name": pattern} for pattern in written])
    found = "policy" in codes(check(config, policy=policy))
    if set(written) == set(meant):
        assert not found
    if found:
        assert set(written) != set(meant)
    elif not {"*"} & {*written, *meant}:
        simple = {p for p in {*written, *meant} if "*" not in p[:-1] and not {"?", "["} & set(p)}
        assert set(written) & simple == set(meant) & simple


def test_an_empty_policy_is_refused_because_an_empty_allowlist_opens_the_router():
    with pytest.raises(DeployError, match="'everything'"):
        render_dds_router(fleet_of(), "go2")


def test_rules_of_one_direction_become_routes_and_mixed_ones_are_refused():
    config = yaml.safe_load(render_dds_router(fleet_of(rule("rt/a", Direction.OUTWARD)), "go2"))
    assert config["routes"] == [{"src": "local", "dst": ["global"]}, {"src": "global"}]
    assert check(config) == ()
    inward = yaml.safe_load(render_dds_router(fleet_of(rule("rt/a", Direction.INWARD)), "go2"))
    assert inward["routes"] == [{"src": "global", "dst": ["local"]}, {"src": "local"}]
    with pytest.raises(DeployError, match="rt/b outward"):
        render_dds_router(fleet_of(rule("rt/a"), rule("rt/b", Direction.OUTWARD)), "go2")


@pytest.mark.parametrize("allowlist", [[], None, [{"name": "*"}], [{"name": "**"}]])
def test_an_open_router_is_an_error(allowlist):
    assert check(MINIMAL, policy=Policy()) == ()
    config = changed(allowlist=allowlist)
    if allowlist is None:
        del config["allowlist"]
    assert "open-router" in codes(check(config))
    assert accepts(config, "rt/anything")


def participants(*items):
    return changed(participants=[*items, MINIMAL["participants"][1]])


ADDRESS = {"ip": "10.0.0.1", "port": 7400}


def local(**more):
    return participants({"name": "a", "kind": "local", "domain": 1, **more})


def wan(**more):
    return participants({"name": "a", "kind": "wan", "listening-addresses": [ADDRESS], **more})


def at(**more):
    return wan(**{"listening-addresses": [{**ADDRESS, **more}]})


@pytest.mark.parametrize(
    ("config", "code"),
    [
        (changed(version="v3.0"), "version"),
        (changed(version="v9.9"), "schema"),
        (changed(allowList=[]), "unknown-key"),
        (changed(specs={"remove-unused-entities": "no"}), "schema"),
        (changed(specs={"remove-unused-entities": True}), "static-lost"),
        (changed(specs={"qos": {"reliability": "RELIABLE"}}), "schema"),
        (changed(specs={"qos": {"downsampling": 0}}), "schema"),
        (changed(specs={"discovery-trigger": "publisher"}), "schema"),
        (changed(specs={"monitor": {"topics": {"enable": True, "period": 0}}}), "schema"),
        (changed(allowlist=[{"name": "rq/global/*"}]), "half-open"),
        (changed(allowlist=[{"name": "rr/global/aReply"}]), "half-open"),
        (changed(allowlist=[{"name": "rt/a", "keyed": True}]), "unknown-key"),
        (changed(allowlist=[{"type": "T"}]), "missing-key"),
        (changed(**{"builtin-topics": [{"name": "rt/*", "type": "T"}]}), "wildcard"),
        (changed(**{"topic-routes": [{"name": "rt/a", "type": "T"}]}), "missing-key"),
        (changed(routes=[{"src": "elsewhere"}]), "route"),
        (changed(routes=[{"src": "local"}, {"src": "local"}]), "route"),
        (changed(participants=[]), "schema"),
        (changed(xml={}), "missing-key"),
        (local(name="global"), "duplicate-participant"),
        (local(domain=0), "loop"),
        (local(domain=233), "schema"),
        (local(repeater=True), "kind-key"),
        (local(**{"whitelist-interfaces": ["eth0"]}), "address"),
        (local(**{"ros2-easy-mode": "::1"}), "address"),
        (local(**{"ros2-easy-mode": "10.0.0.1"}, transport="shm"), "easy-mode"),
        (participants({"name": "a", "kind": "void"}), "schema"),
        (participants({"name": "a", "kind": "echo", "domain": 1}), "kind-key"),
        (participants({"name": "a", "kind": "wan"}), "missing-key"),
        (participants({"name": "a", "kind": "xml"}), "schema"),
        (wan(kind="ds", domain=1), "kind-key"),
        (wan(**{"listening-addresses": []}), "schema"),
        (wan(**{"listening-addresses": [{"ip": "10.0.0.1"}]}), "missing-key"),
        (wan(**{"listening-addresses": [{"port": 1}]}), "missing-key"),
        (at(port=65536), "schema"),
        (at(**{"ip-version": "ipv4"}), "schema"),
        (at(**{"ip-version": "v6"}), "address"),
        (wan(tls={"ca": "c", "cert": "x"}), "tls"),
        (wan(tls={}), "missing-key"),
    ],
)
def test_a_mistake_is_an_error_of_its_kind(config, code):
    assert code in codes(check(config))


def test_a_repeater_must_lead_to_itself():
    config = {**wan(repeater=True), "routes": [{"src": "a", "dst": ["global"]}]}
    assert "route" in codes(check(config))
    config["routes"][0]["dst"].append("a")
    assert check(config) == ()


def test_what_only_deserves_attention_is_no_error():
    findings = check(
        changed(version="v4.0", specs={}, participants=[{"name": "a", "kind": "local"}])
    )
    assert codes(findings) == set()
    assert codes(findings, Severity.WARNING) == {"version", "no-domain", "one-sided"}
    assert codes(findings, Severity.INFO) == {"history"}
    narrowed = changed(allowlist=[{"name": "rt/tf", "type": "T"}])
    policy = Policy(rules=(rule("rt/tf"),))
    assert codes(check(narrowed, policy=policy), Severity.WARNING) == {"policy"}


def test_a_finding_says_its_line_and_an_unknown_agent_names_the_likely_one():
    finding = check_dds_router(
        "participants:\n  - {name: a, kind: local}\nallowlst: []\n", file="r.yaml"
    )[0]
    assert (finding.place.line, finding.place.key) == (3, "allowlst")
    assert "did you mean 'allowlist'?" in finding.what
    with pytest.raises(InvalidValueError, match="did you mean 'go2'"):
        render_dds_router(LAB, "go3")


scalars = st.sampled_from(
    ["a", "v5.0", "local", "wan", "ds", "xml", "", 0, 1, 7, 233, -1, 1.5, True, None, [], {}]
)
KEYS = """name kind domain port ip version specs qos threads allowlist routes src dst repeater profile verbose
    tls ca transport reliability history-depth enable period listening-addresses discovery-server-guid id"""
keys = st.sampled_from(KEYS.split())
SERVER = {"discovery-server-guid": {"id": 1}, "connection-addresses": [ADDRESS]}
BASES = [
    MINIMAL,
    at(port=1),
    participants({"name": "d", "kind": "ds", **SERVER}),
    participants({"name": "e", "kind": "echo", "verbose": True}),
    changed(
        routes=[{"src": "local", "dst": ["global"]}],
        topics=[{"name": "rt/a", "participants": ["local"], "qos": {"max-rx-rate": 1.0}}],
        specs={"threads": 2, "monitor": {"domain": 1, "status": {"enable": True, "period": 5}}},
    ),
]


def mappings_in(value):
    if isinstance(value, dict):
        yield value
    for inner in (
        value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    ):
        yield from mappings_in(inner)


@settings(max_examples=100)
@given(
    st.sampled_from(BASES),
    st.lists(st.tuples(st.integers(0, 40), keys, scalars | st.just("DROP")), max_size=3),
)
def test_every_message_of_the_schema_becomes_a_finding_with_place_and_words(base, changes):
    config = copy.deepcopy(base)
    for position, key, value in changes:
        found = list(mappings_in(config))
        target = found[position % len(found)]
        if value == "DROP":
            target.pop(key, None)
        else:
            target[key] = copy.deepcopy(value)
    findings = check_shape(Document(yaml.safe_dump(config), "r.yaml"), "dds-router")
    assert bool(findings) is not _validator("dds-router").is_valid(config)
    assert all(f.place.line and f.what and f.why and "schema (" not in f.what for f in findings)

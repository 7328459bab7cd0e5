"""DDS Router configurations: what is generated is the policy, and what it cannot express is refused."""

from fnmatch import fnmatchcase

import pytest
import yaml
from esslingen import GO2, fleet_of, over_zenoh, rule
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.deploy.dds_router import render_dds_router
from sfglab.deploy.errors import DeployError
from sfglab.fleet.policy import TABLE_1, Direction

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


@settings(max_examples=50)
@given(patterns, topics)
def test_the_allowlist_names_exactly_what_the_policy_lets_cross(chosen, name):
    fleet = fleet_of(*map(rule, chosen))
    config = yaml.safe_load(render_dds_router(fleet, "go2"))
    # As AllowedTopicList.cpp of DDS-Pipe: fnmatch(3) without FNM_PATHNAME, so that * crosses slashes.
    allowed = any(fnmatchcase(name, item["name"]) for item in config["allowlist"])
    assert allowed is any(fleet.policy.crosses(name, way) for way in Direction)
    assert "blocklist" not in config


def test_an_empty_policy_is_refused_because_an_empty_allowlist_opens_the_router():
    with pytest.raises(DeployError, match="forwards all topics"):
        render_dds_router(fleet_of(), "go2")


def test_a_fleet_over_zenoh_is_refused():
    with pytest.raises(DeployError, match="it connects agents over DDS only"):
        render_dds_router(over_zenoh(GO2).fleet, "go2")


def test_rules_of_one_direction_become_routes_and_mixed_ones_are_refused():
    ways = {Direction.OUTWARD: ("local", "global"), Direction.INWARD: ("global", "local")}
    for way, (source, target) in ways.items():
        config = yaml.safe_load(render_dds_router(fleet_of(rule("rt/a", way)), "go2"))
        assert config["routes"] == [{"src": source, "dst": [target]}, {"src": target}]
    with pytest.raises(DeployError, match="rt/b outward"):
        render_dds_router(fleet_of(rule("rt/a"), rule("rt/b", Direction.OUTWARD)), "go2")

"""ROS names on DDS and back, and what a DDS router makes of service names."""

import re
from functools import partial

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from sfglab import names
from sfglab.names import FqnError, ResourceKind, dds_names, dds_service, dds_topic, router_hazards
from sfglab.names.grammar import WireName

# Tokens that like to collide with the router's words stand among the ordinary ones.
COLLIDING = "torq carr rq rr getRequest Reply ReqRequest Req Rep uest a"
TOKENS = st.one_of(
    st.sampled_from(COLLIDING.split()),
    st.from_regex(
        r"[a-z][a-z0-9]{0,5}(_[a-z0-9]{1,4})?(rq|rr|R|Re|Request|Reply)?", fullmatch=True
    ),
)
NAMES = st.lists(TOKENS, min_size=1, max_size=5).map(lambda tokens: "/" + "/".join(tokens))


def router_pairs(request: str, reply: str) -> bool:
    """As RpcTopic.cpp of DDS-Pipe does it, by global replacements."""
    service = re.sub("rq/|Request", "", request)
    return (
        re.sub("Request", "Reply", re.sub("rq/", "rr/", request)) == reply
        and re.sub("Reply", "Request", re.sub("rr/", "rq/", reply)) == request
        and service == re.sub("rr/|Reply", "", reply)
    )


def test_topics_services_and_actions_have_the_names_that_rmw_gives_them():
    assert dds_topic("/chatter") == "rt/chatter"
    assert dds_topic("/tf") == "rt/tf"
    assert dds_service("/add") == ("rq/addRequest", "rr/addReply")
    assert dds_service("/global/go2/get_metadata") == (
        "rq/global/go2/get_metadataRequest",
        "rr/global/go2/get_metadataReply",
    )
    below = "/fibonacci/_action"
    assert dds_names("/fibonacci", ResourceKind.ACTION) == (
        *(
            f"{half}{below}/{part}{word}"
            for part in ("send_goal", "cancel_goal", "get_result")
            for half, word in (("rq", "Request"), ("rr", "Reply"))
        ),
        f"rt{below}/feedback",
        f"rt{below}/status",
    )


@pytest.mark.parametrize(
    "make", [dds_topic, dds_service, partial(dds_names, kind=ResourceKind.ACTION)]
)
@pytest.mark.parametrize("name", ["chatter", "/a/", "", "/a__b"])
def test_only_valid_names_are_mapped(make, name):
    with pytest.raises(FqnError):
        make(name)


@given(NAMES)
def test_every_name_comes_back_from_dds_with_its_role(name):
    request, reply = dds_service(name)
    assert names.ros_name_from_dds(dds_topic(name)) == WireName(role=names.DdsRole.TOPIC, name=name)
    assert names.ros_name_from_dds(request) == WireName(role=names.DdsRole.REQUEST, name=name)
    assert names.ros_name_from_dds(reply) == WireName(role=names.DdsRole.REPLY, name=name)


def test_dds_topics_that_are_not_ros_have_no_ros_name_and_others_are_read_as_leniently_as_rmw():
    foreign = (
        "ros_discovery_info DCPSParticipant rt rt/ rtx/a rq/add rr/addRequest rq/Request rt//a"
    )
    assert [name for name in foreign.split() if names.ros_name_from_dds(name)] == []
    assert names.ros_name_from_dds("rt/a__b") == WireName(role=names.DdsRole.TOPIC, name="/a__b")


@given(st.text(max_size=40))
def test_reading_any_dds_name_never_raises(dds_name):
    found = names.ros_name_from_dds(dds_name)
    assert found is None or dds_name.startswith(found.role.value + found.name)


@example("/global/go2/get_metadata")
@example("/global/torq/get_metadata")
@example("/global/carr/get_metadata")
@example("/global/go2/torq")
@example("/global/go2/setReply")
@given(NAMES)
def test_a_service_has_no_hazard_exactly_if_the_router_pairs_its_halves(name):
    assert (not router_hazards(name)) == router_pairs(*dds_service(name))


@given(NAMES)
def test_an_action_has_no_hazard_exactly_if_the_router_pairs_all_its_services(name):
    *services, _feedback, _status = dds_names(name, ResourceKind.ACTION)
    pairs = zip(services[::2], services[1::2], strict=True)
    assert (not router_hazards(name, ResourceKind.ACTION)) == all(
        router_pairs(*pair) for pair in pairs
    )


def test_hazards_name_the_segments_that_break():
    assert router_hazards("/global/torq/carr/setRequest/x") == ("torq", "carr", "setRequest")
    assert router_hazards("/global/go2/torq") == ()
    assert router_hazards("/global/go2/torq", ResourceKind.ACTION) == ("torq",)
    assert router_hazards("/global/torq/Request", ResourceKind.TOPIC) == ()

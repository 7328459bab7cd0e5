"""Keys, tokens, QoS texts, attachments, GIDs and hashes on Zenoh, held against libraries that others wrote."""

import importlib
import warnings
from dataclasses import replace
from unittest.mock import Mock

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.bus.api import EndpointKind, user_data
from sfglab.bus.zenoh import layout
from sfglab.messages import service_hash, type_hash
from sfglab.qos import (
    DEFAULT,
    LATCHED,
    SENSOR_DATA,
    SERVICES,
    Durability,
    History,
    Liveliness,
    QoSProfile,
    Reliability,
)

pytestmark = pytest.mark.zenoh

STRING = "std_msgs/msg/String"
SET_BOOL = "std_srvs/srv/SetBool"
TIMES = st.one_of(st.none(), st.integers(1, 9 * 10**18))
PROFILES = st.builds(
    QoSProfile,
    reliability=st.sampled_from(Reliability),
    durability=st.sampled_from(Durability),
    depth=st.integers(1, 10**6),
    deadline_ns=TIMES,
    lifespan_ns=TIMES,
    liveliness=st.sampled_from(Liveliness),
    lease_ns=TIMES,
)
SESSION = "80ab0000000000000000000000000001"


def library(name):
    """Return a module of a library of the tests; their own warnings are not ours."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            return importlib.import_module(name)
        except ImportError as error:
            pytest.skip(f"needs {name}: {error}")


def token(kind, name, type_, qos):
    """The token of the seventh entity of a node."""
    head = layout.token_text(3, SESSION, 7, kind, "/robot/camera")
    return "/".join((head, layout.mangled(name), *layout.wire_type(type_), layout.qos_text(qos)))


@given(PROFILES)
def test_a_qos_text_gives_its_profile_back(qos):
    assert layout.parse_qos(layout.qos_text(qos)) == qos
    keeps_all = layout.parse_qos(layout.qos_text(replace(qos, history=History.KEEP_ALL)))
    assert replace(keeps_all, depth=qos.depth) == replace(qos, history=History.KEEP_ALL)


@pytest.mark.parametrize(
    ("qos", "text"),
    [
        (DEFAULT, "::,10:,:,:,,"),
        (QoSProfile(depth=42), "::,:,:,:,,"),
        (replace(LATCHED, reliability=Reliability.BEST_EFFORT, depth=5), "2:1:,5:,:,:,,"),
        (QoSProfile(deadline_ns=1_500_000_000), "::,10:1,500000000:,:,,"),
        (QoSProfile(liveliness=Liveliness.MANUAL_BY_TOPIC, lease_ns=5), "::,10:,:,:3,0,5"),
    ],
)
def test_a_qos_text_is_that_of_rmw_zenoh_s_sources_and_of_pyzeros(qos, text):
    other = library("pyzeros.qos").QosProfile
    times = {
        f"{name}": divmod(value, 10**9)
        for name, value in (
            ("deadline", qos.deadline_ns),
            ("liveliness_lease_duration", qos.lease_ns),
        )
        if value is not None
    }
    theirs = other(
        depth=qos.depth,
        reliability=qos.reliability.value,
        durability=qos.durability.value,
        liveliness=qos.liveliness.value,
        **times,
    )
    assert layout.qos_text(qos) == text == theirs.encode()


@pytest.mark.parametrize(
    "text",
    ["", "::,10:,:,:,", "::,x:,:,:,,", "::,-1:,:,:,,", "::10:,:,:,,", ":" * 5, "::,10:,:,:,,:"],
)
def test_what_is_no_qos_text_is_refused(text):
    with pytest.raises(ValueError, match=r"unpack|int\(\)|QoS depth"):
        layout.parse_qos(text)


def test_keys_are_those_of_three_libraries():
    type_ = layout.wire_type(STRING)
    ours = layout.data_key(3, "/robot/chatter", type_)
    assert ours == library("pyzeros.pub").publisher_keyexpr("/robot/chatter", *type_, domain_id=3)
    assert ours == library("zenoh_ros2_sdk.keyexpr").topic_keyexpr(3, "/robot/chatter", *type_)
    assert ours == library("pamoja.ros2").entity_key(3, "/robot/chatter", STRING, type_[1])


def test_tokens_and_gids_are_those_of_two_libraries():
    ids = {"domain_id": 3, "_zenoh_id": SESSION, "_node_id": 0, "_entity_id": 7}
    pyzeros, sdk = library("pyzeros.pub"), library("zenoh_ros2_sdk.keyexpr")
    entity = library("zenoh_ros2_sdk.entity")
    node = entity.NodeEntity(3, SESSION, 0, "camera", "/robot")
    services, subs = library("pyzeros.service_common"), library("pyzeros.sub")
    more = ids | {"session": Mock(), "node_name": "camera", "namespace": "/robot"}
    for kind, theirs in (
        ("MP", pyzeros.token_keyexpr),
        ("MS", subs.token_keyexpr),
        ("SS", lambda *args, **options: services.token_keyexpr("SS", *args, **options)),
        ("SC", lambda *args, **options: services.token_keyexpr("SC", *args, **options)),
    ):
        is_call = kind.startswith("SS") or kind == "SC"
        ros_type = f"{SET_BOOL}_Request" if is_call else STRING
        ours = token(kind, "/robot/x", ros_type, SERVICES)
        assert ours == theirs("/robot/x", *layout.wire_type(ros_type), **more)
        end = entity.EndpointEntity(
            node,
            7,
            entity.EntityKind(kind),
            "/robot/x",
            *layout.wire_type(ros_type),
            layout.qos_text(SERVICES),
        )
        assert ours == sdk.endpoint_liveliness_keyexpr(end)
        assert layout.gid_of(ours) == library("pyzeros.utils").rmw_zenoh_gid(ours)
    node_token = layout.token_text(3, SESSION, 0, "NN", "/robot/camera")
    assert node_token == sdk.node_liveliness_keyexpr(node)


def test_attachments_are_those_of_two_libraries():
    gid = bytes(range(16))
    ours = layout.ATTACHMENT.pack(1, 2**60, 16, gid)
    assert len(ours) == 33
    assert ours == library("zenoh_ros2_sdk.attachment").Attachment(1, 2**60, gid).to_bytes()
    import numpy as np

    attachment = library("pyzeros.builtin_msgs").Attachment(
        sequence_number=1, source_timestamp=2**60, source_gid=np.frombuffer(gid, np.uint8)
    )
    assert ours == bytes(attachment.serialize()[4:])


def test_hashes_are_those_of_ros2_pyterfaces():
    messages = library("ros2_pyterfaces.cydr.all_msgs")
    calls = library("ros2_pyterfaces.cydr.all_srvs")
    assert type_hash(STRING) == messages.String.hash_rihs01()
    assert type_hash("sensor_msgs/msg/Image") == messages.Image.hash_rihs01()
    assert service_hash(SET_BOOL) == calls.SetBool.hash_rihs01()
    assert service_hash("std_srvs/srv/Trigger") == calls.Trigger.hash_rihs01()
    assert layout.wire_type(f"{SET_BOOL}_Response") == (
        "std_srvs::srv::dds_::SetBool_",
        service_hash(SET_BOOL),
    )
    assert layout.wire_type("my_msgs/msg/Arm") == ("my_msgs::msg::dds_::Arm_", layout.NO_HASH)


def test_a_token_shows_an_endpoint_with_what_ros_says_of_it():
    (info,) = layout.endpoint_infos(token("MP", "/robot/x", STRING, SENSOR_DATA))
    assert (info.kind, info.topic, info.dds_topic) == (
        EndpointKind.PUBLISHER,
        "/robot/x",
        "rt/robot/x",
    )
    assert (info.type, info.node, info.qos) == (STRING, "/robot/camera", SENSOR_DATA)
    assert info.participant.hex() == SESSION
    assert (info.user_data, info.transport) == (b"", "dds")
    request, reply = layout.endpoint_infos(token("SS", "/x", f"{SET_BOOL}_Request", SERVICES))
    assert (request.dds_topic, request.type) == ("rq/xRequest", f"{SET_BOOL}_Request")
    assert (reply.dds_topic, reply.type) == ("rr/xReply", f"{SET_BOOL}_Response")
    assert (request.kind, reply.kind) == (EndpointKind.SUBSCRIPTION, EndpointKind.PUBLISHER)
    assert request.gid[:12] == reply.gid[:12]
    assert request.gid != reply.gid
    assert layout.endpoint_infos(layout.token_text(3, SESSION, 0, "NN", "/robot/camera")) == ()


@given(st.dictionaries(st.from_regex(r"[a-z.]+", fullmatch=True), st.text(max_size=9), min_size=1))
def test_our_enclaves_carry_user_data_and_others_none(values):
    head = layout.token_text(3, SESSION, 7, "MP", "/robot/camera", data=user_data(values))
    assert not set(head.split("/")[6]) & set("/*$?#")
    rest = token("MP", "/x", STRING, DEFAULT).split("/")[9:]
    (info,) = layout.endpoint_infos("/".join((head, *rest)))
    assert info.user_data == user_data(values)
    others = token("MP", "/x", STRING, DEFAULT).replace("/MP/%/", "/MP/%my%enclave/")
    assert layout.endpoint_infos(others)[0].user_data == b""


def test_another_definition_of_a_type_shows_in_its_name():
    text = token("MP", "/x", STRING, DEFAULT).replace(type_hash(STRING), "RIHS01_1")
    (info,) = layout.endpoint_infos(text)
    assert info.type == f"{STRING} (RIHS01_1)"


@pytest.mark.parametrize("text", ["", "a/b", "@ros2_lv/0/zz/0/1/MP/%/%/n/%x/T/h/::,10:,:,:,,"])
def test_what_is_no_token_is_refused(text):
    with pytest.raises(ValueError, match=r"unpack|hexadecimal|token"):
        layout.endpoint_infos(text)

"""Nodes stand on the ROS 2 graph with exactly their endpoints, and leave it when they close."""

import json
import subprocess
import sys

import numpy as np
import pytest
from bus_messages import SERVICE, STRING
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore
from waiting import program

from sfglab import bus
from sfglab.bus.api import NodeInfo
from sfglab.bus.dds.discovery import Discovery, gid_bytes, pack_nodes, unpack_nodes

world = pytest.fixture(lambda live: live)
INFO = "rmw_dds_common/msg/ParticipantEntitiesInfo"
STORES = {24: get_typestore(Stores.ROS2_HUMBLE), 16: get_typestore(Stores.ROS2_JAZZY)}

guids = st.binary(min_size=16, max_size=16)
tokens = st.from_regex(r"[a-z][a-z0-9_]{0,20}", fullmatch=True)
gid_lists = st.lists(guids, max_size=3)


@pytest.mark.parametrize("size", STORES)
@given(guids, st.lists(st.tuples(tokens, tokens, gid_lists, gid_lists), max_size=2))
@settings(max_examples=25, deadline=None)
def test_the_bytes_are_those_of_the_distributions_own_definition(size, participant, listed):
    store = STORES[size]
    types = store.types

    def gid(guid):
        data = np.frombuffer(guid.ljust(size, b"\0"), np.uint8)
        return types["rmw_dds_common/msg/Gid"](data=data)

    nodes, theirs = [], []
    for namespace, name, readers, writers in listed:
        lists = {"readers": tuple(readers), "writers": tuple(writers)}
        nodes.append(
            NodeInfo(namespace=f"/{namespace}", name=name, participant=participant, **lists)
        )
        theirs.append(
            types["rmw_dds_common/msg/NodeEntitiesInfo"](
                node_namespace=f"/{namespace}",
                node_name=name,
                reader_gid_seq=[gid(guid) for guid in readers],
                writer_gid_seq=[gid(guid) for guid in writers],
            )
        )
    message = types[INFO](gid=gid(participant), node_entities_info_seq=theirs)
    cdr = pack_nodes(participant, nodes, size)
    assert cdr == bytes(store.serialize_cdr(message, INFO))
    assert unpack_nodes(cdr, size) == (participant, tuple(nodes))


@pytest.mark.parametrize(
    ("distro", "size"),
    [("", 24), ("humble", 24), ("unheard", 24), ("iron", 16), ("jazzy", 16), ("rolling", 16)],
)
def test_the_environments_distribution_chooses_the_layout(monkeypatch, distro, size):
    monkeypatch.setenv("ROS_DISTRO", distro)
    assert gid_bytes() == gid_bytes(distro) == size
    monkeypatch.delenv("ROS_DISTRO")
    assert gid_bytes() == 24


def gids_of(node):
    """Identities of a node's subscriptions and of its publishers in DDS."""
    gids = [set(), set()]
    for end in node.graph.endpoints():
        if end.participant == node.guid and end.transport == "dds":
            gids[end.kind is bus.EndpointKind.PUBLISHER].add(end.gid)
    return gids


@pytest.mark.live
@pytest.mark.parametrize("distro", ["humble", "jazzy"])
async def test_the_graph_names_nodes_with_exactly_their_endpoints_while_they_live(
    monkeypatch, node, distro
):
    monkeypatch.setenv("ROS_DISTRO", distro)
    async with node("here") as here:
        graph = here.graph
        assert await graph.wait_for(lambda: [n.name for n in graph.nodes()] == ["here"])
        async with node("there", namespace="/far") as there:

            def is_listed(counts):
                (known, *_), gids = graph.nodes(), gids_of(there)
                return (
                    (known.full_name, known.participant) == ("/far/there", there.guid)
                    and [set(known.readers), set(known.writers)] == gids
                    and [len(kind) for kind in gids] == counts
                )

            assert await graph.wait_for(lambda: is_listed([0, 0]))
            publisher = there.create_publisher(STRING, "chatter")
            there.create_publisher(STRING, "fast", transport="shm")
            there.create_subscription(STRING, "chatter")
            there.create_service(SERVICE, "ask", lambda _: None)
            client = there.create_client(SERVICE, "ask")
            assert await graph.wait_for(lambda: is_listed([3, 3]))
            publisher.close()
            client.close()
            assert await graph.wait_for(lambda: is_listed([2, 1]))
            assert "ros_discovery_info" not in str(graph.topics())
        assert await graph.wait_for(lambda: [n.name for n in graph.nodes()] == ["here"])


@pytest.mark.live
async def test_twenty_endpoints_at_once_are_few_messages(here, node, until):
    messages = []
    async with node("watcher") as watcher:

        def note(participant, nodes):
            if participant == here.guid:
                messages.append(set(nodes[0].writers))

        Discovery(watcher.backend.participant, lambda _: None).read_nodes(note)
        gids = {here.create_publisher(STRING, f"/t{i}").gid for i in range(20)}
        await until(lambda: gids in messages)
    assert len(messages) < 10


@pytest.mark.live
def test_hz_waits_for_a_topic_that_nobody_publishes_yet(domain_id):
    at = ("--domain", str(domain_id), "--interface", "lo")
    topic = (sys.executable, "-m", "sfglab", "topic")
    with program(*topic, "hz", "/late", "--json", *at, stderr=subprocess.PIPE) as hz:
        warning = hz.stderr.readline()
        assert warning == "WARNING: topic [/late] does not appear to be published yet\n"
        with program(*topic, "pub", "-r", "20", "/late", "std_msgs/String", "{data: a}", *at):
            assert json.loads(hz.stdout.readline())["rate_hz"] > 0

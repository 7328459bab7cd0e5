"""Nodes stand on the ROS 2 graph with exactly their endpoints, and leave it when they close."""

from contextlib import closing

import numpy as np
import pytest
from bus_messages import SERVICE, STRING, connected
from hypothesis import given
from hypothesis import strategies as st
from rosbags.typesys import Stores, get_typestore

from sfglab import bus
from sfglab.bus.api import NodeInfo
from sfglab.bus.dds.clib import entity_guid
from sfglab.bus.dds.discovery import Discovery, gid_bytes, info_type, pack_nodes, unpack_nodes
from sfglab.bus.dds.domain import DdsParticipant, DomainConfig
from sfglab.bus.dds.endpoints import DdsWriter
from sfglab.messages.dds import idl_struct
from sfglab.qos import LATCHED, QoSProfile

world = pytest.fixture(lambda live: live)
INFO = "rmw_dds_common/msg/ParticipantEntitiesInfo"
STORES = {24: get_typestore(Stores.ROS2_HUMBLE), 16: get_typestore(Stores.ROS2_JAZZY)}

# Reads with the library's own types and deserializer, and reports every list of a participant that has nodes.
READER = """
    from cyclonedds.core import ReadCondition, WaitSet
    from cyclonedds.domain import Domain, DomainParticipant
    from cyclonedds.qos import Policy, Qos
    from cyclonedds.sub import DataReader
    from cyclonedds.topic import Topic
    from cyclonedds.util import duration
    from sfglab.bus.dds.domain import DomainConfig, domain_xml
    from sfglab.bus.dds.discovery import info_type

    domain = Domain({domain_id}, domain_xml(DomainConfig(domain_id={domain_id}, interface="lo")))
    participant = DomainParticipant({domain_id})
    reliable = Policy.Reliability.Reliable(duration(seconds=1))
    qos = Qos(reliable, Policy.Durability.TransientLocal, Policy.History.KeepAll)
    reader = DataReader(participant, Topic(participant, "ros_discovery_info", info_type({size})), qos=qos)
    waitset = WaitSet(participant)
    condition = ReadCondition(reader, 127)
    waitset.attach(condition)
    say(ready=True)
    while True:
        await asyncio.to_thread(waitset.wait, duration(seconds=10))
        for info in reader.take(64):
            if not info.sample_info.valid_data:
                say(gone=True)
                continue
            nodes = [
                [n.node_namespace, n.node_name]
                + [sorted(bytes(g.data).hex() for g in s) for s in (n.reader_gid_seq, n.writer_gid_seq)]
                for n in info.node_entities_info_seq
            ]
            say(gid=bytes(info.gid.data).hex(), nodes=nodes)
"""


def own_gids(here, kind, size=24):
    """Gids of a node's DDS endpoints as the wire has them, in hexadecimal."""
    own = [e for e in here.graph.endpoints() if e.participant == here.guid and e.transport == "dds"]
    return sorted(e.gid.ljust(size, b"\0").hex() for e in own if e.kind.value == kind)


guids = st.binary(min_size=16, max_size=16)
tokens = st.from_regex(r"[a-z][a-z0-9_]{0,20}", fullmatch=True)
nodes_of_participants = st.lists(
    st.tuples(tokens, tokens, st.lists(guids, max_size=4), st.lists(guids, max_size=4)), max_size=3
)


@pytest.mark.parametrize("size", STORES)
@given(participant=guids, listed=nodes_of_participants)
def test_the_bytes_are_those_of_the_distributions_own_definition(size, participant, listed):
    store = STORES[size]
    types = store.types

    def gid(guid):
        return types["rmw_dds_common/msg/Gid"](
            data=np.frombuffer(guid.ljust(size, b"\0"), np.uint8)
        )

    def message(entry):
        namespace, name, readers, writers = entry
        return types["rmw_dds_common/msg/NodeEntitiesInfo"](
            node_namespace=f"/{namespace}",
            node_name=name,
            reader_gid_seq=[gid(g) for g in readers],
            writer_gid_seq=[gid(g) for g in writers],
        )

    theirs = types[INFO](
        gid=gid(participant), node_entities_info_seq=[message(entry) for entry in listed]
    )
    nodes = tuple(
        NodeInfo(
            namespace=f"/{ns}",
            name=name,
            participant=participant,
            readers=tuple(r),
            writers=tuple(w),
        )
        for ns, name, r, w in listed
    )
    cdr = pack_nodes(participant, nodes, size)
    assert cdr == bytes(store.serialize_cdr(theirs, INFO))
    assert unpack_nodes(cdr, size) == (participant, nodes)


@pytest.mark.parametrize(
    ("distro", "size"),
    [("", 24), ("humble", 24), ("unheard", 24), ("iron", 16), ("jazzy", 16), ("rolling", 16)],
)
def test_the_environments_distribution_chooses_the_layout(monkeypatch, distro, size):
    monkeypatch.setenv("ROS_DISTRO", distro)
    assert gid_bytes() == gid_bytes(distro) == size
    monkeypatch.delenv("ROS_DISTRO")
    assert gid_bytes() == 24


@pytest.mark.live
@pytest.mark.parametrize(("distro", "size"), [("humble", 24), ("jazzy", 16)])
async def test_another_process_sees_the_node_with_exactly_its_endpoints(
    monkeypatch, node, domain_id, child, distro, size
):
    monkeypatch.setenv("ROS_DISTRO", distro)

    async with child(READER.format(domain_id=domain_id, size=size)) as reader:
        assert await reader.hear() == {"ready": True}
        async with node("here", namespace="/robot") as here:
            gid = here.guid.ljust(size, b"\0").hex()

            async def reaches(subscriptions, publishers):
                while True:
                    said = await reader.hear()
                    assert said["gid"] == gid
                    ((*name, readers, writers),) = said["nodes"]
                    assert name == ["/robot", "here"]
                    if (len(readers), len(writers)) == (subscriptions, publishers):
                        break
                assert readers == own_gids(here, "subscription", size)
                assert writers == own_gids(here, "publisher", size)

            await reaches(0, 0)
            talk = here.create_publisher(STRING, "chatter")
            here.create_publisher(STRING, "fast", transport="shm")
            here.create_subscription(STRING, "chatter")
            here.create_service(SERVICE, "ask", lambda _: None)
            client = here.create_client(SERVICE, "ask")
            await reaches(3, 3)
            talk.close()
            await reaches(3, 2)
            client.close()
            await reaches(2, 1)
        assert await reader.hear() == {"gone": True}


@pytest.mark.live
async def test_the_graph_names_nodes_while_they_live_and_hides_how_it_knows(here, node):
    async with node("quiet", discovery_info=False) as quiet:
        nodes = here.graph.nodes
        assert nodes() == ()
        quiet.create_publisher(STRING, "/t")
        async with node("there", namespace="/far") as there:
            topic = there.create_publisher(STRING, "/t")
            assert await here.graph.wait_for(
                lambda: [n.writers for n in nodes()][:1] == [(topic.gid,)]
            )
            named = [(n.full_name, n.participant) for n in nodes()]
            assert named == [("/far/there", there.guid), ("/here", here.guid)]
            await here.graph.wait_for(lambda: len(here.graph.publishers("/t")) == 2)
            assert set(here.graph.topics()) == {"/t"}
        assert await here.graph.wait_for(lambda: [n.name for n in nodes()] == ["here"])


@pytest.mark.live
async def test_an_endpoint_of_a_foreign_node_gets_its_name_when_nodes_are_asked_for(
    node, domain_id
):
    config = DomainConfig(domain_id=domain_id, interface="lo")
    ros = DdsParticipant(config, b"enclave=/;", name="ros", after_round=lambda: None)
    with closing(ros):
        talker = entity_guid(ros.create_writer("rt/chatter", idl_struct(STRING), QoSProfile()))
        handle = ros.create_writer("ros_discovery_info", info_type(24), LATCHED)
        info = DdsWriter(handle, "info", type_="info", waitset=ros.waitset, on_matched=lambda: None)
        listed = NodeInfo(namespace="/demo", name="talker", participant=ros.guid, writers=(talker,))
        info.write(pack_nodes(ros.guid, [listed], 24))
        async with node("here") as here:
            graph = here.graph
            assert await graph.wait_for(lambda: graph.publishers("/chatter") != ())
            assert graph.publishers("/chatter")[0].node == ""
            graph.nodes()
            assert await graph.wait_for(
                lambda: graph.publishers("/chatter")[0].node == "/demo/talker"
            )
            assert listed in graph.nodes()


@pytest.mark.live
async def test_twenty_endpoints_at_once_are_few_messages(here, domain_id, until):
    config = DomainConfig(domain_id=domain_id, interface="lo")
    messages = []
    watcher = DdsParticipant(config, b"", name="watcher", after_round=lambda: None)
    with closing(watcher):
        Discovery(watcher, lambda _: None).read_nodes(lambda _, nodes: messages.append(nodes[0]))
        gids = {here.create_publisher(STRING, f"/t{i}").gid for i in range(20)}
        await until(lambda: messages and set(messages[-1].writers) == gids)
        assert len(messages) < 10


@pytest.mark.live
async def test_nodes_of_two_domain_ids_meet_in_one_external_domain(domain_id):
    ids = [d for d in range(60, 63) if d != domain_id]
    options = {"interface": "lo", "external_domain_id": domain_id}
    async with (
        bus.Node("a", domain_id=ids[0], **options) as a,
        bus.Node("b", domain_id=ids[1], **options) as b,
    ):
        await connected(a, b)
        assert a.guid[:12] != b.guid[:12]

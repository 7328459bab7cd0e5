"""The ROS 2 nodes of one agent: ``python -m sfglab.lab.workers.ros_nodes CONFIG``.

Each node replaces a process of demo_nodes_cpp, because one Python process per node would measure Python. A node
is made with raw C calls: a Cyclone stack, a participant, and the endpoints of a node of demo_nodes_cpp under Humble
with rmw_cyclonedds:

- the six parameter services of rclcpp (rclcpp, parameter_service.cpp);
- /parameter_events, published and subscribed (rclcpp, node_parameters.cpp and time_source.cpp);
- /rosout (rcl, logging_rosout.h);
- its own topic (demo_nodes_cpp, talker.cpp and listener.cpp);
- `ros_discovery_info`, once per process (rmw_cyclonedds_cpp, rmw_node.cpp).

Types are opaque: endpoints of ROS 2 announce a type's name without a description.

The process reports ``ready`` after everything is loaded. The order ``start`` creates the nodes. The first
node then polls its graph, as an operator would. It reports ``resolved`` when it has discovered every
endpoint and the announcement of every node of the other agents. The process ends with its standard input,
at once.
"""

from __future__ import annotations

import asyncio
import ctypes as ct
import os
import time
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.bus.api import NodeInfo, user_data
from sfglab.bus.dds import clib
from sfglab.bus.dds.clib import endpoint_qos, entity_guid, library, qos_object
from sfglab.bus.dds.discovery import INFO_TOPIC, READER_QOS, gid_bytes, pack_nodes, take_builtin
from sfglab.bus.dds.domain import DomainConfig, checked, domain_xml
from sfglab.bus.dds.endpoints import serdata_from_bytes, sertype_of, stamp
from sfglab.component import Orders, Reporter, run_component
from sfglab.names import dds_service, dds_topic
from sfglab.qos import LATCHED, PARAMETER_EVENTS, Durability, History, QoSProfile
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

_POLL_S = 0.02
_BATCH = 256
# The stacks of a process need different domain ids, although all of them join one domain on the network.
_FIRST_STACK_ID = 110
_ROS_TOPICS = (b"rt/", b"rq/", b"rr/", b"ros_discovery_info")
TALKER = "talker"
LISTENER = "listener"
_ROSOUT = QoSProfile(depth=1000, durability=Durability.TRANSIENT_LOCAL, lifespan_ns=10 * NS_PER_S)
_SERVICE = QoSProfile(history=History.KEEP_ALL)
_CHATTER = {TALKER: QoSProfile(depth=7), LISTENER: QoSProfile(depth=10)}
_PARAMETER_SERVICES = {
    "describe_parameters": "DescribeParameters",
    "get_parameter_types": "GetParameterTypes",
    "get_parameters": "GetParameters",
    "list_parameters": "ListParameters",
    "set_parameters": "SetParameters",
    "set_parameters_atomically": "SetParametersAtomically",
}
_INFO_TYPE = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"


@dataclass(frozen=True, slots=True, kw_only=True)
class RosNodesConfig:
    """Configuration of the process that runs an agent's ROS nodes."""

    namespace: str  #: Namespace of the nodes and of their topics.
    address: BusAddress  #: Address of the nodes on the bus.
    talkers: int = 10  #: Publishing nodes; the n-th talker and the n-th listener share a topic.
    listeners: int = 10  #: Subscribing nodes.
    peers: int = 0  #: Number of other agents in the domain, each with as many nodes.


@dataclass(frozen=True, slots=True, kw_only=True)
class EndpointPlan:
    """One endpoint of a node."""

    writer: bool  #: Whether the endpoint is a writer.
    topic: str  #: Topic name in DDS.
    type: str  #: Type name in DDS.
    qos: QoSProfile  #: Offered or requested QoS.
    user_data: bytes = b""  #: USER_DATA of the endpoint.


def endpoints_of(role: str, node: str, topic: str) -> tuple[EndpointPlan, ...]:
    """Return what rclcpp and rmw_cyclonedds create for a ``talker`` or ``listener``: 18 endpoints."""
    text = "std_msgs::msg::dds_::String_"
    chatter = EndpointPlan(
        writer=role == TALKER, topic=dds_topic(topic), type=text, qos=_CHATTER[role]
    )
    return (*_node_endpoints(), *_parameter_services(node), chatter)


def _node_endpoints() -> Iterator[EndpointPlan]:
    yield EndpointPlan(writer=True, topic=INFO_TOPIC, type=_INFO_TYPE, qos=LATCHED)
    yield EndpointPlan(writer=False, topic=INFO_TOPIC, type=_INFO_TYPE, qos=READER_QOS)
    log, event = (f"rcl_interfaces::msg::dds_::{name}_" for name in ("Log", "ParameterEvent"))
    events = dds_topic("/parameter_events")
    yield EndpointPlan(writer=True, topic=dds_topic("/rosout"), type=log, qos=_ROSOUT)
    yield EndpointPlan(writer=True, topic=events, type=event, qos=PARAMETER_EVENTS)
    yield EndpointPlan(writer=False, topic=events, type=event, qos=PARAMETER_EVENTS)


def _parameter_services(node: str) -> Iterator[EndpointPlan]:
    for number, (name, type_) in enumerate(_PARAMETER_SERVICES.items()):
        request, reply = dds_service(f"{node}/{name}")
        kind = f"rcl_interfaces::srv::dds_::{type_}_"
        # They have the length of rmw_cyclonedds' random ids, but identify no pair here.
        identity = user_data({"serviceid": ".".join(["00"] * 15 + [f"{number:02x}"])})
        for writer, topic, half in ((False, request, "Request_"), (True, reply, "Response_")):
            yield EndpointPlan(
                writer=writer, topic=topic, type=kind + half, qos=_SERVICE, user_data=identity
            )


class RosStack:
    """One node with its own Cyclone stack, which other participants discover as a process.

    The configuration's `domain_id` is that of this stack only, and `external_domain_id` that of all stacks.

    Raises:
        BusError: Cyclone DDS cannot create an entity.
    """

    def __init__(
        self, config: DomainConfig, namespace: str, name: str, plans: Sequence[EndpointPlan]
    ) -> None:
        lib = library()
        checked(lib.dds_create_domain(config.domain_id, domain_xml(config).encode()), "a domain")
        with qos_object(user_data({"enclave": "/"})) as qos:
            made = lib.dds_create_participant(config.domain_id, qos, None)
        self.participant = checked(made, "a participant")  #: C handle of the node's participant.
        #: 12-byte GUID prefix of the participant and its endpoints.
        self.prefix = entity_guid(self.participant)[:12]
        gids: dict[bool, list[bytes]] = {True: [], False: []}
        for plan in plans:
            handle = self._create(plan)
            if plan.topic != INFO_TOPIC:
                gids[plan.writer].append(entity_guid(handle))
            elif plan.writer:
                info_writer = handle
            else:
                self.info_reader = handle  #: C handle of the node's reader of `ros_discovery_info`.
        node = NodeInfo(
            namespace=namespace,
            name=name,
            participant=entity_guid(self.participant),
            readers=tuple(gids[False]),
            writers=tuple(gids[True]),
        )
        _announce(info_writer, node)

    def _create(self, plan: EndpointPlan) -> int:
        lib = library()
        topic = _create_topic(self.participant, plan.topic, plan.type)
        create = lib.dds_create_writer if plan.writer else lib.dds_create_reader
        with endpoint_qos(plan.qos, user_data=plan.user_data) as qos:
            return checked(
                create(self.participant, topic, qos, None), f"an endpoint of {plan.topic!r}"
            )


def _announce(writer: int, node: NodeInfo) -> None:
    """Publish the endpoints of a node once; rclcpp publishes them after each endpoint.

    Publishing after each endpoint did not change the received bytes (2 x 20 nodes: 3.5 MB beside 3.7 MB),
    because a late joiner receives the last sample only.
    """
    cdr = pack_nodes(node.participant, [node], gid_bytes())
    serdata = serdata_from_bytes(sertype_of(writer), cdr)
    assert serdata is not None, "an opaque type takes every message"
    stamp(serdata, time.time_ns())
    checked(library().dds_forwardcdr(writer, serdata), f"a message on {INFO_TOPIC!r}")


class _TypeMeta(ct.Structure):
    """`struct dds_type_meta_ser`."""

    _fields_ = (("data", ct.c_void_p), ("size", ct.c_uint32))


class _TopicDescriptor(ct.Structure):
    """`dds_topic_descriptor_t` (dds_public_impl.h)."""

    _fields_ = (
        ("size", ct.c_uint32),
        ("align", ct.c_uint32),
        ("flags", ct.c_uint32),
        ("key_count", ct.c_uint32),
        ("type_name", ct.c_char_p),
        ("keys", ct.c_void_p),
        ("operation_count", ct.c_uint32),
        ("operations", ct.c_void_p),
        ("xml", ct.c_char_p),
        ("type_information", _TypeMeta),
        ("type_mapping", _TypeMeta),
        ("data_representation", ct.c_uint32),
    )


# dds_opcodes.h: DDS_OP_ADR | DDS_OP_TYPE_1BY at offset 0, then DDS_OP_RTS: a structure of one octet.
_ONE_OCTET = (ct.c_uint32 * 3)(0x01010000, 0, 0)


@cache
def _create_topic_function() -> Any:
    function = library().dds_create_topic
    function.restype = ct.c_int32
    function.argtypes = (ct.c_int32, ct.c_void_p, ct.c_char_p, ct.c_void_p, ct.c_void_p)
    return function


def _create_topic(participant: int, name: str, type_: str) -> int:
    descriptor = _TopicDescriptor(
        size=1,
        align=1,
        type_name=type_.encode(),
        operation_count=2,
        operations=ct.addressof(_ONE_OCTET),
        xml=b"",
    )
    made = _create_topic_function()(participant, ct.byref(descriptor), name.encode(), None, None)
    return checked(made, f"topic {name!r}")


class _Graph:
    """The graph as one node knows it: endpoints of the other agents, and announcements of all nodes.

    `own` has the GUID prefixes of the nodes of its own agent.
    """

    def __init__(self, stack: RosStack, own: frozenset[bytes]) -> None:
        create = library().dds_create_reader
        kinds = (clib.BUILTIN_PUBLICATION, clib.BUILTIN_SUBSCRIPTION)
        self._readers = [create(stack.participant, kind, None, None) for kind in kinds]
        self._info_reader = stack.info_reader
        self._own = own
        self.endpoints: set[bytes] = set()  # GIDs of the other agents' endpoints
        self.announced: set[int] = set()  # processes whose nodes are announced, own ones included

    def poll(self) -> None:
        """Read all changes."""
        for reader in self._readers:
            for sample, is_alive in take_builtin(reader, clib.Endpoint):
                gid = bytes(sample.key)
                if not is_alive:
                    self.endpoints.discard(gid)
                elif gid[:12] not in self._own and sample.topic_name.startswith(_ROS_TOPICS):
                    self.endpoints.add(gid)
        serdata = (ct.c_void_p * _BATCH)()
        infos = (clib.SampleInfo * _BATCH)()
        lib = library()
        count = lib.dds_takecdr(self._info_reader, serdata, _BATCH, infos, clib.ANY_STATE)
        for i in range(count):
            if infos[i].valid_data:
                self.announced.add(infos[i].publication_handle)
            lib.ddsi_serdata_unref(serdata[i])


def _node_plans(config: RosNodesConfig) -> dict[str, tuple[EndpointPlan, ...]]:
    """Return the endpoints of each node by its name."""
    plans = {}
    for role, count in ((TALKER, config.talkers), (LISTENER, config.listeners)):
        for number in range(count):
            name = f"{role}_{number}"
            topic = f"{config.namespace}/chatter_{number}"
            plans[name] = endpoints_of(role, f"{config.namespace}/{name}", topic)
    return plans


async def serve(config: RosNodesConfig, report: Reporter, orders: Orders) -> None:
    """Create the nodes at the first order, report when the agent's peers are known, and wait for the end."""
    library()
    plans = _node_plans(config)
    announced = len(plans) * (1 + config.peers)
    expected = config.peers * sum(map(len, plans.values()))
    report({"is": "ready"})
    try:
        await orders.get()
        stacks = []
        for number, (name, endpoints) in enumerate(plans.items()):
            options = config.address.options()
            options["external_domain_id"] = options["domain_id"]
            options["domain_id"] = _FIRST_STACK_ID + number
            stacks.append(RosStack(DomainConfig(**options), config.namespace, name, endpoints))
        graph = _Graph(stacks[0], frozenset(stack.prefix for stack in stacks))
        graph.poll()
        while len(graph.endpoints) < expected or len(graph.announced) < announced:
            await asyncio.sleep(_POLL_S)
            graph.poll()
        found = {"endpoints": len(graph.endpoints), "announcements": len(graph.announced)}
        report({"is": "resolved", "t_ns": time.time_ns(), **found})
        await asyncio.Event().wait()
    except asyncio.CancelledError:
        # Leaving the domain in order would take as long as discovery, and all agents end at the same time.
        os._exit(0)


if __name__ == "__main__":
    run_component(RosNodesConfig, serve)

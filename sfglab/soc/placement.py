"""The module `placement` decides which nodes are hardware, with one mixed-integer problem that includes gateways.

Paper C leaves the placement of nodes to the developer and names an optimiser as future work (sections 5 and 7). The
variable x_n is 1 for a node in hardware, and y_t is 1 for a topic at a gateway. The variable h_t belongs to a topic in
hardware, and e_tn to an edge whose messages cross the memory interface:

    minimise    sum_n [ a_n (1 - x_n) + b_n x_n ] + sum_tn w_tn e_tn + sum_t g_t y_t
    subject to  e_tn >= x_n - h_t - y_t      for every edge of topic t at node n
                h_t <= x_n                   for every node n at topic t
                sum_n lut_n x_n + gateway_lut sum_t y_t <= lut,   sum_n bram_n x_n <= bram
                x_n, y_t in {0, 1},  0 <= h_t <= 1,  e_tn >= 0

The factors a_n and b_n are a node's seconds of work per second in software and in hardware. The factor w_tn is the
cost of one carriage of a topic's messages across the memory interface. A topic has one carriage per subscriber, and
one carriage for all publishers together. The factor g_t is the cost of one carriage through a gateway. If x is
whole, the best h and e are whole as well. Loads are sums of times, and leave out how carriages wait for each other;
the module `sfglab.soc.memory` models these waits.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.soc.graph import Graph, Implementation, Placement, Topic, TopicMapping
from sfglab.soc.mapping import (
    activation_s,
    carriages_per_message,
    map_communication,
    message_bytes,
)
from sfglab.soc.memory import STORED

if TYPE_CHECKING:
    from collections.abc import Mapping

# The times of one carriage across the memory interface are from the memory model: a delivery, a call to the delegate,
# a read of the message, and the core's work if the topic has a gateway. The times leave out cancels, and the time by
# which a write exceeds a read.
_CARRIAGE_S = STORED.delegate_s + STORED.deliver_s
_CHUNK_BYTES = STORED.chunk_bytes
_BYTE_S = STORED.read_s(_CHUNK_BYTES) / _CHUNK_BYTES + STORED.deliver_s_per_byte

#: Look-up tables of a gateway, approximately the number that `tests/soc/test_rtl_yosys.py` counts.
GATEWAY_LUT = 690


@dataclass(frozen=True, slots=True, kw_only=True)
class Platform:
    """A `Platform` is the area of a system-on-chip."""

    name: str  #: Name of the board.
    lut: int  #: Number of look-up tables for nodes and gateways.
    bram: float  #: Number of block memories of 36 kbit for nodes.


ZCU104 = Platform(name="ZCU104", lut=230_400, bram=312.0)
"""`ZCU104` is the board of paper C, section 4 (XCZU7EV, AMD DS891), without area set aside for ReconROS."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """A `Load` is the work of a mapped graph on a platform, in seconds of work per second of operation."""

    software_s: float  #: Work of the nodes in software, s.
    hardware_s: float  #: Work of the nodes in hardware, s.
    communication_s: float  #: Time of the carriages across the memory interface, s.
    lut: int  #: Number of look-up tables of nodes and gateways.
    bram: float  #: Number of block memories of nodes; a gateway takes none.

    @property
    def total_s(self) -> float:
        """Return the sum of all times, s; the placement of nodes minimises this sum."""
        return self.software_s + self.hardware_s + self.communication_s

    def check_fits(self, platform: Platform) -> None:
        """Check that the platform has the look-up tables and block memories that the load needs.

        Raises:
            SfglabError: The load needs more than the platform has.
        """
        if self.lut > platform.lut or self.bram > platform.bram:
            raise SfglabError(
                f"mapping: it needs {self.lut} LUT and {self.bram:g} BRAM, allowed: up to "
                f"{platform.lut} and {platform.bram:g} on {platform.name}"
            )


def assess(graph: Graph) -> Load:
    """Return the load of a mapped graph.

    Raises:
        InvalidValueError: The size or rate of a topic that crosses the memory interface is unknown.
    """
    work_s = dict.fromkeys(Placement, 0.0)
    lut = GATEWAY_LUT * len(graph.mapped_to(TopicMapping.GATEWAY))
    bram = 0.0
    for node in graph.nodes:
        work_s[node.placement] += node.rate_hz * activation_s(node)
        if node.in_hardware and node.hardware is not None:
            lut += node.hardware.lut
            bram += node.hardware.bram
    return Load(
        software_s=work_s[Placement.SOFTWARE],
        hardware_s=work_s[Placement.HARDWARE],
        communication_s=sum(topic_load(graph, topic) for topic in graph.topics),
        lut=lut,
        bram=bram,
    )


def topic_load(graph: Graph, topic: Topic) -> float:
    """Return the seconds per second for which a mapped topic occupies the memory interface.

    Raises:
        InvalidValueError: The topic's messages cross the memory interface, and their size or rate is unknown.
    """
    carriages = carriages_per_message(graph, topic)
    return carriages * carriage_load(topic, topic.mapping) if carriages else 0.0


def carriage_load(topic: Topic, mapping: TopicMapping) -> float:
    """Return the seconds per second that one carriage per message takes, with the topic in software or at a gateway.

    Raises:
        InvalidValueError: The topic's size or rate is unknown.
    """
    time_s = _CARRIAGE_S + _BYTE_S * message_bytes(topic)
    if mapping is TopicMapping.GATEWAY:
        time_s += STORED.endpoint_s
    if topic.rate_hz is None:
        key = ("topics", topic.name, "rate_hz")
        raise InvalidValueError(key, None, "the rate in Hz, to compute the cost")
    return topic.rate_hz * time_s


# The programme counts in milliseconds, because numbers near 1 suit the solver's tolerances.
_MS = 1e3
_GAP = 1e-7


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeMapping:
    """A `NodeMapping` is a graph with placed nodes and mapped topics, and the quality of the mapping."""

    graph: Graph  #: Graph with its mapping.
    load: Load  #: Load of the graph.
    gap: float  #: Largest share of the load that another mapping could save.

    @property
    def optimal(self) -> bool:
        """Return whether no mapping is better within the solver's tolerance."""
        return self.gap <= 10 * _GAP


def place_nodes(
    graph: Graph,
    platform: Platform,
    *,
    fixed: Mapping[str, Placement] | None = None,
    time_limit_s: float = 30.0,
) -> NodeMapping:
    """Place nodes and map topics with the solver HiGHS so that the load is least.

    Args:
        graph: Graph; the function ignores the graph's placements and mappings.
        platform: Platform with its area.
        fixed: Placements that the solver must keep. Nodes without an implementation stay in software.
        time_limit_s: Time after which the solver returns the best mapping found so far, s.

    Raises:
        InvalidValueError: A fixed node does not exist, or a topic's size or rate is unknown.
        SfglabError: The fixed nodes do not fit or have no implementation, or the solver found no mapping in time.
    """
    import cvxpy as cp

    fixed = fixed or {}
    check_fixed(graph, fixed)
    if not graph.nodes:
        return NodeMapping(graph=graph, load=assess(graph), gap=0.0)
    problem, hardware, gateways = _programme(graph, platform, fixed)
    with warnings.catch_warnings():
        # `NodeMapping.gap` shows that the solver reached the time limit.
        warnings.filterwarnings("ignore", message="Solution may be inaccurate")
        try:
            problem.solve(solver=cp.HIGHS, mip_rel_gap=_GAP, time_limit=time_limit_s)
        # CVXPY raises a ValueError if the solver has no solution.
        except (cp.error.SolverError, ValueError) as error:
            raise SfglabError(f"node mapping: HiGHS failed: {error}") from error
    if problem.status == cp.INFEASIBLE:
        raise SfglabError(
            f"node mapping: the nodes fixed in hardware do not fit {platform.name}; fix fewer of them"
        )
    sides = {}
    for node, there in zip(graph.nodes, hardware.value > 0.5, strict=True):
        sides[node.name] = Placement.HARDWARE if there else Placement.SOFTWARE
    chosen = {name for name, gateway in gateways.items() if gateway.value > 0.5}
    placed = graph.with_placements(sides)
    mapped = map_communication(placed, gateway=lambda _, topic: topic.name in chosen).gateways
    # HiGHS reports an infinite gap if HiGHS has no lower bound; no load is below 0.
    gap = min(1.0, problem.solver_stats.extra_stats.mip_gap)
    return NodeMapping(graph=mapped, load=assess(mapped), gap=gap)


def check_fixed(graph: Graph, fixed: Mapping[str, Placement]) -> None:
    """Check that the fixed nodes exist and can have their placements; the other nodes can always be in software.

    Raises:
        InvalidValueError: A node does not exist.
        SfglabError: A node in hardware has no implementation in hardware.
    """
    for name, placement in fixed.items():
        if graph.node(name).hardware is None and placement is Placement.HARDWARE:
            raise SfglabError(
                f"node {name!r}: fixed in hardware, where it has no implementation; fix it in software"
            )


def _programme(
    graph: Graph, platform: Platform, fixed: Mapping[str, Placement]
) -> tuple[Any, Any, dict[str, Any]]:
    """Return the problem of CVXPY, the variable x, and the variable y of each topic by the topic's name."""
    import cvxpy as cp

    x = cp.Variable(len(graph.nodes), boolean=True)
    # The variable `in_software` is separate, because HiGHS' gap leaves out a constant of the objective.
    in_software = cp.Variable(len(graph.nodes))
    rows: list[Any] = [in_software == 1 - x]
    work = []
    places = {}
    for number, node in enumerate(graph.nodes):
        part = node.hardware or Implementation()
        work.append(
            (node.rate_hz * node.software_s, node.rate_hz * part.time_s, part.lut, part.bram)
        )
        places[node.name] = number
        if node.hardware is None or node.name in fixed:
            rows.append(x[number] == (fixed.get(node.name) is Placement.HARDWARE))
    software_s, hardware_s, node_lut, node_bram = np.transpose(work)
    cost = software_s @ in_software + hardware_s @ x
    lut = node_lut @ x
    gateways = {}
    for topic in graph.topics:
        publishers = len(topic.publishers)
        ends = [places[name] for name in topic.publishers + topic.subscribers]
        weights = np.full(len(ends), carriage_load(topic, TopicMapping.SOFTWARE))
        weights[:publishers] /= publishers
        y = gateways[topic.name] = cp.Variable(boolean=True)
        h = cp.Variable(bounds=[0, 1])
        e = cp.Variable(len(ends), nonneg=True)
        rows += [e >= x[ends] - h - y, h <= x[ends]]
        cost += weights @ e + carriage_load(topic, TopicMapping.GATEWAY) * y
        lut += GATEWAY_LUT * y
    rows += [lut <= platform.lut, node_bram @ x <= platform.bram]
    return cp.Problem(cp.Minimize(_MS * cost), rows), x, gateways

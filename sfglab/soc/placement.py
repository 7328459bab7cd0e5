"""Node placement: which nodes go to hardware, as one mixed-integer programme that knows gateways.

Paper C leaves this step to the developer and names it as future work (sections 5 and 7). With x_n = 1 for a node in
hardware, y_t = 1 for a topic at a gateway, h_t for a topic in hardware and e_tn for an edge whose messages cross:

    minimise    sum_n [ a_n (1 - x_n) + b_n x_n ] + sum_tn w_tn e_tn + sum_t g_t y_t
    subject to  e_tn >= x_n - h_t - y_t      for every edge of topic t at node n
                h_t <= x_n                   for every node n at topic t
                sum_n lut_n x_n + gateway_lut sum_t y_t <= lut,   sum_n bram_n x_n <= bram
                x_n, y_t in {0, 1},  0 <= h_t <= 1,  e_tn >= 0

a and b are a node's seconds of work per second in software and hardware. w is what one carriage of the topic's
messages across the memory interface costs, once per subscriber and once for all publishers together. g is the cost
of one carriage through a gateway. For whole x the best h and e are whole as well. Loads are sums; how carriages wait for
each other is the subject of `sfglab.soc.memory`.
"""

from __future__ import annotations

import math
import warnings
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.fields import bounds, check_bounds
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

_FINITE = bounds(0, without=(math.inf,))

# Times of one carriage across the memory interface, from its model: a delivery, a call to the delegate and a read of
# the message, and at a gateway also the core's work. Cancels, and the time by which writes exceed reads, are left out.
_CARRIAGE_S = STORED.delegate_s + STORED.deliver_s
_GATEWAY_S = _CARRIAGE_S + STORED.endpoint_s
_CHUNK_BYTES = STORED.memory.chunk_bytes
_CHUNK_S = STORED.memory.read_s(_CHUNK_BYTES) + STORED.deliver_s_per_byte * _CHUNK_BYTES
_BYTES_PER_S = _CHUNK_BYTES / _CHUNK_S

#: Look-up tables of a gateway, about as many as `tests/soc/test_rtl_yosys.py` counts.
GATEWAY_LUT = 690


@dataclass(frozen=True, slots=True, kw_only=True)
class Platform:
    """The area of a system-on-chip."""

    name: str  #: Name of the board.
    lut: int = field(metadata=_FINITE)  #: Look-up tables for nodes and gateways.
    bram: float = field(metadata=_FINITE)  #: Block memories of 36 kbit for nodes.

    def __post_init__(self) -> None:
        check_bounds(self, "platform.")


ZCU104 = Platform(name="ZCU104", lut=230_400, bram=312.0)
"""The board of paper C, section 4: its XCZU7EV (AMD, DS891), nothing set aside for what ReconROS itself takes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """Load of a mapped graph on a platform; times are seconds of work per second of operation."""

    software_s: float  #: Nodes in software.
    hardware_s: float  #: Nodes in hardware.
    communication_s: float  #: Carriages across the memory interface.
    lut: int  #: Look-up tables of nodes and gateways.
    bram: float  #: Block memories of nodes; a gateway takes none.

    @property
    def total_s(self) -> float:
        """Sum of all times, which node placement minimises."""
        return self.software_s + self.hardware_s + self.communication_s

    def check_fits(self, platform: Platform) -> None:
        """Raise an SfglabError if the platform has less area."""
        if self.lut > platform.lut or self.bram > platform.bram:
            raise SfglabError(
                f"mapping: takes {self.lut} LUT and {self.bram:g} BRAM, "
                f"{platform.name} has {platform.lut} and {platform.bram:g}"
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
    """Return the seconds per second that a topic takes of the memory interface as it is mapped.

    Raises:
        InvalidValueError: The topic crosses the interface, and its size or rate is unknown.
    """
    carriages = carriages_per_message(graph, topic)
    if carriages == 0:
        return 0.0
    return carriages * carriage_load(topic, topic.mapping)


def carriage_load(topic: Topic, mapping: TopicMapping) -> float:
    """Return the seconds per second of one carriage of each message, at a gateway or of a software topic.

    Raises:
        InvalidValueError: The topic's size or rate is unknown.
    """
    size_bytes = message_bytes(topic)
    if topic.rate_hz is None:
        key = ("topics", topic.name, "rate_hz")
        raise InvalidValueError(key, None, "messages per second, to know their cost")
    fixed_s = _GATEWAY_S if mapping is TopicMapping.GATEWAY else _CARRIAGE_S
    return topic.rate_hz * (fixed_s + size_bytes / _BYTES_PER_S)


_MS = 1e3  # The programme counts in milliseconds: numbers near 1 suit the solver's tolerances.
_GAP = 1e-7


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeMapping:
    """A graph with placed nodes and mapped topics, and how good that is."""

    graph: Graph  #: Graph with its mapping.
    load: Load  #: Load of the graph.
    bound_s: float  #: Lower bound of the load of every mapping, s per second.

    @property
    def gap(self) -> float:
        """Share of the load by which a mapping could be better at most."""
        return 1 - self.bound_s / self.load.total_s if self.load.total_s else 0.0

    @property
    def optimal(self) -> bool:
        """Whether no mapping is better, within the solver's tolerance."""
        return self.gap <= 10 * _GAP


def place_nodes(
    graph: Graph,
    platform: Platform,
    *,
    fixed: Mapping[str, Placement] | None = None,
    time_limit_s: float = 30.0,
) -> NodeMapping:
    """Place nodes and map topics so that the load is least, with HiGHS.

    Args:
        graph: Graph; its placements and mappings do not matter.
        platform: Area.
        fixed: Placements of nodes that are given. Nodes without an implementation stay in software.
        time_limit_s: Time after which the best mapping found so far is returned, s.

    Raises:
        InvalidValueError: A fixed node does not exist, or a topic's size or rate is unknown.
        SfglabError: The fixed nodes do not fit or have no implementation, or no mapping was found in time.
    """
    check_fixed(graph, platform, fixed or {})
    if not graph.nodes:
        return NodeMapping(graph=graph, load=assess(graph), bound_s=0.0)
    problem, x, y = _programme(graph, platform, fixed or {})
    bound_s = _minimise(problem, time_limit_s)
    sides = {}
    for node, there in zip(graph.nodes, x.value > 0.5, strict=True):
        sides[node.name] = Placement.HARDWARE if there else Placement.SOFTWARE
    chosen = set()
    if y is not None:
        chosen = {graph.topics[number].name for number in np.flatnonzero(y.value > 0.5)}

    def gateway(placed: Graph, topic: Topic) -> bool:
        # The programme may leave a gateway that costs nothing and saves nothing.
        gateway_s = carriage_load(topic, TopicMapping.GATEWAY)
        return topic.name in chosen and gateway_s < topic_load(placed, topic)

    mapped = map_communication(graph.with_placements(sides), gateway=gateway).gateways
    load = assess(mapped)
    return NodeMapping(graph=mapped, load=load, bound_s=min(bound_s, load.total_s))


def check_fixed(graph: Graph, platform: Platform, fixed: Mapping[str, Placement]) -> None:
    """Check that nodes can be placed so; all other nodes can always be in software.

    Raises:
        InvalidValueError: A node does not exist.
        SfglabError: The nodes in hardware do not fit, or one has no implementation in hardware.
    """
    lut, bram = 0, 0.0
    for name, placement in fixed.items():
        hardware = graph.node(name).hardware
        if placement is Placement.HARDWARE:
            if hardware is None:
                raise SfglabError(
                    f"node {name!r}: fixed in hardware, where it has no implementation"
                )
            lut += hardware.lut
            bram += hardware.bram
    if lut > platform.lut or bram > platform.bram:
        raise SfglabError(
            f"node mapping: the nodes fixed in hardware take {lut} LUT and {bram:g} BRAM, "
            f"{platform.name} has {platform.lut} and {platform.bram:g}"
        )


def _programme(
    graph: Graph, platform: Platform, fixed: Mapping[str, Placement]
) -> tuple[Any, Any, Any]:
    """Return CVXPY's problem with x and y; y is None in a graph without topics."""
    import cvxpy as cp

    x = cp.Variable(len(graph.nodes), boolean=True)
    rows: list[Any] = []
    change, lut, bram = [], [], []
    for number, node in enumerate(graph.nodes):
        part = node.hardware or Implementation()
        change.append(node.rate_hz * (part.time_s - node.software_s))
        lut.append(part.lut)
        bram.append(part.bram)
        if node.hardware is None or node.name in fixed:
            rows.append(x[number] == (fixed.get(node.name) is Placement.HARDWARE))
    cost: Any = np.array(change) @ x
    cost += sum(node.rate_hz * node.software_s for node in graph.nodes)
    areas: list[Any] = [np.array(lut) @ x, np.array(bram) @ x]
    y = None
    if graph.topics:
        y = cp.Variable(len(graph.topics), boolean=True)
        cost += _communication(graph, x, y, rows)
        areas[0] += np.full(len(graph.topics), GATEWAY_LUT) @ y
    for area, there in zip(areas, (platform.lut, platform.bram), strict=True):
        # As shares of the area, so that the solver's tolerance is less than one table.
        unit = max(there, 1)
        rows.append(area / unit <= there / unit)
    return cp.Problem(cp.Minimize(_MS * cost), rows), x, y


def _communication(graph: Graph, x: Any, y: Any, rows: list[Any]) -> Any:
    """Add the rows that tie topics to nodes, and return the topics' cost."""
    import cvxpy as cp

    position = {node.name: number for number, node in enumerate(graph.nodes)}
    at_node, at_topic, weight, gateway = [], [], [], []
    for number, topic in enumerate(graph.topics):
        carriage_s = carriage_load(topic, TopicMapping.SOFTWARE)
        gateway.append(carriage_load(topic, TopicMapping.GATEWAY))
        at_node += [position[name] for name in topic.publishers + topic.subscribers]
        at_topic += [number] * (len(topic.publishers) + len(topic.subscribers))
        weight += [carriage_s / len(topic.publishers)] * len(topic.publishers)
        weight += [carriage_s] * len(topic.subscribers)
    h = cp.Variable(len(graph.topics), bounds=[0, 1])
    e = cp.Variable(len(weight), nonneg=True)
    rows += [e >= x[at_node] - h[at_topic] - y[at_topic], h[at_topic] <= x[at_node]]
    return np.array(weight) @ e + np.array(gateway) @ y


def _minimise(problem: Any, time_limit_s: float) -> float:
    """Solve the problem, and return a lower bound of the load, s per second."""
    import cvxpy as cp

    with warnings.catch_warnings():
        # `NodeMapping.gap` tells that the time limit was reached.
        warnings.filterwarnings("ignore", message="Solution may be inaccurate")
        try:
            problem.solve(solver=cp.HIGHS, mip_rel_gap=_GAP, time_limit=time_limit_s)
        # Without a solution CVXPY raises a ValueError.
        except (cp.error.SolverError, ValueError) as error:
            raise SfglabError(f"node mapping: HiGHS failed: {error}") from error
    if problem.status not in {cp.OPTIMAL, cp.USER_LIMIT} or problem.value is None:
        status = problem.status
        raise SfglabError(f"node mapping: HiGHS ended with status {status!r} and no mapping")
    info = problem.solver_stats.extra_stats
    # HiGHS does not count the programme's constant; no load is below 0.
    bound = problem.value - info.objective_function_value + info.mip_dual_bound
    return max(0.0, float(bound)) / _MS

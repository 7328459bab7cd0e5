"""Node mapping: which nodes go to hardware, as a mixed-integer programme that knows gateways.

Paper C leaves this step to the developer and names it as future work (sections 5 and 7). With x_n = 1 for a
node in hardware, y_t = 1 for a topic at a gateway, h_t the share of a topic in hardware (fpgaDDS) and e_tn
that of an edge's messages that cross on their own:

    minimise    sum_n [ a_n (1 - x_n) + b_n x_n ] + sum_tn w_tn e_tn + sum_t g_t y_t
    subject to  e_tn >= x_n - h_t - y_t      for every edge of topic t at node n
                h_t <= x_n                   for every node n at topic t
                sum_n lut_n x_n + gateway_lut sum_t y_t <= lut,   and the same of block memories
                x_n, y_t in {0, 1},  0 <= h_t <= 1,  e_tn >= 0

a and b are a node's seconds of work each second in software and hardware; w is what a carriage of the topic's
messages costs, for each of its subscribers once and for its publishers together once; g is what one through a
gateway costs. Where x is whole, the best h and e are whole as well: h = 1 just where all nodes are in
hardware, so no constant has to be large. A gateway is taken where it pays, not by the paper's rule, which
knows no sizes.

Beside it what a platform offers and a mapped graph takes of it: areas, and times of work and of carrying
messages, each as a sum; how carriages wait for each other is the memory interface model's.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from html import escape
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.errors import InvalidValueError, SfglabError
from sfglab.soc.graph import EdgeKind, Graph, Implementation, Node, Placement, Topic, TopicMapping
from sfglab.soc.mapping import carriages_per_message, map_communication
from sfglab.soc.memory import STORED, Costs

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Platform:
    """A system-on-chip with one memory interface that all hardware nodes and gateways share."""

    name: str  #: What it is called.
    lut: int  #: Look-up tables for nodes and gateways.
    bram: float  #: Block memories of 36 kbit for them.
    bytes_per_s: float  #: Rate at which a message is carried, bytes/s.
    carriage_s: float  #: Fixed time of one carriage of a software-mapped topic, s.
    gateway_s: float  #: Fixed time of one carriage through a gateway, s.
    #: Look-up tables of one gateway; ours takes 654, 702 and 688 with 2, 4 and 8 subscribers
    #: (`sfglab.soc.rtl.gateway_area`, in the log of the experiment `transfer`).
    gateway_lut: int = 690
    gateway_bram: float = 0.0  #: Block memories of one gateway.

    def __post_init__(self) -> None:
        for key in ("lut", "bram", "gateway_lut", "gateway_bram", "carriage_s", "gateway_s"):
            if not 0 <= getattr(self, key) < float("inf"):
                raise InvalidValueError(
                    f"platform.{key}", getattr(self, key), "a finite number from 0"
                )
        if not 0 < self.bytes_per_s < float("inf"):
            raise InvalidValueError(
                "platform.bytes_per_s", self.bytes_per_s, "a finite number above 0"
            )


def platform_from_costs(name: str, *, lut: int, bram: float, costs: Costs = STORED) -> Platform:
    """Return a platform of this area whose carriages take what the memory interface model says they add.

    One more carriage of a software-mapped topic is a delivery, a call to the delegate and a read of the
    message; one through a gateway is the same with the core's own work. Cancels, and what writes take beyond
    reads, are left out: node mapping wants one number for each.
    """
    chunk_bytes = costs.memory.chunk_bytes
    carriage_s = costs.delegate_s + costs.deliver_s
    return Platform(
        name=name,
        lut=lut,
        bram=bram,
        bytes_per_s=chunk_bytes
        / (costs.memory.read_s(chunk_bytes) + costs.deliver_s_per_byte * chunk_bytes),
        carriage_s=carriage_s,
        gateway_s=carriage_s + costs.endpoint_s,
    )


ZCU104 = platform_from_costs("ZCU104", lut=230_400, bram=312.0)
"""The board of paper C, section 4.

Areas are those of its XCZU7EV (AMD's overview of Zynq UltraScale+, DS891), nothing set aside for what ReconROS
itself takes; a gateway's LUTs are those of our core with 2 to 8 subscribers.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class Load:
    """What a mapped graph takes; times are seconds of work in each second of operation, added up."""

    software_s: float  #: Nodes in software.
    hardware_s: float  #: Nodes in hardware.
    communication_s: float  #: Carriages across the memory interface.
    lut: int  #: Look-up tables of nodes and gateways.
    bram: float  #: Block memories of both.

    @property
    def total_s(self) -> float:
        """All times together: what node mapping makes small."""
        return self.software_s + self.hardware_s + self.communication_s

    def fits(self, platform: Platform) -> bool:
        """Return whether the areas are there."""
        return self.lut <= platform.lut and self.bram <= platform.bram

    def check_fits(self, platform: Platform) -> None:
        """Refuse, as an SfglabError, areas that are not there."""
        if not self.fits(platform):
            raise SfglabError(
                f"mapping: takes {self.lut} LUT and {self.bram:g} BRAM, "
                f"{platform.name} has {platform.lut} and {platform.bram:g}"
            )


def assess(graph: Graph, platform: Platform) -> Load:
    """Return what a graph takes as mapped; InvalidValueError where a topic that crosses has no size or rate."""
    placed = [node for node in graph.nodes if node.in_hardware]
    gateways = len(graph.mapped_to(TopicMapping.GATEWAY))
    known = [node.hardware for node in placed if node.hardware is not None]
    return Load(
        software_s=sum(software_load(node) for node in graph.nodes if not node.in_hardware),
        hardware_s=sum(hardware_load(node) for node in placed),
        communication_s=sum(topic_load(graph, topic, platform) for topic in graph.topics),
        lut=sum(part.lut for part in known) + gateways * platform.gateway_lut,
        bram=sum(part.bram for part in known) + gateways * platform.gateway_bram,
    )


def topic_load(graph: Graph, topic: Topic, platform: Platform) -> float:
    """Return the seconds that a topic's messages take of the memory interface each second, as it is mapped.

    Raises:
        InvalidValueError: It crosses, and its size or rate is unknown.
    """
    carriages = carriages_per_message(graph, topic)
    if carriages == 0:
        return 0.0
    load = gateway_load if topic.mapping is TopicMapping.GATEWAY else carriage_load
    return carriages * load(topic, platform)


def software_load(node: Node) -> float:
    """Return a node's seconds of work each second in software."""
    return node.rate_hz * node.software_s


def hardware_load(node: Node) -> float:
    """Return the same in hardware, 0 where nothing is known of its implementation."""
    return 0.0 if node.hardware is None else node.rate_hz * node.hardware.time_s


def carriage_load(topic: Topic, platform: Platform) -> float:
    """Return the seconds each second for one carriage of each message of a software-mapped topic."""
    size_bytes, rate_hz = _traffic(topic)
    return rate_hz * (platform.carriage_s + size_bytes / platform.bytes_per_s)


def gateway_load(topic: Topic, platform: Platform) -> float:
    """Return the same through a gateway."""
    size_bytes, rate_hz = _traffic(topic)
    return rate_hz * (platform.gateway_s + size_bytes / platform.bytes_per_s)


def _traffic(topic: Topic) -> tuple[int, float]:
    key = f"topics.{topic.name}"
    if topic.size_bytes is None:
        raise InvalidValueError(
            f"{key}.size_bytes", None, "the size of a message, to know its cost"
        )
    if topic.rate_hz is None:
        raise InvalidValueError(f"{key}.rate_hz", None, "messages per second, to know their cost")
    return topic.size_bytes, topic.rate_hz


#: The programme counts in milliseconds each second: numbers near 1 suit the solver's tolerances.
_MS = 1e3

_GAP = 1e-7


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeMapping:
    """A graph with nodes placed and topics mapped, and how good that is."""

    graph: Graph  #: The graph.
    load: Load  #: What it takes.
    bound_s: float  #: No mapping takes less than this, seconds each second.

    def __repr__(self) -> str:
        best = "the best there is" if self.optimal else f"at most {self.gap:.1%} from the best"
        return f"<{self.graph!r}: {self.load.total_s:.3g} s each second, {best}>"

    def _repr_html_(self) -> str:
        return f"<p>{escape(repr(self)[1:-1])}</p>{self.graph._repr_html_()}"

    @property
    def gap(self) -> float:
        """By how much the best mapping could be better at most, as a share of this one's load."""
        return (
            max(0.0, self.load.total_s - self.bound_s) / self.load.total_s
            if self.load.total_s
            else 0.0
        )

    @property
    def optimal(self) -> bool:
        """Whether it was proved that no mapping is better, within the solver's tolerance."""
        return self.gap <= 10 * _GAP


@dataclass(frozen=True, slots=True, kw_only=True)
class Programme:
    """The programme with its handles, unsolved."""

    problem: Any  #: CVXPY's problem; its value is in milliseconds each second.
    in_hardware: Any  #: Boolean variable: x, in the order of the graph's nodes.
    #: Boolean variable: y, in the order of the graph's topics; None where there are none.
    at_gateway: Any


def build_programme(
    graph: Graph, platform: Platform, *, fixed: Mapping[str, Placement] | None = None
) -> Programme:
    """Return the programme, unsolved; the graph's own placements do not matter, but `fixed` ones are given.

    Nodes without an implementation in hardware stay in software.

    Raises:
        InvalidValueError: A fixed node is not there, or a topic has no size or no rate.
        SfglabError: A node that is fixed in hardware has no implementation there.
    """
    import cvxpy as cp

    x = cp.Variable(len(graph.nodes), boolean=True, name="in_hardware")
    low, high = _bounds(graph, fixed or {})
    soft, hard = (
        np.array([load(node) for node in graph.nodes]) for load in (software_load, hardware_load)
    )
    cost: Any = _MS * (soft.sum() + (hard - soft) @ x)
    constraints: list[Any] = [x >= low, x <= high]
    y = None
    if graph.topics:
        y = cp.Variable(len(graph.topics), boolean=True, name="at_gateway")
        topic_cost, rows = _communication(graph, platform, x, y)
        cost, constraints = cost + topic_cost, constraints + rows
    constraints += _areas(graph, platform, x, y)
    return Programme(
        problem=cp.Problem(cp.Minimize(cost), constraints), in_hardware=x, at_gateway=y
    )


def place_nodes(
    graph: Graph,
    platform: Platform,
    *,
    fixed: Mapping[str, Placement] | None = None,
    time_limit_s: float = 30.0,
) -> NodeMapping:
    """Place nodes and map topics so that the work of a second takes least time, with HiGHS.

    The graph's own placements do not matter; `fixed` nodes keep theirs, and those without an implementation
    in hardware stay in software. After `time_limit_s` seconds the best mapping found is returned;
    `NodeMapping.gap` says how far from the best of all it may be.

    Raises:
        InvalidValueError: A fixed node is not there, or a topic has no size or no rate.
        SfglabError: The fixed nodes do not fit or have no implementation, or no mapping was found in time.
    """
    check_fixed(graph, platform, fixed or {})
    programme = build_programme(graph, platform, fixed=fixed)
    bound_s = _solve(programme.problem, time_limit_s)
    mapped = _read(programme, graph, platform)
    load = assess(mapped, platform)
    if not load.fits(platform):
        raise SfglabError(
            f"node mapping: HiGHS gave a mapping that does not fit {platform.name}: {load}"
        )
    return NodeMapping(graph=mapped, load=load, bound_s=min(bound_s, load.total_s))


def _read(programme: Programme, graph: Graph, platform: Platform) -> Graph:
    """Return the graph that the solved programme's variables stand for."""
    sides = {
        node.name: Placement.HARDWARE if there else Placement.SOFTWARE
        for node, there in zip(graph.nodes, programme.in_hardware.value > 0.5, strict=True)
    }
    at = (
        set()
        if programme.at_gateway is None
        else set(np.flatnonzero(programme.at_gateway.value > 0.5))
    )
    named = {topic.name for i, topic in enumerate(graph.topics) if i in at}
    return map_communication(
        graph.with_placements(sides),
        gateway=lambda placed, topic: topic.name in named and _pays(placed, topic, platform),
    ).gateways


def _bounds(
    graph: Graph, fixed: Mapping[str, Placement]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the least and the largest value of x for each node."""
    for name, placement in fixed.items():
        if graph.node(name).hardware is None and placement is Placement.HARDWARE:
            raise SfglabError(f"node {name!r}: fixed in hardware, where it has no implementation")
    low = [float(fixed.get(node.name) is Placement.HARDWARE) for node in graph.nodes]
    free = [
        n.hardware is not None and fixed.get(n.name) is not Placement.SOFTWARE for n in graph.nodes
    ]
    return np.array(low), np.array(free, dtype=float)


def _communication(graph: Graph, platform: Platform, x: Any, y: Any) -> tuple[Any, list[Any]]:
    """Return the topics' cost and the rows that tie it to x and y."""
    import cvxpy as cp

    position = {node.name: i for i, node in enumerate(graph.nodes)}
    carriage = {topic.name: carriage_load(topic, platform) for topic in graph.topics}
    number = {topic.name: i for i, topic in enumerate(graph.topics)}
    publishers = {topic.name: len(topic.publishers) for topic in graph.topics}
    edges = list(graph.edges())
    shares = [1 / publishers[e.topic] if e.kind is EdgeKind.PUBLISH else 1.0 for e in edges]
    weights = np.array([share * carriage[e.topic] for share, e in zip(shares, edges, strict=True)])
    at_topic, at_node = [number[e.topic] for e in edges], [position[e.node] for e in edges]
    shared = cp.Variable(len(graph.topics), bounds=[0, 1], name="topic_in_hardware")
    alone = cp.Variable(len(edges), nonneg=True, name="edge_crosses")
    through = np.array([gateway_load(topic, platform) for topic in graph.topics])
    rows = [alone >= x[at_node] - shared[at_topic] - y[at_topic], shared[at_topic] <= x[at_node]]
    return _MS * (weights @ alone + through @ y), rows


def _areas(graph: Graph, platform: Platform, x: Any, y: Any) -> list[Any]:
    """Return the rows of both areas, as shares of what there is, so that a tolerance is less than one table."""
    parts = [node.hardware or Implementation() for node in graph.nodes]
    rows = []
    for taken, gateway, there in (
        ([part.lut for part in parts], platform.gateway_lut, platform.lut),
        ([part.bram for part in parts], platform.gateway_bram, platform.bram),
    ):
        unit = max(there, 1)
        used = (np.array(taken, dtype=float) / unit) @ x
        if y is not None:
            used = used + (np.full(len(graph.topics), float(gateway)) / unit) @ y
        rows.append(used <= there / unit)
    return rows


def check_fixed(graph: Graph, platform: Platform, fixed: Mapping[str, Placement]) -> None:
    """Refuse what makes the programme infeasible; only fixed nodes can: all in software fits every platform.

    Raises:
        InvalidValueError: A fixed node is not there.
        SfglabError: The fixed nodes do not fit, or have no implementation in hardware.
    """
    _bounds(graph, fixed)
    parts = [
        n.hardware for n in graph.nodes if n.hardware and fixed.get(n.name) is Placement.HARDWARE
    ]
    lut, bram = sum(part.lut for part in parts), sum(part.bram for part in parts)
    if lut > platform.lut or bram > platform.bram:
        raise SfglabError(
            f"node mapping: the nodes fixed in hardware take {lut} LUT and {bram:g} BRAM, "
            f"{platform.name} has {platform.lut} and {platform.bram:g}"
        )


def _solve(problem: Any, time_limit_s: float) -> float:
    """Solve, and return a lower bound of the load, seconds each second."""
    import cvxpy as cp

    options = {"mip_rel_gap": _GAP, "time_limit": time_limit_s}
    with warnings.catch_warnings():
        # Said by `NodeMapping.gap`: that the limit was reached, and with what.
        warnings.filterwarnings("ignore", message="Solution may be inaccurate")
        try:
            problem.solve(solver=cp.HIGHS, **options)
        except cp.error.SolverError as error:
            raise SfglabError(f"node mapping: HiGHS failed: {error}") from error
    if problem.status not in {cp.OPTIMAL, cp.USER_LIMIT} or problem.value is None:
        raise SfglabError(
            f"node mapping: HiGHS ended with status {problem.status!r} and no mapping"
        )
    # HiGHS's dual bound, which counts from the programme's constant; no load is below 0.
    info = problem.solver_stats.extra_stats
    return (
        max(0.0, float(info.mip_dual_bound + (problem.value - info.objective_function_value))) / _MS
    )


def _pays(graph: Graph, topic: Topic, platform: Platform) -> bool:
    """Return whether a gateway carries less; the programme may leave one that costs and saves nothing."""
    return gateway_load(topic, platform) < topic_load(graph, topic, platform)

"""The package `sfglab.soc` implements paper C: ROS 2 graphs on a configurable system-on-chip.

The functions `load_graph` and `graph_from_log` return a graph. A user or `place_nodes` places the nodes of the graph
in software or hardware. The function `map_communication` maps the topics of the graph to software, hardware or
gateways.
"""

from sfglab.soc.graph import (
    EdgeKind,
    Graph,
    Implementation,
    Node,
    Placement,
    Topic,
    TopicMapping,
    graph_text,
    load_graph,
)
from sfglab.soc.graph_drawing import draw_graph, draw_mapping
from sfglab.soc.graph_import import build_cfg, graph_from_log
from sfglab.soc.mapping import (
    STAGES,
    CommunicationMapping,
    arrival_s,
    carriages_per_message,
    chain_s,
    crossing_edges,
    faster_by_gateway,
    map_communication,
    transfer_s,
)
from sfglab.soc.placement import ZCU104, Platform, assess, place_nodes

__all__ = [
    "STAGES",
    "ZCU104",
    "CommunicationMapping",
    "EdgeKind",
    "Graph",
    "Implementation",
    "Node",
    "Placement",
    "Platform",
    "Topic",
    "TopicMapping",
    "arrival_s",
    "assess",
    "build_cfg",
    "carriages_per_message",
    "chain_s",
    "crossing_edges",
    "draw_graph",
    "draw_mapping",
    "faster_by_gateway",
    "graph_from_log",
    "graph_text",
    "load_graph",
    "map_communication",
    "place_nodes",
    "transfer_s",
]

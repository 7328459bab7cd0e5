"""The command that maps the topics of a ROS 2 graph to software and hardware (paper C): ``sfglab map``."""

from __future__ import annotations

import io
from collections import defaultdict
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Argument, Option

from sfglab.cli.buses import say, unused, write
from sfglab.cli.options import Interface, Json, ObservedTime, RecordedDomain
from sfglab.cli.traffic import opened, print_left_out
from sfglab.errors import InvalidValueError, MissingExtraError
from sfglab.tables import columns

if TYPE_CHECKING:
    from sfglab.record import LogReader
    from sfglab.soc import CommunicationMapping, Graph


def map_graph(
    file: Annotated[
        Path | None,
        Argument(
            metavar="FILE",
            help="Graph, e.g. data/graphs/figure_8.yaml, or a log or bag. [default: a domain]",
        ),
    ] = None,
    gateway_rule: Annotated[
        Literal["paper", "size"],
        Option(
            help="Rule for topics between software and hardware. paper: a topic with several "
            "subscribers in hardware gets a gateway. size: a topic that the memory model predicts "
            "to be faster through a gateway gets a gateway."
        ),
    ] = "paper",
    optimise_placement: Annotated[
        bool,
        Option(
            "--optimise-placement",
            help="Also place the nodes: minimise computing and transfer time per second (HiGHS).",
        ),
    ] = False,
    lut: Annotated[
        int | None, Option(min=0, help="Number of LUTs of the FPGA. [default: 230400, ZCU104]")
    ] = None,
    bram: Annotated[
        float | None, Option(min=0, help="Number of block RAMs of the FPGA. [default: 312, ZCU104]")
    ] = None,
    figure: Annotated[
        Path | None, Option(help="Draw the mapping into this file: .png, .svg or .pdf.")
    ] = None,
    output: Annotated[
        Path | None,
        Option("--output", "-o", help="Write the mapped graph into this YAML file."),
    ] = None,
    build_cfg: Annotated[
        Path | None,
        Option(help="Write the nodes and topics in hardware into this file, for ReconROS."),
    ] = None,
    verilog: Annotated[
        Path | None,
        Option(help="Write the gateways of the mapping into this folder as Verilog (Yosys)."),
    ] = None,
    domain: RecordedDomain = None,
    duration: ObservedTime = 5.0,
    interface: Interface = None,
    as_json: Json = False,
) -> None:
    """Map each topic of a ROS 2 graph to software, hardware (FPGA) or a gateway (paper C, section 5).

    A gateway transfers each message once across the boundary, for all subscribers on the other side.

    Examples:
      sfglab map data/graphs/figure_8.yaml
      sfglab map data/graphs/driving.yaml --gateway-rule size --figure driving.png
      sfglab map bag/ --output graph.yaml   # set in graph.yaml which nodes are in hardware.
      sfglab map --domain 7 --output graph.yaml   # the graph of running nodes.
      sfglab map data/graphs/driving.yaml --optimise-placement --lut 40000 --output placed.yaml
      sfglab map data/graphs/driving.yaml --build-cfg build.cfg --verilog rtl
    """
    from sfglab.soc import build_cfg as build_text
    from sfglab.soc import faster_by_gateway, graph_text, map_communication

    if figure is not None and figure.suffix not in {".png", ".svg", ".pdf"}:
        raise InvalidValueError("--figure", figure, "a .png, .svg or .pdf file")
    with opened(file, (domain, interface), duration) as source:
        graph = _graph_of(source)
    load = ""
    if optimise_placement:
        unused("with --optimise-placement, which chooses gateways by their cost", "gateway_rule")
        mapping, load = _placed(graph, lut, bram)
    else:
        unused("without --optimise-placement, which alone uses areas", "lut", "bram")
        if gateway_rule == "size":
            mapping = map_communication(graph, gateway=faster_by_gateway)
        else:
            mapping = map_communication(graph)
    found = mapping.gateways
    files: dict[Path, str | bytes] = {}
    if figure is not None:
        files[figure] = _drawing(mapping, figure)
    if output is not None:
        files[output] = graph_text(found)
    if build_cfg is not None:
        files[build_cfg] = build_text(found, name=found.name or build_cfg.stem)
    modules = {} if verilog is None else _verilog(found)
    say(found, load + _report(mapping), as_json=as_json)
    write(files, err=as_json)
    write(modules, verilog, err=as_json)


def _graph_of(source: LogReader | Path) -> Graph:
    """Return the graph of a log or of a file."""
    from sfglab.soc import graph_from_log, load_graph

    if isinstance(source, Path):
        return load_graph(source)
    found = graph_from_log(source)
    print_left_out(found.left_out)
    return found.graph


def _placed(graph: Graph, lut: int | None, bram: float | None) -> tuple[CommunicationMapping, str]:
    """Return the mapping with placed nodes, and the load of the mapping as a text."""
    from sfglab.soc import ZCU104, TopicMapping, map_communication, place_nodes

    board = replace(
        ZCU104,
        lut=ZCU104.lut if lut is None else lut,
        bram=ZCU104.bram if bram is None else bram,
    )
    found = place_nodes(graph, board)
    load = found.load
    proved = "no mapping takes less"
    if not found.optimal:
        proved = f"another mapping takes at most {100 * found.gap:.2g} % less"
    text = (
        f"work per second: software {1e3 * load.software_s:.2f} ms, "
        f"hardware {1e3 * load.hardware_s:.2f} ms, "
        f"transfer {1e3 * load.communication_s:.2f} ms; {proved}\n"
        f"area: {load.lut} of {board.lut} LUT, {load.bram:g} of {board.bram:g} BRAM\n\n"
    )
    gateways = found.graph.mapped_to(TopicMapping.GATEWAY)
    mapping = map_communication(found.graph, gateway=lambda _, topic: topic.name in gateways)
    return mapping, text


def _report(mapping: CommunicationMapping) -> str:
    nodes = mapping.gateways.nodes
    hardware = [node.name for node in nodes if node.in_hardware]
    software = [node.name for node in nodes if not node.in_hardware]
    lines = [
        f"nodes in hardware: {_list(hardware)}",
        f"nodes in software: {_list(software)}",
        "",
        *_topic_table(mapping),
        "",
        *_crossing_table(mapping),
    ]
    return "\n".join(lines)


def _list(names: list[str]) -> str:
    return ", ".join(names) or "none"


def _topic_table(mapping: CommunicationMapping) -> list[str]:
    from sfglab.soc import carriages_per_message, transfer_s

    rows = [("topic", "mapped to", "times carried", "predicted ms (all in software -> as mapped)")]
    for topic in mapping.gateways.topics:
        carried = []
        predicted = []
        for graph in (mapping.all_software, mapping.gateways):
            mapped = graph.topic(topic.name)
            carried.append(f"{carriages_per_message(graph, mapped):g}")
            known = mapped.size_bytes is not None
            predicted.append(f"{1e3 * transfer_s(graph, mapped):.3f}" if known else "unknown")
        row = (topic.name, topic.mapping.value, " -> ".join(carried), " -> ".join(predicted))
        rows.append(row)
    return columns(rows)


def _crossing_table(mapping: CommunicationMapping) -> list[str]:
    from sfglab.soc import STAGES, EdgeKind, crossing_edges

    rows: list[tuple[str, ...]] = [
        ("edges across the boundary", "publish", "subscribe", "together")
    ]
    left: list[str] = []
    for title, graph in zip(STAGES, mapping.stages, strict=True):
        crossing = crossing_edges(graph)
        kinds = [edge.kind for edge in crossing]
        numbers = (kinds.count(EdgeKind.PUBLISH), kinds.count(EdgeKind.SUBSCRIBE), len(kinds))
        rows.append((title, *map(str, numbers)))
        left = list(map(str, crossing))
    return [*columns(rows, right=(1, 2, 3)), f"left: {_list(left)}"]


def _verilog(graph: Graph) -> dict[Path, str]:
    """Return one module per number of hardware subscribers, and print the topics of each module."""
    from sfglab.soc import TopicMapping

    if find_spec("amaranth") is None:
        raise MissingExtraError("amaranth", extra="rtl", purpose="--verilog")
    from sfglab.soc.rtl import gateway_verilog

    topics: dict[int, list[str]] = defaultdict(list)
    for name in graph.mapped_to(TopicMapping.GATEWAY):
        readers = graph.hardware_nodes.intersection(graph.topic(name).subscribers)
        topics[len(readers)].append(name)
    modules = {}
    for count, names in sorted(topics.items()):
        path = Path(f"sfglab_gateway_{count}.v")
        modules[path] = gateway_verilog(count)
        typer.echo(f"{path}: for {', '.join(names)}", err=True)
    return modules


def _drawing(mapping: CommunicationMapping, path: Path) -> bytes:
    from matplotlib.figure import Figure

    from sfglab.soc import draw_mapping

    figure = Figure(layout="constrained")
    draw_mapping(mapping, figure)
    drawing = io.BytesIO()
    figure.savefig(drawing, format=path.suffix[1:])
    return drawing.getvalue()

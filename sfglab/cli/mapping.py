"""The command that maps a computation graph onto a system-on-chip."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from sfglab.soc import CommunicationMapping, Graph, Topic


class _Rule(StrEnum):
    PAPER = "paper"
    SIZE = "size"


def map_graph(
    file: Annotated[Path, typer.Argument(help="A computation graph, e.g. data/graphs/figure_8.yaml")],
    rule: Annotated[
        _Rule | None,
        typer.Option(
            help="Which topics between both sides get a gateway. paper: those with more than one subscriber in "
            "hardware. size: those that it is predicted to make faster. [default: paper]"
        ),
    ] = None,
    place: Annotated[
        bool,
        typer.Option("--place", help="Place the nodes as well: least work and carriage a second, HiGHS."),
    ] = False,
    lut: Annotated[int | None, typer.Option(min=0, help="LUTs that there are; else the ZCU104's.")] = None,
    bram: Annotated[float | None, typer.Option(min=0, help="BRAMs that there are; else the ZCU104's.")] = None,
    figure: Annotated[
        Path | None, typer.Option(help="Draw the mapping into this file: .png, .svg or .pdf.")
    ] = None,
    out: Annotated[Path | None, typer.Option(help="Write the mapped graph into this file, as YAML.")] = None,
    build: Annotated[
        Path | None, typer.Option("--build-cfg", help="Write the hardware's part for ReconROS into this file.")
    ] = None,
    verilog: Annotated[
        Path | None,
        typer.Option(
            help="Write the gateways that the mapping needs into this folder, as Verilog (needs Yosys)."
        ),
    ] = None,
) -> None:
    """Say which topics of a ROS 2 graph go to software, to hardware or to a gateway (paper C, section 5).

    Examples:

      sfglab map data/graphs/figure_8.yaml

      sfglab map data/graphs/driving.yaml --rule size --figure driving.png

      sfglab map data/graphs/driving.yaml --place --lut 40000 --out placed.yaml

      sfglab map data/graphs/driving.yaml --build-cfg build.cfg --verilog rtl
    """
    from sfglab.soc import load_graph, save_graph

    graph = load_graph(file)
    if place and rule is not None:
        raise SfglabError("--rule: given with --place, which chooses gateways by their cost")
    if not place and (lut is not None or bram is not None):
        raise SfglabError("--lut and --bram: given without --place, which alone knows areas")
    mapping = _placed(graph, lut, bram) if place else _mapped(graph, rule)
    typer.echo(_report(mapping), nl=False)
    if figure is not None:
        _draw(mapping, figure)
    if out is not None:
        save_graph(mapping.gateways, out)
    if build is not None:
        _write_build_cfg(mapping.gateways, build)
    if verilog is not None:
        _write_verilog(mapping.gateways, verilog)


def add_to(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command("map")(map_graph)


def _mapped(graph: Graph, rule: _Rule | None) -> CommunicationMapping:
    from sfglab.soc import faster_by_gateway, map_communication

    if rule is _Rule.SIZE:
        return map_communication(graph, gateway=faster_by_gateway())
    return map_communication(graph)


def _placed(graph: Graph, lut: int | None, bram: float | None) -> CommunicationMapping:
    from dataclasses import replace

    from sfglab.soc import ZCU104, TopicMapping, map_communication, place_nodes

    platform = replace(
        ZCU104, lut=ZCU104.lut if lut is None else lut, bram=ZCU104.bram if bram is None else bram
    )
    found = place_nodes(graph, platform)
    load = found.load
    proved = "no mapping takes less" if found.optimal else f"at most {100 * found.gap:.2g} % above the least"
    typer.echo(
        f"work each second: software {1e3 * load.software_s:.2f} ms, hardware {1e3 * load.hardware_s:.2f} ms, "
        f"carriage {1e3 * load.communication_s:.2f} ms; {proved}\n"
        f"area: {load.lut} of {platform.lut} LUT, {load.bram:g} of {platform.bram:g} BRAM\n"
    )
    at = set(found.graph.mapped_to(TopicMapping.GATEWAY))
    return map_communication(found.graph, gateway=lambda _, topic: topic.name in at)


def _report(mapping: CommunicationMapping) -> str:
    graph = mapping.gateways
    sides = [
        ("nodes in hardware", [node.name for node in graph.nodes if node.in_hardware]),
        ("nodes in software", [node.name for node in graph.nodes if not node.in_hardware]),
    ]
    lines = [f"{name}: {', '.join(members) or 'none'}" for name, members in sides]
    return "\n".join([*lines, "", *_topic_table(mapping), "", *_crossing_table(mapping)]) + "\n"


def _topic_table(mapping: CommunicationMapping) -> list[str]:
    from sfglab.soc import carriages_per_message

    width = max([len("topic"), *(len(topic.name) for topic in mapping.gateways.topics)])
    lines = [f"{'topic':{width}}  mapped to  times carried  predicted ms (all in software -> as mapped)"]
    for topic in mapping.gateways.topics:
        first = mapping.software.topic(topic.name)
        before, after = (
            carriages_per_message(mapping.software, first),
            carriages_per_message(mapping.gateways, topic),
        )
        predicted = f"{_predicted(mapping.software, first)} -> {_predicted(mapping.gateways, topic)}"
        lines.append(
            f"{topic.name:{width}}  {topic.mapping.value:9}  {f'{before:g} -> {after:g}':13}  {predicted}"
        )
    return lines


def _predicted(graph: Graph, topic: Topic) -> str:
    from sfglab.soc import transfer_s

    return "unknown" if topic.size_bytes is None else f"{1e3 * transfer_s(graph, topic):.3f}"


def _crossing_table(mapping: CommunicationMapping) -> list[str]:
    from sfglab.soc import crossing_edges

    lines = ["edges across the boundary       publish  subscribe  together"]
    titles = ("all topics in software", "topics in hardware", "topics in hardware, gateways")
    for title, graph in zip(titles, mapping.stages, strict=True):
        found = crossing_edges(graph)
        publications, subscriptions = len(found.publications), len(found.subscriptions)
        lines.append(f"{title:30}  {publications:7d}  {subscriptions:9d}  {len(found):8d}")
    left = crossing_edges(mapping.gateways)
    edges = [str(edge) for edge in (*left.publications, *left.subscriptions)]
    return [*lines, f"left: {', '.join(edges) or 'none'}"]


def _write_build_cfg(graph: Graph, path: Path) -> None:
    from sfglab.soc import build_cfg

    text = build_cfg(graph, name=graph.name or path.stem)
    try:
        path.write_text(text, encoding="utf-8")
    except OSError as error:
        raise SfglabError(
            f"--build-cfg: given {path}, needed is a file that can be written ({error})"
        ) from error


def _write_verilog(graph: Graph, folder: Path) -> None:
    """Write one module for each number of hardware subscribers."""
    from importlib.util import find_spec

    from sfglab.errors import MissingExtraError
    from sfglab.soc import TopicMapping

    if find_spec("amaranth") is None:
        raise MissingExtraError("amaranth", extra="rtl", purpose="--verilog")
    from sfglab.soc.rtl import gateway_verilog

    topics: dict[int, list[str]] = {}
    for topic in graph.topics:
        if topic.mapping is TopicMapping.GATEWAY:
            count = len(graph.in_hardware.intersection(topic.subscribers))
            topics.setdefault(count, []).append(topic.name)
    for count, names in sorted(topics.items()):
        path = folder / f"sfglab_gateway_{count}.v"
        text = gateway_verilog(count)
        try:
            folder.mkdir(parents=True, exist_ok=True)
            path.write_text(text, encoding="utf-8")
        except OSError as error:
            raise SfglabError(
                f"--verilog: given {folder}, needed is a folder that can be written ({error})"
            ) from error
        typer.echo(f"{path.name}: for {', '.join(names)}")


def _draw(mapping: CommunicationMapping, path: Path) -> None:
    from matplotlib.figure import Figure

    from sfglab.soc import draw_mapping

    figure = Figure(layout="constrained")
    draw_mapping(mapping, figure)
    try:
        figure.savefig(path)
    except (OSError, ValueError) as error:
        raise SfglabError(
            f"--figure: given {path}, needed is a .png, .svg or .pdf that can be written ({error})"
        ) from error

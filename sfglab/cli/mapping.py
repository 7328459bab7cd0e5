"""Commands that plan before anything runs: QoS of topics, and mappings of graphs onto a system-on-chip."""

from __future__ import annotations

import io
import os
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Argument, Option

from sfglab.cli.buses import Interface, Json, put, put_text, say, say_left_out, tell, unused
from sfglab.domains import MAX_DOMAIN, VARIABLE, usual_domain_id
from sfglab.errors import InvalidValueError, MissingExtraError, SfglabError
from sfglab.tables import columns
from sfglab.units import NS_PER_MS

if TYPE_CHECKING:
    from sfglab.arp import Plan, TopicFile
    from sfglab.soc import CommunicationMapping, Graph, Topic

_Format = Literal["table", "fastdds", "fastdds3", "cyclone", "ros2", "topics"]
_Method = Literal["ours", "paper"]
_Vendor = Literal["fast_dds", "cyclone_dds"]
_Rmw = Literal["fastrtps-async", "fastrtps-sync", "cyclone"]
_Rule = Literal["paper", "size"]
_Domain = Annotated[
    int | None,
    Option(
        min=0,
        max=MAX_DOMAIN,
        help=f"DDS domain to listen to, without a file. [default: {VARIABLE}]",
    ),
]
_Seconds = Annotated[float, Option(min=0.5, help="How long to listen to it.")]

_PRESET_OF = {
    "fastrtps-async": "fast_dds_async",
    "fastrtps-sync": "fast_dds_sync",
    "cyclone": "cyclone_dds",
}


def qos(
    file: Annotated[
        Path | None,
        Argument(
            help="A file of topics, e.g. data/qos/paper_b.yaml, or a log or bag; else --domain."
        ),
    ] = None,
    method: Annotated[
        _Method,
        Option(
            help="ours: convex optimisation with a model of the link. paper: paper B, Eq. 1 to 6."
        ),
    ] = "ours",
    output_format: Annotated[
        _Format,
        Option(
            "--format",
            help="A table, a file that Fast DDS 2 or 3, Cyclone DDS or ROS 2 reads, or a log's file of topics.",
        ),
    ] = "table",
    out: Annotated[
        Path | None, Option(help="Write the file into this folder, not to the terminal.")
    ] = None,
    rate_max: Annotated[
        float | None, Option(min=0.001, help="No topic faster than this, Hz.")
    ] = None,
    vendor: Annotated[
        _Vendor | None, Option(help="Another DDS than the file's, with its defaults.")
    ] = None,
    rmw: Annotated[
        _Rmw | None, Option(help="What ROS 2 runs on, and how that publishes; instead of --vendor.")
    ] = None,
    latency_weight: Annotated[
        float | None,
        Option(
            min=0.0,
            help="Weight of latency in the objective, Hz. "
            "[default: the one that keeps most readers up to date]",
        ),
    ] = None,
    pareto: Annotated[
        bool, Option("--pareto", help="Print the Pareto front, one line per latency weight.")
    ] = False,
    domain: _Domain = None,
    seconds: _Seconds = 5.0,
    interface: Interface = None,
    as_json: Json = False,
) -> None:
    """Say how often each topic should be sent, how deep its history and how long its deadline should be.

    Examples:
      sfglab qos data/qos/paper_b.yaml
      sfglab qos data/qos/paper_b.yaml --method paper --rate-max 500
      sfglab qos data/qos/paper_b.yaml --rmw fastrtps-async
      sfglab qos data/qos/paper_b.yaml --pareto
      sfglab qos data/qos/paper_b.yaml --format fastdds --out config
      sfglab qos data/qos/warehouse.yaml --format cyclone --out config
      sfglab qos bag/ --format topics --out config   # then say in topics.yaml what the link is
      sfglab qos --domain 7 --seconds 20 --format topics --out config
    """
    from sfglab.arp import plan_as_printed, plan_file
    from sfglab.arp.exports import EXPORTS
    from sfglab.arp.recorded import topics_text
    from sfglab.record.bags import is_log
    from sfglab.rtps import PRESETS

    with _source(file, domain, interface, seconds) as source:
        given = _topics_of(source).limited_to(rate_max)
    if output_format == "topics":
        if not is_log(source):
            raise SfglabError(f"--format topics: given {source}, needed is a log or a bag")
        put_text(topics_text(given.topics, source.name), out and Path("topics.yaml"), out)
        return
    if rmw is not None and vendor is not None:
        raise SfglabError("--rmw: given with --vendor, allowed is one of them")
    preset = _PRESET_OF[rmw] if rmw else vendor
    if preset is not None and PRESETS[preset].name != given.vendor.name:
        given = replace(given, vendor=PRESETS[preset])
    if pareto:
        why = "with --pareto, which prints all latency weights on the terminal"
        unused(why, "method", "output_format", "out", "latency_weight")
        typer.echo(_front_table(given))
        return
    if method == "paper":
        unused("with --method paper, which has no latency weight", "latency_weight")
    export, name = EXPORTS.get(output_format), given.vendor.name
    if export and export.vendor and not name.startswith(export.vendor.name):
        fitting = [
            n for n, e in EXPORTS.items() if e.vendor is None or name.startswith(e.vendor.name)
        ]
        vendor_name = export.vendor.name.lower().replace(" ", "_")
        needed = f"{' or '.join(fitting)} for {name}; this with --vendor {vendor_name}"
        raise InvalidValueError("--format", output_format, needed)
    plan = (
        plan_as_printed(given)
        if method == "paper"
        else plan_file(given, latency_price_hz=latency_weight)
    )
    if as_json:
        unused("with --json", "output_format", "out")
        tell(plan)
    else:
        text, file_name = (
            (export.render(plan), export.file) if export else (_plan_table(plan), "qos.txt")
        )
        put_text(text, out and Path(file_name), out)


@contextmanager
def _source(
    file: Path | None, domain: int | None, interface: str | None, seconds: float
) -> Iterator[Path]:
    """Yield what is to be read: a file, or the recording of what is on a domain for some seconds."""
    from sfglab.cli.logs import record_for

    if file is not None and domain is None:
        unused("with a file, which is on no domain", "seconds", "interface")
        yield file
        return
    if domain is None and os.environ.get(VARIABLE):
        domain = usual_domain_id()
    if file is not None or domain is None:
        given = (
            "both a file and --domain"
            if file
            else f"neither a file nor --domain, and no {VARIABLE} is set"
        )
        raise SfglabError(f"given {given}, needed is one of them")
    with TemporaryDirectory(prefix="sfglab-") as folder:
        path = Path(folder) / f"domain {domain}.mcap"
        typer.echo(f"listening to domain {domain} for {seconds:g} s", err=True)
        record_for(path, seconds, (domain, interface))
        yield path


def _topics_of(file: Path) -> TopicFile:
    """Return what a file of topics says, or what a log shows, and say what is not part of it."""
    from sfglab.arp import TopicFile, load_topics
    from sfglab.arp.recorded import topics_from_log
    from sfglab.record import LogReader
    from sfglab.record.bags import is_log

    if not is_log(file):
        return load_topics(file)
    with LogReader(file) as log:
        topics, left_out = topics_from_log(log)
    say_left_out(left_out)
    if not topics:
        raise SfglabError(
            f"{file}: given no topic from one host to another, needed is one at least"
        )
    return TopicFile(topics=topics, agents=tuple(sorted({topic.source for topic in topics})))


def _plan_table(plan: Plan) -> str:
    rows = [("topic", "rate Hz", "depth", "deadline ms", "latency ms", "lost %", "up to date %")]
    rows += [
        (
            part.topic.name,
            f"{part.rate_hz:.2f}",
            str(part.depth),
            "none" if part.deadline_ns is None else f"{part.deadline_ns / NS_PER_MS:.1f}",
            f"{1e3 * part.latency_s:.2f}",
            f"{100 * part.loss:.3f}",
            f"{100 * part.up_to_date:.1f}",
        )
        for part in plan.topics
    ]
    latency = f"{1e3 * plan.latency_s:.2f} ms" if plan.latency_s < float("inf") else "without bound"
    lines = [
        *columns(rows, right=range(1, 7)),
        "",
        f"{plan.vendor.name}, {plan.medium.rate_bps / 1e6:g} Mbit/s, {100 * plan.medium.loss:g} % loss",
        f"taken of the medium's time {100 * plan.utilisation:.0f} %, expected latency {latency}",
        f"readers up to date {100 * plan.up_to_date:.1f} % of the time",
    ]
    if plan.utilisation >= 1:
        lines.append(
            "the medium is overloaded: queues grow without end, and what they cannot hold is lost"
        )
    return "\n".join(lines) + "\n"


def _front_table(given: TopicFile) -> str:
    from sfglab.arp import Limits, pareto_front

    limits = Limits(utilisation_max=given.utilisation_max, residual_loss=given.residual_loss)
    points = pareto_front(given.topics, given.medium, given.vendor, limits=limits)
    rows = [
        (
            "latency weight Hz",
            "freshness %",
            "latency ms",
            "up to date %",
            "medium taken %",
            "price of airtime",
        )
    ]
    rows += [
        (
            f"{point.latency_price_hz:.2f}",
            f"{100 * point.freshness:.2f}",
            f"{1e3 * point.latency_s:.3f}",
            f"{100 * point.up_to_date:.2f}",
            f"{100 * point.utilisation:.1f}",
            f"{point.airtime_price:.4f}",
        )
        for point in points
    ]
    return "\n".join(columns(rows, right=range(6)))


def map_graph(
    file: Annotated[
        Path | None,
        Argument(
            help="A computation graph, e.g. data/graphs/figure_8.yaml, or a log; else --domain."
        ),
    ] = None,
    gateway_rule: Annotated[
        _Rule | None,
        Option(
            help="Which topics between both sides get a gateway. paper: those with more than one subscriber in "
            "hardware. size: those that it is predicted to make faster. [default: paper]"
        ),
    ] = None,
    optimise_placement: Annotated[
        bool,
        Option(
            "--optimise-placement",
            help="Place the nodes as well: least computing and transfer time per second, by HiGHS.",
        ),
    ] = False,
    lut: Annotated[
        int | None, Option(min=0, help="LUTs that there are; else the ZCU104's.")
    ] = None,
    bram: Annotated[
        float | None, Option(min=0, help="BRAMs that there are; else the ZCU104's.")
    ] = None,
    figure: Annotated[
        Path | None, Option(help="Draw the mapping into this file: .png, .svg or .pdf.")
    ] = None,
    stage: Annotated[str, Option(help="Draw one alone: software, hardware or gateways.")] = "",
    out: Annotated[
        Path | None, Option(help="Write the mapped graph into this file, as YAML.")
    ] = None,
    build: Annotated[
        Path | None,
        Option("--build-cfg", help="Write the hardware's part for ReconROS into this file."),
    ] = None,
    verilog: Annotated[
        Path | None,
        Option(
            help="Write the gateways that the mapping needs into this folder, as Verilog (needs Yosys)."
        ),
    ] = None,
    domain: _Domain = None,
    seconds: _Seconds = 5.0,
    interface: Interface = None,
    as_json: Json = False,
) -> None:
    """Say which topics of a ROS 2 graph go to software, to hardware or to a gateway (paper C, section 5).

    Examples:
      sfglab map data/graphs/figure_8.yaml
      sfglab map data/graphs/driving.yaml --gateway-rule size --figure driving.png
      sfglab map bag/ --out graph.yaml   # a bag or MCAP; then say in the file what is in hardware
      sfglab map --domain 7 --out graph.yaml   # the same of what runs
      sfglab map data/graphs/driving.yaml --optimise-placement --lut 40000 --out placed.yaml
      sfglab map data/graphs/driving.yaml --build-cfg build.cfg --verilog rtl
    """
    from sfglab.record.bags import is_log
    from sfglab.soc import build_cfg, faster_by_gateway, load_graph, map_communication
    from sfglab.soc.graph import graph_text

    with _source(file, domain, interface, seconds) as source:
        graph = _recorded(source) if is_log(source) else load_graph(source)
    if optimise_placement:
        unused("with --optimise-placement, which chooses gateways by their cost", "gateway_rule")
    else:
        unused("without --optimise-placement, which alone uses areas", "lut", "bram")
    if figure is None:
        unused("without --figure, in which it is drawn", "stage")
    gateway = {"gateway": faster_by_gateway()} if gateway_rule == "size" else {}
    mapping = (
        _placed(graph, lut, bram) if optimise_placement else map_communication(graph, **gateway)
    )
    found = mapping.gateways
    files: dict[Path, str | bytes] = {}
    if figure is not None:
        files[figure] = _drawn(mapping, figure, stage)
    if out is not None:
        files[out] = graph_text(found)
    if build is not None:
        files[build] = build_cfg(found, name=found.name or build.stem)
    modules = _verilog(found) if verilog is not None else {}
    say(mapping.gateways, lambda _: _report(mapping), as_json=as_json)
    put(files)
    put(modules, verilog)


def _recorded(file: Path) -> Graph:
    """Return the graph of a log, and say what is not part of it."""
    from sfglab.record import LogReader
    from sfglab.soc import graph_from_log

    with LogReader(file) as log:
        found = graph_from_log(log)
    say_left_out(found.left_out)
    return found.graph


def _placed(graph: Graph, lut: int | None, bram: float | None) -> CommunicationMapping:
    from sfglab.soc import ZCU104, TopicMapping, map_communication, place_nodes

    board = replace(
        ZCU104, lut=ZCU104.lut if lut is None else lut, bram=ZCU104.bram if bram is None else bram
    )
    found = place_nodes(graph, board)
    load = found.load
    proved = (
        "no mapping takes less"
        if found.optimal
        else f"at most {100 * found.gap:.2g} % above the least"
    )
    typer.echo(
        f"work each second: software {1e3 * load.software_s:.2f} ms, hardware {1e3 * load.hardware_s:.2f} ms, "
        f"carriage {1e3 * load.communication_s:.2f} ms; {proved}\n"
        f"area: {load.lut} of {board.lut} LUT, {load.bram:g} of {board.bram:g} BRAM\n"
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

    rows = [("topic", "mapped to", "times carried", "predicted ms (all in software -> as mapped)")]
    for topic in mapping.gateways.topics:
        first = mapping.software.topic(topic.name)
        before = carriages_per_message(mapping.software, first)
        after = carriages_per_message(mapping.gateways, topic)
        predicted = (
            f"{_predicted(mapping.software, first)} -> {_predicted(mapping.gateways, topic)}"
        )
        rows.append((topic.name, topic.mapping.value, f"{before:g} -> {after:g}", predicted))
    return columns(rows)


def _predicted(graph: Graph, topic: Topic) -> str:
    from sfglab.soc import transfer_s

    return "unknown" if topic.size_bytes is None else f"{1e3 * transfer_s(graph, topic):.3f}"


def _crossing_table(mapping: CommunicationMapping) -> list[str]:
    from sfglab.soc import crossing_edges

    rows = [(f"{'edges across the boundary':30}", "publish", "subscribe", "together")]
    titles = ("all topics in software", "topics in hardware", "topics in hardware, gateways")
    for title, graph in zip(titles, mapping.stages, strict=True):
        found = crossing_edges(graph)
        rows.append(
            (title, str(len(found.publications)), str(len(found.subscriptions)), str(len(found)))
        )
    left = crossing_edges(mapping.gateways)
    edges = [str(edge) for edge in (*left.publications, *left.subscriptions)]
    return [*columns(rows, right=(1, 2, 3)), f"left: {', '.join(edges) or 'none'}"]


def _verilog(graph: Graph) -> dict[Path, str]:
    """Return one module for each number of hardware subscribers, and say whose they are."""
    from sfglab.soc import TopicMapping

    if find_spec("amaranth") is None:
        raise MissingExtraError("amaranth", extra="rtl", purpose="--verilog")
    from sfglab.soc.rtl import gateway_verilog

    topics: dict[int, list[str]] = defaultdict(list)
    for name in graph.mapped_to(TopicMapping.GATEWAY):
        topics[len(graph.in_hardware.intersection(graph.topic(name).subscribers))].append(name)
    made = {}
    for count, names in sorted(topics.items()):
        path = Path(f"sfglab_gateway_{count}.v")
        made[path] = gateway_verilog(count)
        typer.echo(f"{path}: for {', '.join(names)}")
    return made


def _drawn(mapping: CommunicationMapping, path: Path, stage: str) -> bytes:
    from matplotlib.figure import Figure

    from sfglab.soc import draw_mapping

    figure = Figure(layout="constrained")
    draw_mapping(mapping, figure, stage)
    if path.suffix not in {".png", ".svg", ".pdf"}:
        raise InvalidValueError("--figure", path, "a .png, .svg or .pdf")
    drawn = io.BytesIO()
    figure.savefig(drawn, format=path.suffix[1:])
    return drawn.getvalue()

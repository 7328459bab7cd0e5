"""The command that plans QoS of topics on a shared link (paper B): ``sfglab qos``."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Argument, Option

from sfglab.cli.buses import print_json, unused, write_text
from sfglab.cli.options import Interface, Json, ObservedTime, OutputFolder, RecordedDomain
from sfglab.cli.traffic import opened, print_left_out
from sfglab.errors import InvalidValueError, SfglabError
from sfglab.fields import to_json
from sfglab.tables import columns
from sfglab.units import NS_PER_MS

if TYPE_CHECKING:
    from sfglab.arp import Plan, TopicFile
    from sfglab.record import LogReader

_PRESET_OF = {
    "fastrtps-async": "fast_dds_async",
    "fastrtps-sync": "fast_dds_sync",
    "cyclone": "cyclone_dds",
}
#: Largest share of lost samples at which the computed delays are near the simulated delays.
_LOSS_MOST = 0.1


def qos(
    file: Annotated[
        Path | None,
        Argument(
            metavar="FILE",
            help="File of topics, e.g. data/qos/paper_b.yaml, or a log or bag. [default: a domain]",
        ),
    ] = None,
    method: Annotated[
        Literal["ours", "paper"],
        Option(
            help="ours: convex optimisation with a model of the link. paper: paper B, Eq. 1 to 6."
        ),
    ] = "ours",
    format_: Annotated[
        Literal["table", "fastdds", "fastdds3", "cyclone", "ros2", "topics"],
        Option(
            "--format",
            help="Output: a table, a file for Fast DDS 2 or 3, Cyclone DDS or ROS 2, "
            "or the topics of a log or domain as a file for this command.",
        ),
    ] = "table",
    output: OutputFolder = None,
    rate_max: Annotated[
        float | None,
        Option(min=0.001, help="Highest rate of any topic, Hz. [default: the file's]"),
    ] = None,
    rmw: Annotated[
        Literal["fastrtps-async", "fastrtps-sync", "cyclone"] | None,
        Option(
            help="ROS 2 middleware and publication mode, with the default timing unless the file "
            "names the same middleware. [default: the file's]"
        ),
    ] = None,
    latency_weight: Annotated[
        float | None,
        Option(
            min=0.0,
            max=1e6,
            help="Weight of latency in the objective, Hz. "
            "[default: the one that keeps most readers up to date]",
        ),
    ] = None,
    pareto: Annotated[
        bool, Option("--pareto", help="Print the Pareto front, one line per latency weight.")
    ] = False,
    domain: RecordedDomain = None,
    duration: ObservedTime = 5.0,
    interface: Interface = None,
    as_json: Json = False,
) -> None:
    """Plan the rate, history depth and deadline of each topic on a shared wireless link (paper B).

    The model is for samples that fit into one frame and for links that lose up to 10 % of the frames. A
    warning names topics outside these limits.

    Examples:
      sfglab qos data/qos/paper_b.yaml
      sfglab qos data/qos/paper_b.yaml --method paper --rate-max 500
      sfglab qos data/qos/paper_b.yaml --rmw fastrtps-async
      sfglab qos data/qos/paper_b.yaml --pareto   # latency and freshness.
      sfglab qos data/qos/paper_b.yaml --format fastdds --output config
      sfglab qos data/qos/warehouse.yaml --format cyclone --output config
      sfglab qos bag/ --format topics --output config   # set the link in topics.yaml.
      sfglab qos --domain 7 --duration 20 --format topics --output config
    """
    from sfglab.arp import plan_as_printed, plan_file
    from sfglab.arp.exports import EXPORTS
    from sfglab.arp.recorded import topics_text
    from sfglab.rtps import PRESETS

    source = file or Path("the domain")
    with opened(file, (domain, interface), duration) as found:
        given = _topics_of(found)
    if not given.topics:
        raise SfglabError(
            f"{source}: no topic goes from one host to another; record nodes of several hosts"
        )
    lowered = [topic.name for topic in given.topics if topic.rate_min_hz > (rate_max or math.inf)]
    _warn("--rate-max is below the file's rate_min_hz", lowered)
    given = given.limited_to(rate_max)
    vendor = PRESETS[_PRESET_OF[rmw]] if rmw else given.vendor
    if vendor.name != given.vendor.name:
        given = replace(given, vendor=vendor)
    if format_ == "topics":
        why = "with --format topics, which plans nothing"
        unused(why, "method", "pareto", "latency_weight", "as_json")
        if isinstance(found, Path):
            raise SfglabError(f"--format topics: given {file}, allowed: a log, a bag or --domain")
        write_text(topics_text(given.topics, source.name), output and Path("topics.yaml"), output)
        return
    _warn_of_validity(given)
    if pareto:
        reason = "with --pareto, which prints all latency weights"
        unused(reason, "method", "format_", "output", "latency_weight", "as_json")
        typer.echo(_front_text(given))
        return
    export = EXPORTS.get(format_)
    if export and not export.suits(given.vendor):
        allowed = f"a format for {given.vendor.name}; --rmw chooses another middleware"
        raise InvalidValueError("--format", format_, allowed)
    if method == "paper":
        unused("with --method paper, which has no latency weight", "latency_weight")
        plan = plan_as_printed(given)
        outside = [
            part.topic.name
            for part in plan.topics
            if not part.topic.rate_min_hz <= part.rate_hz <= part.topic.rate_max_hz
        ]
        _warn("--method paper has no limits per topic; outside rate_min_hz or rate_max_hz", outside)
    else:
        plan = plan_file(given, latency_price_hz=latency_weight)
    if as_json:
        unused("with --json", "format_", "output")
        values = to_json(plan)
        for part, found in zip(plan.topics, values["topics"], strict=True):
            found["deadline_ns"] = part.deadline_ns
        print_json(values)
        return
    text = export.text(plan) if export else _plan_text(plan)
    name = export.file if export else "qos.txt"
    write_text(text, output and Path(name), output)


def _topics_of(found: LogReader | Path) -> TopicFile:
    """Return the topics of a log or of a file of topics."""
    from sfglab.arp import TopicFile, load_topics
    from sfglab.arp.recorded import topics_from_log

    if isinstance(found, Path):
        return load_topics(found)
    topics, left_out = topics_from_log(found)
    print_left_out(left_out)
    agents = {topic.source for topic in topics}
    return TopicFile(topics=topics, agents=tuple(sorted(agents)))


def _warn(about: str, topics: list[str]) -> None:
    """Print a warning about topics on standard error, if there are any topics."""
    if topics:
        typer.echo(f"warning: {about}: {', '.join(topics)}", err=True)


def _warn_of_validity(given: TopicFile) -> None:
    """Print a warning about topics for which the model of the link is not valid."""
    from sfglab.arp.link import frames_of, loss_of

    large = [topic.name for topic in given.topics if frames_of(topic) > 1]
    _warn("samples above one frame are planned as IP fragments (Cyclone DDS has its own)", large)
    lossy = [topic.name for topic in given.topics if loss_of(topic, given.medium) > _LOSS_MOST]
    _warn(f"the model of latencies is for losses up to {_LOSS_MOST:.0%}", lossy)


def _plan_text(plan: Plan) -> str:
    rows = [("topic", "rate Hz", "depth", "deadline ms", "latency ms", "lost %", "up to date %")]
    for part in plan.topics:
        deadline_ns = part.deadline_ns
        row = (
            part.topic.name,
            f"{part.rate_hz:.2f}",
            str(part.depth),
            "none" if deadline_ns is None else f"{deadline_ns / NS_PER_MS:.1f}",
            f"{1e3 * part.latency_s:.2f}",
            f"{100 * part.loss:.3f}",
            f"{100 * part.up_to_date:.1f}",
        )
        rows.append(row)
    medium = plan.medium
    latency = f"{1e3 * plan.latency_s:.2f} ms"
    if plan.latency_s == math.inf:
        latency = "without bound"
    lines = [
        *columns(rows, right=range(1, 7)),
        "",
        f"{plan.vendor.name}, {medium.rate_bps / 1e6:g} Mbit/s, {100 * medium.loss:g} % loss",
        f"channel utilisation {100 * plan.utilisation:.0f} %, expected latency {latency}",
        f"readers up to date {100 * plan.up_to_date:.1f} % of the time",
    ]
    if plan.utilisation >= 1:
        lines.append("the channel is overloaded: queues grow without bound, then samples are lost")
    return "\n".join(lines) + "\n"


def _front_text(given: TopicFile) -> str:
    from sfglab.arp import pareto_front

    head = "latency weight Hz, freshness %, latency ms, up to date %, utilisation %"
    rows = [tuple(head.split(", "))]
    for plan in pareto_front(given):
        row = (
            f"{plan.latency_price_hz:.2f}",
            f"{100 * plan.freshness:.2f}",
            f"{1e3 * plan.latency_s:.3f}",
            f"{100 * plan.up_to_date:.2f}",
            f"{100 * plan.utilisation:.1f}",
        )
        rows.append(row)
    return "\n".join(columns(rows, right=range(5)))

"""The command that plans QoS: rates, depths and deadlines from a file of topics."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from sfglab.arp import Plan, TopicFile, TopicPlan


class _Format(StrEnum):
    TABLE = "table"
    FASTDDS = "fastdds"
    FASTDDS3 = "fastdds3"
    CYCLONE = "cyclone"
    ROS2 = "ros2"


class _Method(StrEnum):
    OURS = "ours"
    PRINTED = "printed"


class _Vendor(StrEnum):
    FAST_DDS = "fast_dds"
    CYCLONE_DDS = "cyclone_dds"


def qos(
    file: Annotated[Path, typer.Argument(help="A file of topics, e.g. data/qos/paper_b.yaml")],
    method: Annotated[
        _Method, typer.Option(help="ours: a convex programme that sees the link. printed: paper B, Eq. 1 to 6.")
    ] = _Method.OURS,
    output_format: Annotated[
        _Format,
        typer.Option("--format", help="A table, or a file that Fast DDS 2 or 3, Cyclone DDS or ROS 2 reads."),
    ] = _Format.TABLE,
    out: Annotated[
        Path | None, typer.Option(help="Write the file into this folder, not to the terminal.")
    ] = None,
    rate_max: Annotated[float | None, typer.Option(min=0.001, help="No topic faster than this, Hz.")] = None,
    vendor: Annotated[
        _Vendor | None, typer.Option(help="Another DDS than the file's, with its defaults.")
    ] = None,
    latency_price: Annotated[
        float | None,
        typer.Option(min=0.0, help="What a second of latency costs; else the front's most up-to-date point."),
    ] = None,
    front: Annotated[
        bool, typer.Option("--front", help="Show the Pareto front, one line for each price of latency.")
    ] = False,
) -> None:
    """Say how often each topic should be sent, how deep its history and how long its deadline should be.

    Examples:

      sfglab qos data/qos/paper_b.yaml

      sfglab qos data/qos/paper_b.yaml --method printed --rate-max 500

      sfglab qos data/qos/paper_b.yaml --front

      sfglab qos data/qos/paper_b.yaml --format fastdds --out config

      sfglab qos data/qos/warehouse.yaml --format cyclone --out config
    """
    from dataclasses import replace

    from sfglab.arp import load_topics
    from sfglab.arp.exports import EXPORTS
    from sfglab.rtps import PRESETS

    given = load_topics(file).limited_to(rate_max)
    if vendor is not None and PRESETS[vendor.value].name != given.vendor.name:
        given = replace(given, vendor=PRESETS[vendor.value])
    if front:
        typer.echo(_front_table(given))
        return
    plan = _plan(given, method, latency_price)
    if output_format is _Format.TABLE:
        _put(_plan_table(plan), "qos.txt", out)
    else:
        export = EXPORTS[output_format.value]
        _put(export.render(plan), export.file, out)


def add_to(app: typer.Typer) -> None:
    """Add the command to the program."""
    app.command()(qos)


def _plan(given: TopicFile, method: _Method, latency_price: float | None) -> Plan:
    from sfglab.arp import plan_as_printed, plan_file

    if method is _Method.PRINTED:
        return plan_as_printed(given)
    return plan_file(given, latency_price_hz=latency_price)


def _put(text: str, name: str, folder: Path | None) -> None:
    if folder is None:
        typer.echo(text, nl=False)
        return
    try:
        folder.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(text, encoding="utf-8")
    except OSError as error:
        raise SfglabError(f"--out: given {folder}, needed is a folder that can be written ({error})") from error
    typer.echo(folder / name)


def _plan_table(plan: Plan) -> str:
    width = max(len("topic"), *(len(part.topic.name) for part in plan.topics))
    lines = [f"{'topic':{width}}  rate Hz  depth  deadline ms  latency ms  lost %  up to date %"]
    lines += [
        f"{part.topic.name:{width}}  {part.rate_hz:7.2f}  {part.depth:5d}  {_deadline_ms(part):>11}  "
        f"{1e3 * part.latency_s:10.2f}  {100 * part.loss:6.3f}  {100 * part.up_to_date:12.1f}"
        for part in plan.topics
    ]
    lines += [
        "",
        f"{plan.vendor.name}, {plan.medium.rate_bps / 1e6:g} Mbit/s, {100 * plan.medium.loss:g} % loss",
        f"taken of the medium's time {100 * plan.utilisation:.0f} %, expected latency {_ms(plan.latency_s)}",
        f"readers up to date {100 * plan.up_to_date:.1f} % of the time",
    ]
    if plan.utilisation >= 1:
        lines.append("the medium is overloaded: queues grow without end, and what they cannot hold is lost")
    return "\n".join(lines) + "\n"


def _deadline_ms(part: TopicPlan) -> str:
    return "none" if part.deadline_ns is None else f"{part.deadline_ns / 1e6:.1f}"


def _ms(seconds: float) -> str:
    return f"{1e3 * seconds:.2f} ms" if seconds < float("inf") else "without bound"


def _front_table(given: TopicFile) -> str:
    from sfglab.arp import Limits, pareto_front

    limits = Limits(utilisation_max=given.utilisation_max, residual_loss=given.residual_loss)
    points = pareto_front(given.topics, given.medium, given.vendor, limits=limits)
    lines = ["price Hz  freshness %  latency ms  up to date %  medium taken %  price of airtime"]
    lines += [
        f"{point.latency_price_hz:8.2f}  {100 * point.freshness:11.2f}  {1e3 * point.latency_s:10.3f}  "
        f"{100 * point.up_to_date:12.2f}  {100 * point.utilisation:14.1f}  {point.airtime_price:16.4f}"
        for point in points
    ]
    return "\n".join(lines)

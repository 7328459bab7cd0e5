"""Commands for motion capture and TF trees: ``sfglab mocap`` and ``sfglab frames``."""

from __future__ import annotations

import asyncio
import math
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from typer import Argument, Option

from sfglab.cli.buses import observed_domain, on_node, say, until_interrupted, unused
from sfglab.cli.options import Domain, Duration, Interface, Json, ObservedTime, RecordedDomain
from sfglab.errors import InvalidValueError, SfglabError

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from sfglab.bus import Clock, Node
    from sfglab.spatial.frames.listener import TransformIntake
    from sfglab.spatial.mocap.bridge import BridgeCore, ObjectStatus
    from sfglab.spatial.mocap.mapping import MocapMapping
    from sfglab.spatial.mocap.tracking import MocapSource

mocap_app = typer.Typer(
    help="""Publish poses from motion capture as TF.

Example:
  sfglab mocap run data/mocap/two_agents.yaml --synthetic --publish-tf --domain 7"""
)
frames_app = typer.Typer(
    help="""Check TF trees.

Example:
  sfglab frames lint data/reference/mocap.mcap"""
)


@mocap_app.command("run")
def mocap_run(
    file: Annotated[
        Path,
        Argument(
            metavar="MAPPING",
            help="Mapping of objects to TF frames, e.g. data/mocap/two_agents.yaml.",
        ),
    ],
    domain: Domain = 0,
    interface: Interface = None,
    vicon: Annotated[str | None, Option(help="Address of a Vicon Tracker.")] = None,
    topic: Annotated[
        list[str] | None,
        Option(help="Topic with the poses of an object, as ID=/topic (repeatable)."),
    ] = None,
    type_: Annotated[
        Literal["pose", "transform"],
        Option(
            "--type", help="Type of the topics: PoseStamped (pose) or TransformStamped (transform)."
        ),
    ] = "pose",
    log: Annotated[Path | None, Option(help="Log or bag to read the topics from.")] = None,
    synthetic: Annotated[
        bool, Option("--synthetic", help="Simulate objects on ellipses, without cameras.")
    ] = False,
    publish_tf: Annotated[
        bool,
        Option(
            "--publish-tf", help="Also publish a TF tree for each object in place of its robot."
        ),
    ] = False,
    agent: Annotated[
        str, Option(help="Name of the agent for the status topic. [default: none]")
    ] = "",
    duration: Duration = None,
) -> None:
    """Publish the poses of agents from motion capture as TF (paper A, Eq. 4).

    Give one source: --vicon, --topic, --log with --topic, or --synthetic.

    Examples:
      sfglab mocap run data/mocap/two_agents.yaml --vicon 192.168.10.1 --domain 0   # a Vicon Tracker.
      sfglab mocap run data/mocap/two_agents.yaml --topic "Go2 Body=/vrpn/go2/pose" --domain 0   # a topic.
      sfglab mocap run data/mocap/two_agents.yaml --log run.mcap --topic "Go2 Body=/vrpn/go2/pose" --domain 7
      sfglab mocap run data/mocap/two_agents.yaml --synthetic --publish-tf --domain 7 --interface lo --duration 10
    """
    from sfglab.record import LogReader
    from sfglab.spatial.mocap.bridge import MocapBridge, status_topic
    from sfglab.spatial.mocap.mapping import load_mapping
    from sfglab.spatial.mocap.sources import POSE, TRANSFORM, LogSource, TopicSource, ViconSource

    mapping = load_mapping(file)
    if log is not None or not topic:
        unused("without topics of a domain, because only they have a type to choose", "type_")
    topics = _topics(topic or [], mapping)
    if [bool(vicon), bool(topic), synthetic].count(True) != 1 or (log and not topic):
        raise SfglabError(
            "source: give exactly one of --vicon, --topic, --log with --topic, --synthetic"
        )

    async def serve(node: Node) -> None:
        clock = node.get_clock()
        source: MocapSource
        with ExitStack() as stack:
            if vicon is not None:
                source = ViconSource(vicon, clock=clock)
            elif synthetic:
                source = _synthetic(mapping, clock)
            elif log is not None:
                reader = stack.enter_context(LogReader(log))
                source = LogSource(reader, topics, clock)
            else:
                source = TopicSource(node, topics, POSE if type_ == "pose" else TRANSFORM)
            if publish_tf:
                _publish_trees(node, mapping)
            bridge = MocapBridge(node, source, mapping, agent=agent)
            typer.echo(f"mocap: ready, status on {status_topic(agent)}; end it with Ctrl-C")
            try:
                await bridge.run()
            finally:
                typer.echo(_report(bridge.core))

    until_interrupted((domain, interface), serve, "mocap_bridge", duration_s=duration)


def _topics(given: list[str], mapping: MocapMapping) -> dict[str, str]:
    """Return the topic of each object from words of the form ID=/topic."""
    topics = {}
    for word in given:
        id_, _, topic = word.rpartition("=")
        if id_ not in mapping.objects:
            allowed = [f"{name}=/topic" for name in mapping.objects]
            raise InvalidValueError("--topic", word, ", ".join(allowed))
        topics[id_] = topic
    return topics


def _synthetic(mapping: MocapMapping, clock: Clock) -> MocapSource:
    import numpy as np

    from sfglab.spatial.mocap.synthetic import (
        SyntheticConfig,
        SyntheticMotion,
        SyntheticSource,
        synthetic_captures,
    )

    objects = {}
    for number, id_ in enumerate(mapping.objects):
        objects[id_] = SyntheticMotion(centre_m=(0.0, 3.0 * number, 0.5))
    config = SyntheticConfig(occlusions_hz=0.1, dropped=0.01)
    rng = np.random.default_rng(0)
    captures = synthetic_captures(objects, config, rng, start_ns=clock.now_ns())
    return SyntheticSource(captures, clock)


def _publish_trees(node: Node, mapping: MocapMapping) -> None:
    """Publish the smallest TF trees that objects can be placed in: a root and the detected frame."""
    from sfglab.messages import message_type
    from sfglab.names import TF_STATIC
    from sfglab.spatial import Pose, StampedTransform
    from sfglab.spatial.frames.listener import TF_STATIC_QOS, TRANSFORMS

    above = Pose(position_m=(0.0, 0.0, 0.1))
    transforms = []
    for mapped in mapping.objects.values():
        root = mapped.frame or f"{mapped.via.partition('/')[0]}/odom"
        if root != mapped.via:
            tree = StampedTransform(parent=root, child=mapped.via, stamp_ns=0, pose=above)
            transforms.append(tree.to_msg())
    publisher = node.create_publisher(TRANSFORMS, TF_STATIC, qos=TF_STATIC_QOS)
    publisher.publish(message_type(TRANSFORMS)(transforms=transforms))


def _report(core: BridgeCore) -> str:
    unmapped = [f"{id_} ({count})" for id_, count in core.unmapped.items()]
    counts = f"{core.captures} captures, {core.dropped} dropped"
    head = f"{counts}; unmapped objects: {', '.join(unmapped) or 'none'}"
    return "\n".join([head, *map(_object_line, core.statuses)])


def _object_line(status: ObjectStatus) -> str:
    counts = {verdict.value: count for verdict, count in status.verdicts.items()}
    verdicts = [f"{count} {verdict}" for verdict, count in sorted(counts.items())]
    latency = "-" if math.isnan(status.latency_s) else f"{1e3 * status.latency_s:.2f}"
    return (
        f"{status.mapped.id} -> {status.frame or 'nothing yet'}: {status.track.state.value}, "
        f"{status.published} published, {status.unplaced} not placed "
        f"({', '.join(verdicts) or 'never detected'}); "
        f"capture to receipt {latency} ms  {status.problem}"
    ).rstrip()


@frames_app.command("lint")
def frames_lint(
    log: Annotated[
        Path | None, Argument(metavar="LOG", help="Log or bag. [default: a domain]")
    ] = None,
    domain: RecordedDomain = None,
    interface: Interface = None,
    duration: ObservedTime = 5.0,
    agent: Annotated[
        list[str] | None,
        Option(help="Agent whose frame prefix is allowed (repeatable). [default: any]"),
    ] = None,
    root_frame: Annotated[
        str | None, Option(help="Required single root, e.g. map. [default: any]")
    ] = None,
    as_json: Json = False,
) -> None:
    """Check a TF tree for several parents, loops, several roots, wrong names and wrong stamps.

    Transforms that tf2 ignores are findings as well. The exit status is 1 if there are findings or no frames.

    Examples:
      sfglab frames lint run.mcap --root-frame map --agent go2 --agent agent_x
      sfglab frames lint --domain 0 --duration 10
    """
    from sfglab.record import LogReader
    from sfglab.spatial.frames.buffer import FrameBuffer
    from sfglab.spatial.frames.lint import lint_frames
    from sfglab.spatial.frames.listener import FramesListener, fill_from_log, namespaced_topics

    buffer = FrameBuffer(history_s=None)
    observed = observed_domain(log, domain)

    async def observe(node: Node) -> tuple[TransformIntake, Mapping[str, Sequence[str]]]:
        async with FramesListener(node, buffer) as listener:
            await asyncio.sleep(duration)
            return listener, node.graph.topics()

    if log is None:
        intake, types = on_node((observed, interface), observe, "frames_lint")
    else:
        unused("with a log, because only a domain is observed", "interface", "duration")
        with LogReader(log) as reader:
            intake = fill_from_log(reader, buffer)
            types = {topic: (info.type_name,) for topic, info in reader.topics.items()}
    findings = lint_frames(
        buffer.edges,
        agents=agent or (),
        root=root_frame,
        refused=intake.refused,
        namespaced=namespaced_topics(types),
    )
    lines = [*map(str, findings), f"{len(buffer.frames)} frames, {len(findings)} findings"]
    values = {"frames": sorted(buffer.frames), "findings": findings}
    say(values, "\n".join(lines), as_json=as_json)
    if findings or not buffer.frames:
        raise typer.Exit(1)

"""Commands for motion capture and for trees of frames: ``sfglab mocap``, ``sfglab frames``."""

from __future__ import annotations

import asyncio
import contextlib
import os
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer
from typer import Argument, Option

from sfglab.cli.buses import Json, domain_option, on_node, say, unused
from sfglab.cli.removed import RenamedOptions
from sfglab.component import on_stop
from sfglab.domains import VARIABLE
from sfglab.errors import SfglabError

if TYPE_CHECKING:
    from sfglab.bus import Node
    from sfglab.spatial.mocap.bridge import BridgeCore, MocapObjectStatus
    from sfglab.spatial.mocap.mapping import MocapMapping
    from sfglab.spatial.mocap.tracking import MocapSource

mocap_app = typer.Typer(help="Motion capture: publish detected poses as TF.", no_args_is_help=True)
frames_app = typer.Typer(help="Trees of frames.", no_args_is_help=True)
for _single in (mocap_app, frames_app):
    _single.callback()(lambda: None)  # with a single command typer would leave its name out
_POSES = ("geometry_msgs/msg/PoseStamped", "geometry_msgs/msg/TransformStamped")
_Type = Literal["pose", "transform"]


@mocap_app.command("run", cls=RenamedOptions)
def mocap_run(
    file: Annotated[
        Path, Argument(help="Which object is which frame, e.g. data/mocap/two_agents.yaml")
    ],
    domain: Annotated[int | None, domain_option("DDS domain of the agents' transforms.")] = None,
    interface: Annotated[str | None, Option(help="Interface of that domain.")] = None,
    vicon: Annotated[str | None, Option(help="Address of a Vicon Tracker.")] = None,
    topic: Annotated[
        list[str] | None, Option(help="An object's topic, ID=/topic; of the log if there is one.")
    ] = None,
    type_: Annotated[_Type, Option("--type", help="PoseStamped or TransformStamped.")] = "pose",
    log: Annotated[Path | None, Option(help="A log whose --topic are played back.")] = None,
    synthetic: Annotated[
        bool, Option("--synthetic", help="Objects on ellipses, for trials without cameras.")
    ] = False,
    publish_tf: Annotated[
        bool,
        Option(
            "--publish-tf",
            help="Also publish made-up TF trees of the agents, for trials without robots.",
        ),
    ] = False,
    agent: Annotated[str, Option(help="The agent on which it runs, for the status topic.")] = "",
    duration: Annotated[
        float | None, Option(min=0.0, help="Seconds to run; else until Ctrl-C.")
    ] = None,
) -> None:
    """Publish where cameras see agents, so that every agent's tree of frames stays whole (paper A, Eq. 4).

    Examples:
      sfglab mocap run data/mocap/two_agents.yaml --vicon 192.168.10.1 --domain 0
      sfglab mocap run data/mocap/two_agents.yaml --topic "Go2 Body=/vrpn/go2/pose" --domain 0
      sfglab mocap run data/mocap/two_agents.yaml --log run.mcap --topic "Go2 Body=/vrpn/go2/pose" --domain 7
      sfglab mocap run data/mocap/two_agents.yaml --synthetic --publish-tf --domain 7 --interface lo --duration 10
    """
    from sfglab.spatial.mocap.bridge import BridgeOptions, MocapBridge, status_topic
    from sfglab.spatial.mocap.mapping import load_mapping

    mapping = load_mapping(file)
    if log is not None or not topic:
        unused("without topics of the bus, whose type it is", "type_")
    make = _source(
        vicon=vicon, topics=_topics(topic or [], mapping), type_=type_, log=log, synthetic=synthetic
    )

    async def serve(node: Node) -> None:
        with contextlib.ExitStack() as stack:
            if publish_tf:
                _make_up_trees(node, mapping)
            bridge = MocapBridge(
                node, make(node, mapping, stack), mapping, BridgeOptions(agent=agent)
            )
            running = asyncio.ensure_future(bridge.run())
            on_stop(running.cancel)
            typer.echo(f"mocap: ready, status on {status_topic(agent)}; end it with Ctrl-C")
            with contextlib.suppress(asyncio.CancelledError, TimeoutError):
                async with asyncio.timeout(duration):
                    await running
            typer.echo(_report(bridge.core), nl=False)

    on_node((domain, interface), serve, "mocap_bridge")


@frames_app.command("lint")
def frames_lint(
    log: Annotated[Path | None, Argument(help="A log, of any recorder.")] = None,
    domain: Annotated[
        int | None, domain_option("A DDS domain to listen to, without a log.")
    ] = None,
    interface: Annotated[str | None, Option(help="Interface of that domain.")] = None,
    listen: Annotated[float, Option(min=0.1, help="Seconds to listen.")] = 5.0,
    agents: Annotated[str, Option(help="Agents whose prefixes are right, as go2,agent_x.")] = "",
    root: Annotated[str | None, Option(help="The one root that there should be, e.g. map")] = None,
    as_json: Json = False,
) -> None:
    """Say what is wrong with a tree of frames: parents, loops, roots, names, time.

    Exit status 1 if anything is, or if there are no frames.

    Examples:
      sfglab frames lint run.mcap --root map --agents go2,agent_x
      sfglab frames lint --domain 0 --listen 10
    """
    from sfglab.record import LogReader
    from sfglab.spatial.frames.buffer import FrameBuffer
    from sfglab.spatial.frames.lint import FrameRule, lint_frames
    from sfglab.spatial.frames.listener import FramesListener, fill_from_log

    heard = domain is not None or (log is None and VARIABLE in os.environ)
    if (log is not None) == heard:
        raise SfglabError("frames lint: given neither or both, allowed is a log or --domain")
    buffer = FrameBuffer(history_s=None)
    if log is not None:
        unused("with a log, which is on no bus", "interface", "listen")
        with LogReader(log) as reader:
            fill_from_log(reader, buffer)
    else:

        async def hear(node: Node) -> None:
            async with FramesListener(node, buffer):
                await asyncio.sleep(listen)

        on_node((domain, interface), hear, "frames_lint")
    names = frozenset(filter(None, agents.split(",")))
    findings = lint_frames(buffer.edges, rule=FrameRule(agents=names) if names else None, root=root)
    lines = [*map(str, findings), f"{len(buffer.frames)} frames, {len(findings)} findings"]
    say(
        {"frames": sorted(buffer.frames), "findings": findings},
        lambda _: "\n".join(lines),
        as_json=as_json,
    )
    if findings or not buffer.frames:
        raise typer.Exit(1)


def _topics(given: list[str], mapping: MocapMapping) -> dict[str, str]:
    topics = {}
    for text in given:
        id_, equals, topic = text.rpartition("=")
        if not equals or id_ not in mapping.objects:
            known = ", ".join(f"{name}=/topic" for name in mapping.objects)
            raise SfglabError(f"--topic: given {text!r}, allowed are {known}")
        topics[id_] = topic
    return topics


def _source(
    *, vicon: str | None, topics: dict[str, str], type_: _Type, log: Path | None, synthetic: bool
) -> Callable[[Node, MocapMapping, contextlib.ExitStack], MocapSource]:
    """Return what makes the source on a node, of exactly one kind."""
    from sfglab.record import LogReader
    from sfglab.spatial.mocap.sources import LogSource, TopicSource, ViconSource

    kinds = [
        name for name, on in (("--vicon", vicon), ("--log", log), ("--synthetic", synthetic)) if on
    ]
    if len(kinds) > 1 or (not kinds and not topics) or (topics and kinds not in ([], ["--log"])):
        given = " and ".join([*kinds, *(["--topic"] if topics else [])]) or "none"
        allowed = "one of --vicon, --topic, --log with --topic, --synthetic"
        raise SfglabError(f"mocap run: given {given}, allowed is {allowed}")
    if log is not None and not topics:
        needed = "--topic ID=/topic for each object of the log"
        raise SfglabError(f"--log: given without --topic, needed is {needed}")

    def make(node: Node, mapping: MocapMapping, stack: contextlib.ExitStack) -> MocapSource:
        clock = node.get_clock()
        if vicon is not None:
            return ViconSource(vicon, clock=clock)
        if synthetic:
            return _synthetic(mapping, clock)
        if log is None:
            return TopicSource(node, topics, type_=_POSES[type_ == "transform"])
        return LogSource(stack.enter_context(LogReader(log)), topics, clock=clock)

    return make


def _synthetic(mapping: MocapMapping, clock: Any) -> MocapSource:
    import numpy as np

    from sfglab.spatial.mocap.synthetic import SyntheticConfig, SyntheticMotion, SyntheticSource

    objects = {
        id_: SyntheticMotion(centre_m=(0.0, 3.0 * i, 0.5)) for i, id_ in enumerate(mapping.objects)
    }
    config = SyntheticConfig(occlusions_hz=0.1, flips_hz=0.1, dropped=0.01)
    return SyntheticSource(objects, config, np.random.default_rng(0), clock=clock)


def _make_up_trees(node: Node, mapping: MocapMapping) -> None:
    """Publish the shortest trees that objects can be placed in: a root and, above it, what the cameras see."""
    from sfglab.messages import message_type
    from sfglab.names import TF_STATIC
    from sfglab.spatial import Pose, StampedTransform
    from sfglab.spatial.frames.listener import TF_STATIC_QOS, TRANSFORMS

    above = Pose(position_m=(0.0, 0.0, 0.1))
    roots = {
        one.via: one.frame or f"{one.via.partition('/')[0]}/odom"
        for one in mapping.objects.values()
    }
    transforms = [
        StampedTransform(parent=root, child=via, stamp_ns=0, pose=above).to_msg()
        for via, root in roots.items()
        if root != via
    ]
    publisher = node.create_publisher(TRANSFORMS, TF_STATIC, qos=TF_STATIC_QOS)
    publisher.publish(message_type(TRANSFORMS)(transforms=transforms))


def _report(core: BridgeCore) -> str:
    strangers = ", ".join(f"{id_} ({count})" for id_, count in core.unmapped.items()) or "none"
    lines = [
        f"{core.captures} captures, {core.dropped} dropped; objects without mapping: {strangers}"
    ]
    return "\n".join([*lines, *map(_object_line, core.statuses)]) + "\n"


def _object_line(status: MocapObjectStatus) -> str:
    sights = (
        ", ".join(f"{n} {verdict}" for verdict, n in sorted(status.verdicts.items()))
        or "never seen"
    )
    late = [status.receipt_latency.median_ns, status.publication_latency.median_ns]
    times = " + ".join("-" if ns is None else f"{ns / 1e6:.2f}" for ns in late)
    problem = f"; {status.problem}" if status.problem else ""
    return (
        f"{status.mapped.id} -> {status.frame or 'nothing yet'}: {status.track.state.value}, "
        f"{status.published} published, {status.unplaced} not placed ({sights}); "
        f"capture to receipt to publication {times} ms{problem}"
    )

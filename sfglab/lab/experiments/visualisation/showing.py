"""The scene shown from a log and from the bus, and what the recordings hold compared with what was said."""

from __future__ import annotations

import asyncio
import sys
from collections import Counter
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus import Node
from sfglab.lab.experiments.visualisation.moments import PERIOD_NS, RECEIVED_AFTER_NS, START_NS
from sfglab.lab.experiments.visualisation.recordings import read_blueprint, read_recording, rows_of
from sfglab.lab.experiments.visualisation.rows import VisualisationCheckRow
from sfglab.processes import LineProcess, ProcessFailedError
from sfglab.qos import DEFAULT
from sfglab.record import LogWriter
from sfglab.view import Session, ViewOptions, view_live, view_log
from sfglab.view.app import session_for

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Iterator
    from pathlib import Path

    from sfglab.fleet.fleet_file import Fleet
    from sfglab.lab.experiments.visualisation.parts import Part, Place
    from sfglab.lab.experiments.visualisation.recordings import Shown

    Recording = dict[tuple[str, str], list[Shown]]


WORKER = "sfglab.lab.workers.sights"
_REACH_S = 10.0
_LATCHED = ("tf_static", "agent_status", "communication")
"""Reliable by themselves, and they ask for the past, too."""

_UNSTAMPED = "visualization_msgs/msg/MarkerArray"
"""Has no header, so its time of capture is that of its reception."""

_TOLERANCE = 1e-5
"""Relative, of single against double precision."""


def write_scene(parts: tuple[Part, ...], path: Path) -> None:
    """Write the scene's messages as a log, in the order of their stamps."""
    moments = max(len(part.messages) for part in parts)
    with LogWriter(path) as log:
        for number in range(moments):
            at_ns = START_NS + number * PERIOD_NS + RECEIVED_AFTER_NS
            for part in parts:
                if part.messages[number] is not None:
                    log.write(part.topic, part.messages[number], log_time_ns=at_ns)


def show_log(scene: Path, to: Path, fleet: Path) -> Recording:
    """Show the scene from its log, into a file, and read that."""
    view_log(scene, ViewOptions(to=(str(to),), fleet=fleet))
    return read_recording(to)


@asynccontextmanager
async def process(role: str, *arguments: str) -> AsyncIterator[LineProcess]:
    """Run a worker that ends with the block."""
    worker = await LineProcess.start(role, [sys.executable, "-m", WORKER, role, *arguments])
    try:
        yield worker
    finally:
        await worker.close()


async def show_live(parts: tuple[Part, ...], scene: Path, to: Path, domain_id: int) -> Recording:
    """Show the scene while another process sends it over DDS, into a file, and read that.

    The next moment is sent when the last one has been drawn, and everything is reliable: whether all arrives in
    time on a busy machine is another question.
    """
    session = _reliable_session(parts)
    async with (
        Node("view", domain_id=domain_id, interface="lo") as node,
        process("scene", str(domain_id), str(scene)) as worker,
    ):
        viewing = asyncio.create_task(view_live(node, ViewOptions(to=(str(to),)), session=session))
        try:
            moments = (await worker.expect("ready", timeout_s=3 * _REACH_S))["moments"]
            sent: Counter[str] = Counter()
            for _ in range(moments):
                worker.order(do="next")
                sent.update((await worker.expect("sent", timeout_s=_REACH_S))["topics"])
                await _drawn(session, sent)
        finally:
            viewing.cancel()
            await asyncio.gather(viewing, return_exceptions=True)
    return read_recording(to)


def _reliable_session(parts: tuple[Part, ...]) -> Session:
    session = session_for({part.topic: part.type for part in parts}, ViewOptions())
    for display in session.displays:
        session.limit(display.id, None)
        if display.visualizer.name not in _LATCHED:
            session.rewire(display.id, qos=dict.fromkeys(display.visualizer.topics, DEFAULT))
    return session


async def _drawn(session: Session, sent: Counter[str]) -> None:
    """Wait until every display has what was sent of its topics.

    Raises:
        ProcessFailedError: It did not arrive.
    """
    missing = "nothing"
    for _ in range(round(_REACH_S / 0.01)):
        counts = [(d, d.slot.counts) for d in session.displays]
        late = [d for d, c in counts if c.received < sum(sent[t] for t in d.visualizer.topics.values())]
        if not late and not any(len(d.slot) for d, _ in counts):
            return
        missing = ", ".join(d.id for d in late) or "drawing"
        await asyncio.sleep(0.01)
    raise ProcessFailedError(f"scene: within {_REACH_S:g} s there is still missing: {missing}")


def check_visualizers(parts: tuple[Part, ...], recording: Recording) -> Iterator[VisualisationCheckRow]:
    """Compare what a recording holds with what every part of the scene expects of it."""
    for part in parts:
        if part.kind == "communication":
            yield _check_communication(recording)
        elif part.place is not None:
            yield _check_part(part, part.place, recording)


def _check_part(part: Part, place: Place, recording: Recording) -> VisualisationCheckRow:
    shown = recording.get((place.entity, place.component), [])
    expected = [(number, values) for number, values in enumerate(part.expected)]
    held = sum(any(_is(s, number, values, part) for s in shown) for number, values in expected)
    told = f"{place.entity} {place.component}: {len(shown)} shown"
    return VisualisationCheckRow(
        group="visualizers",
        check=f"{part.kind}: each message's content at its entity, component and times",
        checked=len(expected) + 1,
        held=held + (len(shown) == len(expected)),
        example=told,
    )


def _is(shown: Shown, number: int, values: Any, part: Part) -> bool:
    """Return whether something shown is what a message of this number said, at its times."""
    if part.place is not None and part.place.is_timeless:
        return shown.capture_ns is None and _equal(shown.content, values)
    stamp_ns = START_NS + number * PERIOD_NS
    capture_ns = stamp_ns + RECEIVED_AFTER_NS * (part.type == _UNSTAMPED)
    times = (capture_ns, stamp_ns + RECEIVED_AFTER_NS)
    return (shown.capture_ns, shown.received_ns) == times and _equal(shown.content, values)


def _equal(found: Any, expected: Any) -> bool:
    if isinstance(found, list) or isinstance(expected, list):
        return list(found) == list(expected)
    if found.shape != np.shape(expected):
        return False
    if found.dtype.kind in "ui":
        return bool(np.array_equal(found, expected))
    return bool(np.allclose(found, expected, rtol=_TOLERANCE, atol=_TOLERANCE))


def _check_communication(recording: Recording) -> VisualisationCheckRow:
    """Of two agents one falls silent: its life ends as lost, the other's as alive; ages and rings are shown."""
    facts = {}
    for agent, life in (("go2", "alive"), ("pi1", "lost")):
        root = f"/agents/{agent}/communication"
        states = recording.get((f"{root}/life", "StateChange:state"), [])
        facts[f"{agent} {life}"] = bool(states) and list(states[-1].content) == [life]
        facts[f"{agent} age"] = len(recording.get((f"{root}/heartbeat_age_s", "Scalars:scalars"), [])) > 1
        facts[f"{agent} ring"] = len(rows_of(recording, f"{root}/ring")) > 1
        facts[f"{agent} decoders"] = bool(rows_of(recording, f"{root}/decoders"))
        facts[f"{agent} drops"] = bool(recording.get((f"{root}/dropped", "Scalars:scalars")))
    facts["border"] = bool(rows_of(recording, "/fleet/border"))
    wrong = [fact for fact, held in facts.items() if not held]
    return VisualisationCheckRow(
        group="visualizers",
        check="communication: life, heartbeat age, decoders, drops, ring and border",
        checked=len(facts),
        held=len(facts) - len(wrong),
        example=", ".join(wrong or facts),
    )


def check_sources(
    parts: tuple[Part, ...], logged: Recording, live: Recording
) -> Iterator[VisualisationCheckRow]:
    """Compare what the log showed with what the same messages showed that another process sent."""
    for part in parts:
        if part.place is None:
            continue
        key = part.place.entity, part.place.component
        first, second = logged.get(key, []), live.get(key, [])
        pairs = list(zip(first, second, strict=False))
        stamped = part.type != _UNSTAMPED
        same = sum(
            _equal(a.content, b.content) and (not stamped or a.capture_ns == b.capture_ns) for a, b in pairs
        )
        yield VisualisationCheckRow(
            group="sources",
            check=f"{part.kind}: from the log and over DDS the same is shown, in the same order",
            checked=max(len(first), len(second), 1),
            held=same,
            example=f"{len(first)} and {len(second)}",
        )


def check_fleet(fleet: Fleet, recorded: Path) -> Iterator[VisualisationCheckRow]:
    """Check that the layout of a recording is that of the fleet file: its agents, and their cameras."""
    from sfglab.view import entity_of_topic

    texts = " ".join(read_blueprint(recorded))
    streams = [(a.name, s.topic) for a in fleet.agents for sensor in a.sensors for s in sensor.streams]
    roots = [_below(agent, topic) for agent, topic in streams]
    yield _found("a view for every stream that the fleet file announces", roots, texts)
    ages = [f"/agents/{agent.name}/communication/heartbeat_age_s" for agent in fleet.agents]
    yield _found("a curve of the heartbeats of every agent of the fleet file", ages, texts)
    said = [(agent.name, topic.name) for agent in fleet.agents for topic in agent.publishes]
    named = [(agent, name) for agent, name in said if name.split("/")[2:3] == [agent]]
    wrong = [name for agent, name in named if entity_of_topic(name) != _below(agent, name)]
    yield VisualisationCheckRow(
        group="fleet",
        check="every topic of an agent stands below the agent's root",
        checked=len(named),
        held=len(named) - len(wrong),
        example=", ".join(wrong) or _below(*named[0]),
    )


def _below(agent: str, topic: str) -> str:
    """Return the entity of an agent's topic: ``/<scope>/<agent>/x`` is ``/agents/<agent>/<scope>/x``."""
    _, scope, _, *rest = topic.split("/")
    return "/".join(("/agents", agent, scope, *rest))


def _found(check: str, wanted: list[str], texts: str) -> VisualisationCheckRow:
    missing = [entity for entity in wanted if entity not in texts]
    return VisualisationCheckRow(
        group="fleet",
        check=check,
        checked=len(wanted),
        held=len(wanted) - len(missing),
        example=", ".join(missing) or wanted[0],
    )

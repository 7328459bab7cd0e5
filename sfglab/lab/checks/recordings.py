"""Checks of recordings: what a ``.rrd`` file shows, by Rerun's own reader, beside what a fleet said."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.checks import CheckRow, facts_row
from sfglab.lab.checks.fleet_scene import PERIOD_NS, RECEIVED_AFTER_NS, START_NS, Part, entity_below

if TYPE_CHECKING:
    from collections.abc import Iterator
    from pathlib import Path

    from numpy.typing import NDArray

    from sfglab.fleet.fleet_file import Fleet

Recording = dict[tuple[str, str], list["Shown"]]
_UNSTAMPED = "visualization_msgs/msg/MarkerArray"  #: No header: captured when received.
_TOLERANCE = 1e-5  #: Relative, of single against double precision.


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """One component at one entity and time."""

    #: On the timeline of the senders' stamps; None for what holds at all times.
    capture_ns: int | None
    received_ns: int | None  #: On that of this host; None likewise.
    #: Numbers of whatever nesting as a flat array; texts as a list.
    content: NDArray[Any] | list[str]


def read_recording(path: Path) -> Recording:
    """Return what a recording shows, by entity and component, in the order of reception."""
    from rerun.chunk import RrdReader

    found: Recording = {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if ":" in name:
                found.setdefault((chunk.entity_path, name), []).extend(_column(batch, name))
    for rows in found.values():
        rows.sort(key=lambda shown: shown.received_ns or 0)
    return found


def rows_of(recording: Recording, entity: str) -> list[Shown]:
    """Return everything at an entity."""
    return [shown for (at, _), rows in recording.items() if at == entity for shown in rows]


def read_blueprint(path: Path) -> list[str]:
    """Return the texts of a recording's blueprint: the names, origins and contents of its views."""
    from rerun.chunk import RrdReader

    reader = RrdReader(path)
    texts = []
    for store in reader.blueprints():
        for chunk in reader.stream(store=store).to_chunks():
            batch = chunk.to_record_batch()
            for name in batch.schema.names:
                if name.startswith(("ViewBlueprint:", "ViewContents:")):
                    texts += [
                        str(text)
                        for values in batch.column(name).to_pylist()
                        for text in values or ()
                    ]
    return texts


def _column(batch: Any, name: str) -> list[Shown]:
    captures, receptions = (_times(batch, timeline) for timeline in ("capture", "received"))
    column = batch.column(name)
    return [
        Shown(capture_ns=captures[row], received_ns=receptions[row], content=_flat(column[row]))
        for row in range(batch.num_rows)
        if column[row].is_valid and len(column[row])
    ]


def _times(batch: Any, timeline: str) -> list[int | None]:
    if timeline not in batch.schema.names:
        return [None] * batch.num_rows
    return [scalar.value for scalar in batch.column(timeline)]


def _flat(scalar: Any) -> NDArray[Any] | list[str]:
    values = scalar.values
    while hasattr(values, "flatten") and "list" in str(values.type):
        values = values.flatten()
    if "string" in str(values.type) or "struct" in str(values.type):
        return [str(value) for value in values.to_pylist()]
    return np.asarray(values.to_numpy(zero_copy_only=False))


def check_visualizers(parts: tuple[Part, ...], recording: Recording) -> Iterator[CheckRow]:
    """Compare what a recording holds with what every part of the scene expects of it."""
    for part in parts:
        if part.kind == "communication":
            yield _check_communication(recording)
        elif part.expected:
            yield _check_part(part, recording)


def _check_part(part: Part, recording: Recording) -> CheckRow:
    shown = recording.get(part.place, [])
    held = sum(
        any(_is(s, number, values, part) for s in shown)
        for number, values in enumerate(part.expected)
    )
    return CheckRow(
        check=f"{part.kind}: each message's content at its entity, component and times",
        checked=len(part.expected) + 1,
        held=held + (len(shown) == len(part.expected)),
        example=f"{' '.join(part.place)}: {len(shown)} shown",
    )


def _is(shown: Shown, number: int, values: Any, part: Part) -> bool:
    """Return whether something shown is what a message of this number said, at its times."""
    if part.is_timeless:
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


def _check_communication(recording: Recording) -> CheckRow:
    """Of two agents one falls silent: its life ends as lost, the other's as alive; ages and rings are shown."""
    facts = {}
    for agent, life in (("go2", "alive"), ("pi1", "lost")):
        root = f"/agents/{agent}/communication"
        states = recording.get((f"{root}/life", "StateChange:state"), [])
        facts[f"{agent} {life}"] = bool(states) and list(states[-1].content) == [life]
        facts[f"{agent} age"] = (
            len(recording.get((f"{root}/heartbeat_age_s", "Scalars:scalars"), [])) > 1
        )
        facts[f"{agent} ring"] = len(rows_of(recording, f"{root}/ring")) > 1
        facts[f"{agent} decoders"] = bool(rows_of(recording, f"{root}/decoders"))
        facts[f"{agent} drops"] = bool(recording.get((f"{root}/dropped", "Scalars:scalars")))
    facts["border"] = bool(rows_of(recording, "/fleet/border"))
    return facts_row("communication: life, heartbeat age, decoders, drops, ring and border", facts)


def check_sources(
    parts: tuple[Part, ...], logged: Recording, live: Recording
) -> Iterator[CheckRow]:
    """Compare what the log showed with what the same messages showed that another process sent."""
    for part in parts:
        if not part.expected:
            continue
        first, second = logged.get(part.place, []), live.get(part.place, [])
        stamped = part.type != _UNSTAMPED
        same = sum(
            _equal(a.content, b.content) and (not stamped or a.capture_ns == b.capture_ns)
            for a, b in zip(first, second, strict=False)
        )
        yield CheckRow(
            check=f"{part.kind}: from the log and over DDS the same is shown, in the same order",
            checked=max(len(first), len(second), 1),
            held=same,
            example=f"{len(first)} and {len(second)}",
        )


def check_fleet(fleet: Fleet, recorded: Path) -> Iterator[CheckRow]:
    """Check that the layout of a recording is that of the fleet file: its agents, and their cameras."""
    from sfglab.view.visualizer import entity_of_topic

    texts = " ".join(read_blueprint(recorded))
    streams = [
        (a.name, s.topic) for a in fleet.agents for sensor in a.sensors for s in sensor.streams
    ]
    views = [entity_below(agent, topic) for agent, topic in streams]
    ages = [f"/agents/{agent.name}/communication/heartbeat_age_s" for agent in fleet.agents]
    for check, wanted in (
        ("a view for every stream that the fleet file announces", views),
        ("a curve of the heartbeats of every agent of the fleet file", ages),
    ):
        yield _row(
            check, len(wanted), [entity for entity in wanted if entity not in texts], wanted[0]
        )
    said = [(agent.name, topic.name) for agent in fleet.agents for topic in agent.publishes]
    named = [(agent, name) for agent, name in said if name.split("/")[2:3] == [agent]]
    wrong = [name for agent, name in named if entity_of_topic(name) != entity_below(agent, name)]
    below = "every topic of an agent stands below the agent's root"
    yield _row(below, len(named), wrong, entity_below(*named[0]))


def _row(check: str, checked: int, wrong: list[str], example: str) -> CheckRow:
    text = ", ".join(wrong) or example
    return CheckRow(check=check, checked=checked, held=checked - len(wrong), example=text)

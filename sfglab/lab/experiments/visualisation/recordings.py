"""What a ``.rrd`` file holds, read back by Rerun's own reader. Knows entities, components and timelines."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """One component at one entity and time."""

    capture_ns: int | None  #: On the timeline of the senders' stamps; None for what holds at all times.
    received_ns: int | None  #: On that of this host; None likewise.
    content: NDArray[Any] | list[str]  #: Numbers of whatever nesting as a flat array; texts as a list.


def read_recording(path: Path) -> dict[tuple[str, str], list[Shown]]:
    """Return what a recording shows, by entity and component, in the order of reception."""
    from rerun.chunk import RrdReader

    found: dict[tuple[str, str], list[Shown]] = {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        for name in batch.schema.names:
            if ":" in name:
                found.setdefault((chunk.entity_path, name), []).extend(_column(batch, name))
    for rows in found.values():
        rows.sort(key=lambda shown: shown.received_ns or 0)
    return found


def rows_of(recording: dict[tuple[str, str], list[Shown]], entity: str) -> list[Shown]:
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
                    texts += [str(text) for values in batch.column(name).to_pylist() for text in values or ()]
    return texts


def _column(batch: Any, name: str) -> list[Shown]:
    times = [_times(batch, timeline) for timeline in ("capture", "received")]
    column = batch.column(name)
    return [
        Shown(capture_ns=times[0][row], received_ns=times[1][row], content=_flat(column[row]))
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

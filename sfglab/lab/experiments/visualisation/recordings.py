"""Reader of recordings (``.rrd``), by Rerun's own library."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

Recording = dict[tuple[str, str], list["Shown"]]
"""Everything shown, by entity and component."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Shown:
    """One component at one entity and time."""

    #: On the timeline of the senders' stamps; None for what holds at all times.
    capture_ns: int | None
    received_ns: int | None  #: On that of this host; None likewise.
    #: Numbers as a flat array, or texts as a list.
    content: NDArray[Any] | list[str]


def read_recording(path: Path) -> Recording:
    """Return what a recording shows, in the order of reception."""
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


def _column(batch: Any, name: str) -> list[Shown]:
    captures = _times(batch, "capture")
    receptions = _times(batch, "received")
    found = []
    for row, value in enumerate(batch.column(name)):
        if value.is_valid and len(value):
            shown = Shown(
                capture_ns=captures[row], received_ns=receptions[row], content=_flat(value)
            )
            found.append(shown)
    return found


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

"""Helpers of the tests of views: messages, readers of recordings, and states of an editor."""

from typing import NamedTuple

import numpy as np
from waiting import wait_until

from sfglab.messages import default_message, message_type

BEAT = "sfglab_interfaces/msg/AgentHeartbeat"


def edited(planner, holds):
    """Return what a planner's editor says, as soon as it is truthy."""
    return wait_until(lambda: planner.call(holds))


def heartbeat(agent, *, phase=1, period_s=1.0):
    return default_message(BEAT, agent=agent, phase=phase, period_s=period_s)


def cloud(records, *, row_step=None, height=1):
    """A ``PointCloud2`` of structured points; a row step of 0 is left out, as some drivers do."""
    field = message_type("sensor_msgs/msg/PointField")
    numbers = {"f4": 7, "u4": 6, "u2": 4, "f8": 8}
    fields = []
    for name, (dtype, offset) in records.dtype.fields.items():
        fields.append(field(name=name, offset=offset, datatype=numbers[dtype.str[1:]], count=1))
    rows = records.view(np.uint8).reshape(height, -1)
    step = row_step or rows.shape[1]
    return default_message(
        "sensor_msgs/msg/PointCloud2",
        fields=fields,
        height=height,
        width=len(records) // height,
        point_step=records.dtype.itemsize,
        row_step=step if row_step is None else row_step,
        data=np.pad(rows, ((0, 0), (0, step - rows.shape[1]))).reshape(-1),
        is_bigendian=bool(records.dtype["x"].str[0] == ">"),
    )


class Shown(NamedTuple):
    """One component at one entity and time; the times are None for what holds at all times."""

    capture_ns: int | None  #: On the timeline of the senders' stamps.
    received_ns: int | None  #: On that of this host.
    content: list  #: Its values.


def read_recording(path):
    """Return the components of a recording by entity and name, in order of reception, read by Rerun's own library."""
    from rerun.chunk import RrdReader

    found = {}
    for chunk in RrdReader(path).stream().to_chunks():
        batch = chunk.to_record_batch()
        times = [
            batch.column(name).cast("int64").to_pylist()
            if name in batch.schema.names
            else [None] * batch.num_rows
            for name in ("capture", "received")
        ]
        for name in batch.schema.names:
            if ":" in name:
                rows = zip(*times, batch.column(name).to_pylist(), strict=True)
                found.setdefault((chunk.entity_path, name), []).extend(
                    Shown(*row) for row in rows if row[-1]
                )
    for rows in found.values():
        rows.sort(key=lambda shown: shown.received_ns or 0)
    return found

"""What tests of views share: commands at work, messages, and what an editor comes to."""

import signal
import subprocess
import sys
from contextlib import contextmanager

import numpy as np
from waiting import DEADLINE_S, wait_until

from sfglab.messages import default_message, message_type

BEAT = "sfglab_interfaces/msg/AgentHeartbeat"


@contextmanager
def at_work(*arguments, **more):
    """A command of ours; ended by force at the end of the block, if it still runs."""
    argv = [sys.executable, "-m", "sfglab", *map(str, arguments)]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True, **more) as process:
        try:
            yield process
        finally:
            process.kill()


def interrupted(process):
    """What it still says, and its status, after Ctrl-C."""
    process.send_signal(signal.SIGINT)
    said, _ = process.communicate(timeout=DEADLINE_S)
    return said.splitlines(), process.returncode


def edited(planner, holds):
    """Return what a planner's editor says, as soon as it is truthy."""
    return wait_until(lambda: planner.call(holds))


def heartbeat(agent, *, phase=1, period_s=1.0):
    return default_message(BEAT, agent=agent, phase=phase, period_s=period_s)


def cloud(records, *, row_step=None, height=1):
    field = message_type("sensor_msgs/msg/PointField")
    numbers = {"f4": 7, "u4": 6, "u2": 4, "f8": 8}
    fields = [
        field(
            name=n,
            offset=records.dtype.fields[n][1],
            datatype=numbers[records.dtype[n].str[1:]],
            count=1,
        )
        for n in records.dtype.names
    ]
    shape = {"height": height, "width": len(records) // height}
    message = default_message("sensor_msgs/msg/PointCloud2", fields=fields, **shape)
    message.point_step = records.dtype.itemsize
    message.row_step = row_step or message.point_step * message.width
    rows = records.view(np.uint8).reshape(height, -1)
    message.data = np.pad(rows, ((0, 0), (0, message.row_step - rows.shape[1]))).reshape(-1)
    message.is_bigendian = bool(records.dtype["x"].str[0] == ">")
    return message

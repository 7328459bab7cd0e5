"""What tests of views share: commands at work, messages, and waiting for what nothing signals."""

import asyncio
import signal
import subprocess
import sys
import time
from contextlib import contextmanager

import numpy as np

from sfglab.messages import default_message, message_type

DEADLINE_S = 60
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


async def until(holds, act=lambda: None, *, every_s=0.01):
    """Act, again and again, until something holds."""
    async with asyncio.timeout(DEADLINE_S):
        while not holds():
            act()
            await asyncio.sleep(every_s)


def edited(planner, holds):
    """Return what a planner's editor says, as soon as it is truthy."""
    end = time.monotonic() + DEADLINE_S
    while not (found := planner.call(holds)):
        assert time.monotonic() < end, "the editor never came to that state"
        time.sleep(0.02)
    return found


def heartbeat(agent):
    message = default_message(BEAT)
    message.agent, message.phase, message.period_s = agent, 1, 1.0
    return message


def cloud(records, *, row_step=None, height=1):
    field = message_type("sensor_msgs/msg/PointField")
    numbers = {"f4": 7, "u4": 6, "u2": 4, "f8": 8}
    message = default_message("sensor_msgs/msg/PointCloud2")
    message.fields = [
        field(name=n, offset=records.dtype.fields[n][1], datatype=numbers[records.dtype[n].str[1:]], count=1)
        for n in records.dtype.names
    ]
    message.height, message.width = height, len(records) // height
    message.point_step = records.dtype.itemsize
    message.row_step = row_step or message.point_step * message.width
    rows = records.view(np.uint8).reshape(height, -1)
    message.data = np.pad(rows, ((0, 0), (0, message.row_step - rows.shape[1]))).reshape(-1)
    message.is_bigendian = bool(records.dtype["x"].str[0] == ">")
    return message

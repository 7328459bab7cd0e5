"""Fixtures of the bus's tests: worlds of each backend, and child processes that talk in JSON lines."""

import asyncio
import json
import signal
import sys
import textwrap
from contextlib import asynccontextmanager
from functools import partial

import psutil
import pytest
import waiting
from toy_bus import ToyDomain
from worlds import World

_PREAMBLE = """
import asyncio, json, sys
import numpy as np
from sfglab.bus import *
from sfglab.messages import *
from sfglab.qos import *

String = message_type("std_msgs/msg/String")
Image = message_type("sensor_msgs/msg/Image")

def say(**values):
    print(json.dumps(values), flush=True)

async def hear():
    line = await asyncio.to_thread(sys.stdin.readline)
    if not line:
        raise EOFError
    return json.loads(line)

"""


@pytest.fixture
def until():
    """Wait for a fact that nothing signals, with a deadline."""
    return partial(waiting.until, every_s=0.002)


class Child:
    """Another Python process: `hear` what it says, `tell` it something, `stop` or `kill` it."""

    def __init__(self, process):
        self.process = process
        self.pid = process.pid

    async def hear(self):
        line = await asyncio.wait_for(self.process.stdout.readline(), waiting.DEADLINE_S)
        if not line:
            error = (await self.process.stderr.read()).decode()
            raise AssertionError(f"the child ended with {await self.process.wait()}:\n{error}")
        return json.loads(line)

    async def tell(self, **values):
        self.process.stdin.write(json.dumps(values).encode() + b"\n")
        await self.process.stdin.drain()

    async def stop(self):
        """Stall the reader; until it is stalled, it may acknowledge."""
        self.process.send_signal(signal.SIGSTOP)
        await waiting.until(lambda: psutil.Process(self.pid).status() == psutil.STATUS_STOPPED)

    def go_on(self):
        self.process.send_signal(signal.SIGCONT)

    async def kill(self):
        self.process.send_signal(signal.SIGKILL)
        await self.process.wait()

    async def end(self):
        self.process.stdin.close()
        code = await asyncio.wait_for(self.process.wait(), waiting.DEADLINE_S)
        assert code == 0, (await self.process.stderr.read()).decode()


@pytest.fixture
def child(domain_id):
    """Start a process that runs the body of an async function, with a `node` if that has a name."""

    @asynccontextmanager
    async def start(body, name="", **options):
        code = textwrap.indent(textwrap.dedent(body), "    ")
        if name:
            options = {"domain_id": domain_id, "interface": "lo", **options}
            code = f"    async with Node({name!r}, **{options}) as node:\n" + textwrap.indent(
                code, "    "
            )
        code = f"{_PREAMBLE}async def main():\n{code}"
        code += "\nasyncio.run(main())\n"
        pipe = asyncio.subprocess.PIPE
        process = await asyncio.create_subprocess_exec(
            sys.executable, "-W", "error", "-c", code, stdin=pipe, stdout=pipe, stderr=pipe
        )
        try:
            yield Child(process)
        finally:
            if process.returncode is None:
                process.kill()
                await process.wait()

    return start


@pytest.fixture(
    params=[
        pytest.param("live", marks=pytest.mark.live),
        pytest.param("zenoh", marks=pytest.mark.zenoh),
        "simulated",
        "simulated-apart",
        "toy",
    ]
)
def world(request):
    """Nodes of one backend; simulated ones on one host or each on its own."""
    if request.param == "live":
        return request.getfixturevalue("live")
    if request.param == "zenoh":
        if (
            getattr(request.node, "callspec", None)
            and "shm" in request.node.callspec.params.values()
        ):
            pytest.skip("there is no shared memory over Zenoh")
        return request.getfixturevalue("over_zenoh")
    return World(request.param, ToyDomain().node)

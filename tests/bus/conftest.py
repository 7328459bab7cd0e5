"""Fixtures of the bus's tests: worlds of each backend, and child processes that talk in JSON lines."""

import asyncio
import json
import signal
import sys
import textwrap
from contextlib import asynccontextmanager

import pytest
from toy_bus import ToyDomain
from worlds import World

_DEADLINE_S = 60
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

    async def wait(predicate):
        async with asyncio.timeout(_DEADLINE_S):
            while not predicate():
                await asyncio.sleep(0.002)

    return wait


class Child:
    """Another Python process: `hear` what it says, `tell` it something, `kill` it."""

    def __init__(self, process):
        self.process = process
        self.pid = process.pid

    async def hear(self):
        async with asyncio.timeout(_DEADLINE_S):
            line = await self.process.stdout.readline()
        if not line:
            error = (await self.process.stderr.read()).decode()
            raise AssertionError(f"the child ended with {await self.process.wait()}:\n{error}")
        return json.loads(line)

    async def tell(self, **values):
        self.process.stdin.write(json.dumps(values).encode() + b"\n")
        await self.process.stdin.drain()

    async def kill(self):
        self.process.send_signal(signal.SIGKILL)
        await self.process.wait()

    async def end(self):
        self.process.stdin.close()
        async with asyncio.timeout(_DEADLINE_S):
            code = await self.process.wait()
        assert code == 0, (await self.process.stderr.read()).decode()


@pytest.fixture
def child(domain_id):
    """Start a process that runs the body of an async function, with a `node` if that has a name."""

    @asynccontextmanager
    async def start(body, name="", **options):
        code = textwrap.indent(textwrap.dedent(body), "    ")
        if name:
            options = {"domain_id": domain_id, "interface": "lo", **options}
            code = f"    async with Node({name!r}, **{options}) as node:\n" + textwrap.indent(code, "    ")
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


@pytest.fixture(params=[pytest.param("live", marks=pytest.mark.live), "simulated", "simulated-apart", "toy"])
def world(request):
    """Nodes of one backend; simulated ones on one host or each on its own."""
    if request.param == "live":
        return request.getfixturevalue("live")
    return World(request.param, ToyDomain().node)

"""Fixtures of the bus's tests: worlds of each backend, and child processes that talk in JSON lines."""

import asyncio
import inspect
import json
import signal
import sys
import textwrap
from contextlib import AsyncExitStack, asynccontextmanager
from functools import partial

import pytest
from toy_bus import ToyDomain

from sfglab.bus import Node
from sfglab.bus.sim import run_simulated

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


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem):
    """Run tests that are coroutine functions: in the world of their nodes, with `sim` in a simulated one."""
    test = pyfuncitem.obj
    if not inspect.iscoroutinefunction(test):
        return None
    arguments = {name: pyfuncitem.funcargs[name] for name in pyfuncitem._fixtureinfo.argnames}
    opened = [name for name in ("here", "there") if name in arguments]

    async def among_nodes(make):
        async with AsyncExitStack() as nodes:
            given = {name: await nodes.enter_async_context(make(name)) for name in opened}
            await test(**arguments | given | ({"node": make} if "node" in arguments else {}))

    if opened or "node" in arguments:
        pyfuncitem.funcargs["world"].run(among_nodes)
    elif "sim" in arguments:
        run_simulated(lambda world: test(**arguments | {"sim": world}), **arguments["sim"])
    else:
        asyncio.run(test(**arguments))
    return True


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


class World:
    """Runs a scenario, which is given what makes nodes."""

    def __init__(self, kind, node):
        self.kind, self.node = kind, node

    def run(self, scenario):
        if not self.kind.startswith("simulated"):
            return asyncio.run(scenario(self.node))
        apart = self.kind == "simulated-apart"

        def main(world):
            return scenario(lambda name, **more: world.node(name, host=name if apart else "host", **more))

        return run_simulated(main, seed=3, limit_s=3600)


@pytest.fixture
def live(domain_id):
    """Nodes on the loopback interface, in real time."""
    return World("live", partial(Node, domain_id=domain_id, interface="lo"))


@pytest.fixture(params=[pytest.param("live", marks=pytest.mark.live), "simulated", "simulated-apart", "toy"])
def world(request):
    """Nodes of one backend; simulated ones on one host or each on its own."""
    if request.param == "live":
        return request.getfixturevalue("live")
    return World(request.param, ToyDomain().node)


@pytest.fixture
def node(world):
    """Make a node of the world: `async with node("name") as other`."""


@pytest.fixture
def here(world):
    """A node of the world, open while the test runs."""


@pytest.fixture
def there(world):
    """Another node of the world."""


@pytest.fixture
def sim(request):
    """Stand for the simulated world that the test itself runs in; its parameter says what it is made with."""
    return getattr(request, "param", {})

"""Worlds that tests run nodes in: real DDS, or the simulated world with its virtual time.

A test that is a coroutine function runs in a loop of its own; with `here`, `there` or `node` in the world of
its nodes, and with `sim` in a simulated one.
"""

import asyncio
import socket
from contextlib import AsyncExitStack
from functools import partial
from inspect import iscoroutinefunction

import pytest


@pytest.hookimpl(tryfirst=True)
def pytest_pyfunc_call(pyfuncitem):
    """Run a test that is a coroutine function."""
    test = pyfuncitem.obj
    if not iscoroutinefunction(test):
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
        from sfglab.bus.sim import run_simulated

        run_simulated(lambda world: test(**arguments | {"sim": world}), **arguments["sim"])
    else:
        asyncio.run(test(**arguments))
    return True


class World:
    """Runs a scenario, which is given what makes nodes."""

    def __init__(self, kind, node=None):
        self.kind, self.node = kind, node

    def run(self, scenario):
        if not self.kind.startswith("simulated"):
            return asyncio.run(scenario(self.node))
        from sfglab.bus.sim import run_simulated

        apart = self.kind == "simulated-apart"

        def main(world):
            return scenario(
                lambda name, **more: world.node(name, host=name if apart else "host", **more)
            )

        return run_simulated(main, seed=3, limit_s=3600)


@pytest.fixture
def live(domain_id):
    """Nodes on the loopback interface, in real time."""
    from sfglab.bus import Node

    return World("live", partial(Node, domain_id=domain_id, interface="lo"))


@pytest.fixture
def free_port():
    """A TCP port that nothing on this host listens at."""
    with socket.create_server(("127.0.0.1", 0)) as free:
        return free.getsockname()[1]


@pytest.fixture
def hub(free_port):
    """Configuration of nodes over Zenoh, which meet at a router in this process."""
    import zenoh

    from sfglab.bus.zenoh.session import ZenohConfig

    place = (f"tcp/127.0.0.1:{free_port}",)
    router = ZenohConfig(mode="router", connect=(), listen=place)
    settings = zenoh.Config.from_json5(router.json("a"))
    settings.insert_json5("scouting/delay", "0")
    with zenoh.open(settings):
        yield ZenohConfig(connect=place)


@pytest.fixture
def over_zenoh(hub):
    """Nodes over Zenoh, each with a session of its own, in real time."""
    from sfglab.bus import Node
    from sfglab.bus.zenoh.backend import ZenohBackend

    return World("zenoh", partial(Node, join=partial(ZenohBackend, hub)))


@pytest.fixture(params=[pytest.param("live", marks=pytest.mark.live), "simulated-apart"])
def world(request):
    """Nodes of one backend; simulated ones on a host each."""
    return request.getfixturevalue("live") if request.param == "live" else World(request.param)


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

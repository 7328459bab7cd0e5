"""Agents over a hub as a user starts them: they discover and lose each other, and their topics cross."""

import asyncio
import signal
import sys
from contextlib import AsyncExitStack, asynccontextmanager
from dataclasses import replace

import pytest
from waiting import DEADLINE_S, until

from sfglab.bus import Node
from sfglab.bus.address import BusAddress
from sfglab.bus.zenoh.address import ZenohAddress
from sfglab.component import beside
from sfglab.fleet.router.config import RouterConfig
from sfglab.fleet.router.node import RouterRunningError, run_router
from sfglab.lab.hosts import Network
from sfglab.messages import default_message, message_type, service_type
from sfglab.processes import LineProcess
from sfglab.qos import LATCHED

pytestmark = [pytest.mark.live, pytest.mark.zenoh]

STRING, SERVICE = "std_msgs/msg/String", "std_srvs/srv/SetBool"
TF, TRANSFORM = "tf2_msgs/msg/TFMessage", "geometry_msgs/msg/TransformStamped"
String, SetBool = message_type(STRING), service_type(SERVICE)


class Hub:
    """A hub at a place, which can be killed and started again."""

    def __init__(self, place):
        self.argv = (sys.executable, "-u", "-m", "sfglab", "hub", "--bind", place)
        self.process = None

    async def start(self):
        pipe = asyncio.subprocess.PIPE
        self.process = await asyncio.create_subprocess_exec(*self.argv, stdout=pipe)
        async with asyncio.timeout(DEADLINE_S):
            while await self.process.stdout.readline() != b"hub: ready, end it with Ctrl-C\n":
                pass

    async def end(self, number=signal.SIGKILL):
        self.process.send_signal(number)
        said = await self.process.stdout.read()
        return await self.process.wait(), said

    async def __aenter__(self):
        return self

    async def __aexit__(self, *_):
        if self.process is not None and self.process.returncode is None:
            await self.end()


class Agent:
    """An agent as a process, and what it discovers: the last event of each other agent."""

    def __init__(self, name, domain_id, place, *options):
        where = ("--domain", str(domain_id), "--interface", "lo", "--agent", name)
        zenoh = ("--global", "zenoh", "--hub", place, "--without", "decoder", "--json")
        self.argv = (sys.executable, "-m", "sfglab", "agent", "up", *where, *zenoh, *options)
        self.known = {}
        self.lines = []

    async def start(self):
        self.process = await LineProcess.start("agent", self.argv, on_report=self.note)
        await self.process.expect("ready", timeout_s=DEADLINE_S)

    def note(self, report):
        inner = report.get("report", {})
        if inner.get("is") == "event":
            self.known[inner["agent"]] = inner["event"]
        self.lines.append(report.get("line", ""))

    async def kill(self):
        self.process.kill()
        await self.process.wait()

    async def end(self):
        self.process.signal(signal.SIGINT)
        await self.process.wait()
        await self.process.close()


@asynccontextmanager
async def fleet(domains, place, *options):
    """Two agents, `one` and `two`, without a hub."""
    agents = [
        Agent(name, domain, place, *options)
        for name, domain in zip(("one", "two"), domains, strict=True)
    ]
    await asyncio.gather(*(agent.start() for agent in agents))
    try:
        yield agents
    finally:
        await asyncio.gather(*(agent.end() for agent in agents))


@pytest.fixture
def place(free_port):
    return f"127.0.0.1:{free_port}"


@pytest.mark.slow
async def test_agents_discover_each_other_and_notice_when_one_has_gone_and_is_back(
    place, free_domains
):
    async with Hub(place) as hub, fleet(free_domains(2), place) as (one, two):
        await until(lambda: any("does not respond; next attempt in" in line for line in one.lines))
        await hub.start()
        await until(lambda: one.known == {"two": "DISCOVERED"})
        await until(lambda: two.known == {"one": "DISCOVERED"})
        await two.kill()
        await until(lambda: one.known == {"two": "LOST"})
        two.known.clear()
        await two.start()
        await until(lambda: one.known == {"two": "RESTARTED"})
        # A late joiner need not wait for the next heartbeat.
        await until(lambda: two.known == {"one": "DISCOVERED"})
        await hub.end()
        await until(lambda: one.known == {"two": "LOST"} and two.known == {"one": "LOST"})
        await hub.start()
        await until(lambda: one.known == {"two": "RETURNED"} and two.known == {"one": "RETURNED"})
        assert await hub.end(signal.SIGINT) == (0, b"hub: everything is released\n")


def transforms(*children):
    made = [default_message(TRANSFORM, child_frame_id=child) for child in children]
    for one in made:
        one.header.frame_id = "base"
    return default_message(TF, transforms=made)


@pytest.mark.slow
async def test_latched_samples_transforms_and_services_cross_also_after_the_hub_was_killed(
    place, free_domains
):
    domains = free_domains(2)
    async with Hub(place) as hub, AsyncExitStack() as stack:
        nodes = [
            await stack.enter_async_context(Node(name, domain_id=domain, interface="lo"))
            for name, domain in zip("ab", domains, strict=True)
        ]
        await stack.enter_async_context(fleet(domains, place))
        here, there = nodes
        latched = here.create_publisher(STRING, "/global/one/latched", replace(LATCHED, depth=5))
        for number in range(3):
            latched.publish(String(data=str(number)))
        frames = here.create_publisher(TF, "/tf_static", LATCHED)
        frames.publish(transforms("lidar", "camera"))
        here.create_service(
            SERVICE,
            "/global/one/s",
            lambda asked: default_message(SetBool.response, success=asked.data),
        )
        await hub.start()
        heard, children = [], []
        there.create_subscription(
            STRING, "/global/one/latched", lambda m: heard.append(m.data), replace(LATCHED, depth=5)
        )
        there.create_subscription(
            TF,
            "/tf_static",
            lambda m: children.extend((t.header.frame_id, t.child_frame_id) for t in m.transforms),
            LATCHED,
        )
        await until(lambda: heard == ["0", "1", "2"])
        await until(lambda: children == [("one/base", "one/lidar"), ("one/base", "one/camera")])
        client = there.create_client(SERVICE, "/global/one/s")
        for is_true in (True, False) * 10:
            response = await client.call(SetBool.request(data=is_true), timeout_s=30)
            assert response.success is is_true
        await hub.end()
        latched.publish(String(data="meanwhile"))
        await hub.start()
        late = []
        there.create_subscription(
            STRING, "/global/one/latched", lambda m: late.append(m.data), replace(LATCHED, depth=5)
        )
        # If the path was closed meanwhile, it is read again from its beginning.
        everything = ["0", "1", "2", "meanwhile"]
        await until(lambda: heard[-4:] == everything and late[-4:] == everything)
        response = await client.call(SetBool.request(data=True), timeout_s=30)
        assert response.success


@pytest.mark.slow
@pytest.mark.netns
async def test_peers_make_further_ones_known():
    names, domain = "abc", 7
    with Network(grace_s=0.2) as network:
        hosts = [network.add_host(name) for name in names]
        agents = [Agent(name, domain, "") for name in names]
        async with AsyncExitStack() as stack:
            for host, agent in zip(hosts, agents, strict=True):
                at = agent.argv.index("--hub")
                peer = ("--peer", hosts[0].address) if host is not hosts[0] else ()
                agent.argv = host.argv((*agent.argv[:at], *peer, *agent.argv[at + 2 :]))
                await agent.start()
                stack.push_async_callback(agent.end)
            for name, agent in zip(names, agents, strict=True):
                others = set(names) - {name}
                await until(lambda agent=agent, others=others: agent.known.keys() == others)


async def test_routers_of_one_domain_exclude_each_other_over_dds_and_zenoh(free_domains, place):
    own, shared = free_domains(2)
    local = BusAddress(domain_id=own, interface="lo")
    sides = [BusAddress(domain_id=shared, interface="lo"), ZenohAddress(hubs=(place,))]
    for first, second in (sides, sides[::-1]):
        ready = asyncio.Event()
        config = RouterConfig(agent="one", local=local, remote=first)
        async with beside(run_router(config, lambda _, ready=ready: ready.set())):
            await ready.wait()
            with pytest.raises(RouterRunningError, match=f"router of domain {own}"):
                await run_router(replace(config, remote=second), lambda _: None)

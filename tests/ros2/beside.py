"""Helpers of the tests beside real ROS 2."""

import asyncio
import os
import re
import sys
from contextlib import AsyncExitStack, asynccontextmanager, suppress
from inspect import isawaitable
from pathlib import Path
from signal import SIGKILL

import numpy as np
from random_messages import random_message

from sfglab.bus.address import BusAddress
from sfglab.component import argument_of
from sfglab.fleet.router.config import RouterConfig
from sfglab.messages import default_message, deserialize, serialize
from sfglab.processes import LineProcess
from sfglab.qos import Durability, QoSProfile

ANSWER_S = 180
STRING = "std_msgs/msg/String"
EMPTY = serialize(default_message(STRING)).hex()
LATCHED = {"durability": "transient_local", "depth": 1}
OURS_LATCHED = QoSProfile(durability=Durability.TRANSIENT_LOCAL, depth=1)


@asynccontextmanager
async def started(name, argv, host=None):
    """Run a process, here or on a test host, as soon as it is ready."""
    process = await LineProcess.start(name, host.argv(argv) if host else argv)
    try:
        await process.expect("ready", timeout_s=ANSWER_S)
        yield process
    finally:
        await process.close()


def component(host, module, config):
    """Run a component of ours."""
    return started(module, [sys.executable, "-m", module, argument_of(config)], host)


@asynccontextmanager
async def agents(network, peer, domains, *more, remotes=None, **config):
    """Real nodes of each agent, on a host of its own behind its router: one, and those named in addition.

    The routers meet over DDS, or at the addresses that are given by the agent's name.
    """
    async with AsyncExitStack() as stack:
        starting, dds = {}, BusAddress(domain_id=5, interface="eth0")
        for name, domain in domains.items():
            host, local = network.hosts[name], BusAddress(domain_id=domain, interface="lo")
            remote = (remotes or {}).get(name, dds)
            router = RouterConfig(
                agent=name, local=local, remote=remote, idle_timeout_s=0.2, **config
            )
            starting[f"{name}'s router"] = component(host, "sfglab.fleet.router.node", router)
            starting[name] = peer(name, host, ROS_DOMAIN_ID=domain)
        for name, agent in more:
            starting[name] = peer(name, network.hosts[agent], ROS_DOMAIN_ID=domains[agent])
        started = await asyncio.gather(*map(stack.enter_async_context, starting.values()))
        yield dict(zip(starting, started, strict=True))


def kill(process):
    """End a real node by force, and what it leaves in shared memory then."""
    maps = Path(f"/proc/{process.pid}/maps").read_text(encoding="utf-8")
    os.kill(process.pid, SIGKILL)
    for segment in set(re.findall(r"/dev/shm/(fast\w+)", maps)):
        for left in Path("/dev/shm").glob(f"*{segment}*"):
            left.unlink(missing_ok=True)


async def asked(process, do, answer, **values):
    """Give a peer an order and return its report."""
    process.order(do=do, **values)
    return await process.expect(answer, timeout_s=ANSWER_S)


async def publish(ros, topic, qos=LATCHED, cdr=(EMPTY,), kind=STRING):
    """Let a peer publish messages, by default an empty text for all who will come."""
    await asked(ros, "publish", "published", kind=kind, topic=topic, qos=qos, cdr=list(cdr))


async def listen(ros, topic, qos, kind=STRING, **more):
    """Let a peer listen to a topic."""
    await asked(ros, "listen", "listening", kind=kind, topic=topic, qos=qos, **more)


async def until(holds):
    """Ask until it holds; who is asked may answer at once or be waited for."""
    async with asyncio.timeout(ANSWER_S):
        while not (await answer if isawaitable(answer := holds()) else answer):
            await asyncio.sleep(0.1)


def without_padding(message):
    """Return a message in which the octet of those without fields is zero: rosidl never looks at it."""
    for name, value in vars(message).items():
        if name == "structure_needs_at_least_one_member":
            setattr(message, name, 0)
        for inner in value if isinstance(value, list) else [value]:
            if hasattr(inner, "__msgtype__"):
                without_padding(inner)
    return message


async def bent(ros, names, *, times, seed):
    """Return the types of which random values come back from rclpy as others.

    They are compared in our bytes: rclpy's own have no zeros in their gaps.
    """
    rng, found = np.random.default_rng(seed), []
    for name in names:
        given = [serialize(without_padding(random_message(rng, name))) for _ in range(times)]
        theirs = name.replace("_FeedbackMessage", ".Impl.FeedbackMessage")
        back = []
        for first in range(0, times, 20):
            cdr = [one.hex() for one in given[first : first + 20]]
            passed = await asked(ros, "pass_through", "passed", kind=theirs, cdr=cdr)
            back += [serialize(deserialize(bytes.fromhex(one), name)) for one in passed["cdr"]]
        found += [name] if back != given else []
    return found


async def echoed(ros, node, given):
    """Return what comes back of messages, by type, in bytes, when rclpy passes on what it hears."""
    back = {}
    for name, message in given.items():
        topic = name.replace("/", "_")

        def take(message, name=name):
            back[name] = serialize(message)

        node.create_subscription(name, f"/back/{topic}", take, OURS_LATCHED)
        node.create_publisher(name, f"/forth/{topic}", OURS_LATCHED).publish(message)
    await asked(ros, "echo", "echoing", types=list(given), qos=LATCHED)
    with suppress(TimeoutError):
        await until(lambda: back.keys() == given.keys())
    return back

"""Routers with real DDS on three domains: what may cross does so, once; nothing else does; nothing stays."""

import asyncio
import os
import signal
import sys
import tempfile
from contextlib import asynccontextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from waiting import DEADLINE_S, process, program, until

from sfglab.bus import Node
from sfglab.bus.address import BusAddress
from sfglab.bus.dds.endpoints import DdsReader, DdsWriter
from sfglab.component import beside
from sfglab.errors import InvalidValueError
from sfglab.fleet.router.config import RouterConfig, RouterSettings
from sfglab.fleet.router.node import (
    Router,
    RouterRunningError,
    domain_lock,
)
from sfglab.messages import message_type, serialize
from sfglab.messages.dds import opaque_idl_struct
from sfglab.qos import LATCHED

pytestmark = [pytest.mark.live]

STRING = "std_msgs/msg/String"
String = message_type(STRING)
TOPIC = "/global/go2/pose"
DEEP = replace(LATCHED, depth=1000)


@pytest.fixture
def ids(free_domains):
    """Ids of a global and two local domains that are free."""
    return free_domains(3)


@asynccontextmanager
async def routing(local, remote):
    """A router of an agent called after its local domain, as the process would run it."""
    async with (
        Node("router", domain_id=local, interface="lo") as near,
        Node("router", domain_id=remote, interface="lo") as far,
    ):
        settings = RouterSettings(agent=f"robot{local}", idle_timeout_s=0.1)
        async with beside(Router(near, far, settings, tag=f"host/{local}").run()):
            yield


@asynccontextmanager
async def fleet(ids):
    """Two agents behind their routers and a participant in the global domain: nodes one, two and all."""
    async with (
        Node("everybody", domain_id=ids[0], interface="lo") as everybody,
        Node("one", domain_id=ids[1], interface="lo") as one,
        Node("two", domain_id=ids[2], interface="lo") as two,
        routing(ids[1], ids[0]),
        routing(ids[2], ids[0]),
    ):
        yield one, two, everybody


async def hear(node, heard):
    """Remember what arrives, and its source stamps."""
    subscription = node.create_subscription(STRING, TOPIC, qos=DEEP)
    while True:
        message, info = await subscription.take_with_info()
        heard.append((message.data, info.source_timestamp_ns))


async def test_everybody_hears_everybody_once_in_order_with_the_first_stamp(ids):
    sent = [[(f"{who} {number}", 1_000 * who + number) for number in range(50)] for who in range(3)]
    ears = [[] for _ in sent]
    async with fleet(ids) as nodes, beside(*map(hear, nodes, ears)):
        for node, mine in zip(nodes, sent, strict=True):
            publisher = node.create_publisher(STRING, TOPIC, DEEP)
            for data, stamp_ns in mine:
                publisher.publish_raw(serialize(String(data=data)), source_timestamp_ns=stamp_ns)
        await until(lambda: all(all(set(mine) <= set(heard) for mine in sent) for heard in ears))
        await _stillness(lambda: [len(heard) for heard in ears])
    for heard in ears:
        for mine in sent:
            assert [told for told in heard if told in mine] == mine


async def _stillness(look):
    """Return when nothing has changed for a while that is long beside a message's way."""
    before = None
    while (now := look()) != before:
        before = now
        await asyncio.sleep(0.1)


async def test_an_unknown_type_crosses_two_routers_and_it_is_said(ids, caplog):
    custom = "my_robot_msgs/msg/Arm"
    cdr = b"\0\1\0\0" + bytes(range(200))
    async with fleet(ids) as (one, two, _):
        got = []
        near, far = (node.backend.participant for node in (one, two))
        struct = opaque_idl_struct(custom)
        raw, how = near.create_writer("rt" + TOPIC, struct, LATCHED), {"on_matched": lambda: None}
        writer = DdsWriter(raw, TOPIC, type_=custom, waitset=near.waitset, **how)
        writer.write(cdr, 7)
        raw = far.create_reader("rt" + TOPIC, struct, LATCHED)
        DdsReader(raw, waitset=far.waitset, on_samples=got.extend, **how)
        await until(lambda: got)
        assert [sample[:2] for sample in got] == [(cdr, 7)]
    (said,) = [r.message for r in caplog.records if custom in r.message]
    assert f"type {custom} is not known here" in said


# The router as a process.


def config_of(ids, **more):
    local, remote = (BusAddress(domain_id=domain, interface="lo") for domain in (ids[1], ids[0]))
    return RouterConfig(agent="go2", local=local, remote=remote, idle_timeout_s=0.1, **more)


async def test_a_late_joiner_hears_no_state_from_before_a_router_was_killed_and_that_of_all_who_live(
    ids,
):
    config = config_of(ids)
    async with (
        Node("one", domain_id=ids[1], interface="lo") as one,
        Node("two", domain_id=ids[2], interface="lo") as two,
        routing(ids[2], ids[0]),
    ):
        state, known = one.create_publisher(STRING, TOPIC, LATCHED), []
        state.publish(String(data="old"))
        deep = replace(LATCHED, depth=9)
        two.create_subscription(STRING, TOPIC, lambda message: known.append(message.data), deep)
        async with process("sfglab.fleet.router.node", config) as first:
            await until(lambda: known == ["old"])
            first.signal(signal.SIGKILL)
            await first.wait()
        state.publish(String(data="new"))
        async with (
            process("sfglab.fleet.router.node", config),
            Node("router", namespace="/go2", domain_id=ids[0], interface="lo") as claimer,
        ):
            await until(lambda: "new" in known)
            before = {publisher.gid for publisher in two.graph.publishers(TOPIC)}
            claimer.create_publisher(STRING, TOPIC, LATCHED).publish(String(data="claimed"))
            # A writer that another succeeds is heard until its end has been.
            await until(
                lambda: (
                    "claimed" in known
                    and before.isdisjoint(p.gid for p in two.graph.publishers(TOPIC))
                )
            )
            # A live publisher is not replaced by a node that claims its name.
            two.create_subscription(STRING, TOPIC, (heard := []).append, deep)
            await until(lambda: len(heard) >= 2)
            await _stillness(lambda: len(heard))
            assert sorted(message.data for message in heard) == ["claimed", "new"]


@pytest.mark.parametrize(("name", "other"), [("router", "global"), ("decoder", "remote")])
def test_alone_at_a_terminal_a_component_says_when_it_is_ready_and_when_it_has_ended(
    ids, name, other
):
    words = (
        f"{name} --domain {ids[1]} --interface lo --{other}-domain {ids[0]} --{other}-interface lo"
    )
    with program(sys.executable, "-u", "-m", "sfglab", *words.split()) as component:
        assert component.stdout.readline() == f"{name}: ready, end it with Ctrl-C\n"
        component.send_signal(signal.SIGINT)
        assert component.stdout.read() == f"{name}: everything is released\n"
        assert component.wait(DEADLINE_S) == 0


def test_the_lock_names_its_holder_and_is_free_as_soon_as_it_is_released():
    with (
        domain_lock(230),
        pytest.raises(RouterRunningError, match=f"process {os.getpid()} ") as caught,
    ):
        domain_lock(230).__enter__()
    assert (caught.value.pid, caught.value.domain_id) == (os.getpid(), 230)
    with domain_lock(230), domain_lock(231):
        assert (Path.home() / ".cache/sfglab").stat().st_mode & 0o77 == 0


def test_without_a_home_the_lock_is_in_a_folder_that_nobody_else_can_write_to(
    tmp_path, monkeypatch
):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    monkeypatch.setenv("HOME", "/proc")
    with domain_lock(230):
        [folder] = tmp_path.iterdir()
        assert folder.stat().st_mode & 0o77 == 0
        assert len(list(folder.iterdir())) == 1
    folder.chmod(0o777)
    with pytest.raises(InvalidValueError, match=r"folder for locks: given .*other users can open"):
        domain_lock(230).__enter__()

"""The status provider on a real bus and as a process: heard at once, asked, updated, ended."""

import asyncio
from contextlib import asynccontextmanager

import pytest
from waiting import DEADLINE_S, process, until

from sfglab.bus import Node
from sfglab.component import beside
from sfglab.fleet.status import heartbeat
from sfglab.fleet.status.description import AgentDescription, DescriptionError, SensorDescription
from sfglab.fleet.status.node import StatusConfig, StatusProvider, StatusSettings
from sfglab.messages import ns_from_stamp, service_type
from sfglab.qos import LATCHED

pytestmark = [pytest.mark.live]
world = pytest.fixture(lambda live: live)

SELDOM = heartbeat.Schedule(startup_s=0, steady_period_s=60)


@asynccontextmanager
async def running(node, **settings):
    """Run a provider of agent go2; yield it and the heartbeats that it sent."""
    sent: asyncio.Queue[heartbeat.Heartbeat] = asyncio.Queue()
    provider = StatusProvider(node, StatusSettings(agent="go2", **settings), on_beat=sent.put_nowait)
    async with beside(provider.run()):
        yield provider, sent


async def metadata_of(node, agent="go2"):
    client = node.create_client(heartbeat.GET_METADATA, heartbeat.metadata_service(agent))
    response = await client.call(service_type(heartbeat.GET_METADATA).request(), timeout_s=60)
    client.close()
    assert (response.success, response.message) == (True, "")
    return response.metadata


async def test_whoever_joins_late_hears_the_last_heartbeat_at_once_and_gets_an_answer(here, there):
    async with running(here, schedule=SELDOM) as (_, sent):
        beat = await asyncio.wait_for(sent.get(), 60)
        heartbeats = there.create_subscription(
            heartbeat.AGENT_HEARTBEAT, heartbeat.heartbeat_topic(), qos=LATCHED
        )
        message, info = await heartbeats.take_with_info(timeout_s=60)
        assert heartbeat.Heartbeat.from_message(message) == beat
        assert (beat.agent, beat.revision, beat.phase, beat.period_s) == ("go2", 0, 1, 60.0)
        assert 0 <= ns_from_stamp(message.stamp) - beat.incarnation < 5e9
        await until(lambda: there.graph.publishers("/global/agent_heartbeat"))  # may come after the data
        assert info.publisher_gid in {p.gid for p in there.graph.publishers("/global/agent_heartbeat")}
        metadata = await metadata_of(there)
        assert (metadata.agent, metadata.incarnation, metadata.revision) == ("go2", beat.incarnation, 0)


async def test_the_periods_are_kept_and_announced(here):
    schedule = heartbeat.Schedule(startup_period_s=0.1, steady_period_s=0.3, startup_s=0.4)
    loop, times = asyncio.get_running_loop(), []
    async with running(here, schedule=schedule) as (_, sent):
        beats = []
        for _ in range(7):
            beats.append(await asyncio.wait_for(sent.get(), 60))
            times.append(loop.time())
    assert [b.phase for b in beats] == [0, 0, 0, 0, 1, 1, 1]
    assert len({b.incarnation for b in beats}) == 1
    assert all(0 < b.period_s <= (0.3 if b.phase else 0.1) for b in beats), "less when it was late"
    assert times[-1] - times[0] > 0.9, "no instant comes early or twice"


async def test_a_new_description_is_told_at_once_and_a_bad_one_changes_nothing(here):
    async with running(here, schedule=SELDOM) as (provider, sent):
        assert (await asyncio.wait_for(sent.get(), 60)).revision == 0
        twice = (SensorDescription(name="x"), SensorDescription(name="x"))
        with pytest.raises(DescriptionError):
            provider.update(AgentDescription(sensors=twice))
        provider.update(AgentDescription(software=("sfglab 2",)))
        beat = await asyncio.wait_for(sent.get(), 60)
        assert beat.revision == 1
        assert 50 < beat.period_s <= 60, "the instants stay where they were"
        metadata = await metadata_of(here)
        assert (metadata.revision, metadata.software) == (1, ["sfglab 2"])


async def test_as_a_process_it_reports_takes_orders_and_ends_with_its_input(address):
    settings = StatusSettings(agent="go2", schedule=SELDOM)
    config = StatusConfig(address=address, settings=settings, detect=True, report_beats=True)
    async with process("sfglab.fleet.status.node", config) as child:
        await child.expect("ready", timeout_s=DEADLINE_S)
        assert (await child.expect("beat", timeout_s=DEADLINE_S))["revision"] == 0
        child.order(description={"wheels": 4})
        assert "wheels" in (await child.expect("refused", timeout_s=DEADLINE_S))["why"]
        async with Node("b", **address.options()) as there:
            before = await metadata_of(there)
            assert any(entry.startswith("sfglab ") for entry in before.software), "detected"
            child.order(description={"software": ["mine 1"]})
            beat = await child.expect("beat", timeout_s=DEADLINE_S)
            after = await metadata_of(there)
        assert (beat["revision"], after.software) == (before.revision + 1, ["mine 1"])
    assert child.status == 0

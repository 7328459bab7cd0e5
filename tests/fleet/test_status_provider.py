"""When an agent beats, what it says of itself, and its provider on a real bus and as a process."""

import asyncio
import itertools
import math
from contextlib import asynccontextmanager
from dataclasses import asdict

import pytest
from cameras import FFMPEG, INFO
from cameras import STREAM as TOPIC
from hypothesis import given
from hypothesis import strategies as st
from waiting import DEADLINE_S, process, until

from sfglab.bus import Node
from sfglab.component import beside
from sfglab.errors import InvalidValueError
from sfglab.fleet.status import heartbeat
from sfglab.fleet.status.description import (
    AgentDescription,
    DescriptionError,
    SensorDescription,
    StreamDescription,
)
from sfglab.fleet.status.node import StatusConfig, StatusProvider, StatusSettings
from sfglab.messages import deserialize, ns_from_stamp, serialize, service_type
from sfglab.names import FqnError
from sfglab.qos import LATCHED

world = pytest.fixture(lambda live: live)

SELDOM = heartbeat.Schedule(startup_s=0, steady_period_s=60)


@asynccontextmanager
async def running(node, **settings):
    """Run a provider of agent go2; yield it and the heartbeats that it sent."""
    sent: asyncio.Queue[heartbeat.Heartbeat] = asyncio.Queue()
    provider = StatusProvider(
        node, StatusSettings(agent="go2", **settings), on_beat=sent.put_nowait
    )
    async with beside(provider.run()):
        yield provider, sent


async def metadata_of(node, agent="go2"):
    client = node.create_client(heartbeat.GET_METADATA, heartbeat.metadata_service(agent))
    response = await client.call(service_type(heartbeat.GET_METADATA).request(), timeout_s=60)
    client.close()
    assert (response.success, response.message) == (True, "")
    return response.metadata


@pytest.mark.live
async def test_whoever_joins_late_hears_the_last_beat_and_gets_an_answer_and_what_is_new_is_told(
    here, there
):
    async with running(here, schedule=SELDOM) as (provider, sent):
        beat = await asyncio.wait_for(sent.get(), 60)
        topic = heartbeat.heartbeat_topic()
        heartbeats = there.create_subscription(heartbeat.AGENT_HEARTBEAT, topic, qos=LATCHED)
        message, info = await heartbeats.take_with_info(timeout_s=60)
        assert heartbeat.Heartbeat.from_message(message) == beat
        assert (beat.agent, beat.revision, beat.phase, beat.period_s) == ("go2", 0, 1, 60.0)
        assert 0 <= ns_from_stamp(message.stamp) - beat.incarnation < 5e9
        await until(
            lambda: there.graph.publishers("/global/agent_heartbeat")
        )  # may come after the data
        assert info.publisher_gid in {
            p.gid for p in there.graph.publishers("/global/agent_heartbeat")
        }
        metadata = await metadata_of(there)
        assert (metadata.agent, metadata.incarnation, metadata.revision) == (
            "go2",
            beat.incarnation,
            0,
        )
        twice = (SensorDescription(name="x"), SensorDescription(name="x"))
        with pytest.raises(DescriptionError, match="names that differ"):
            provider.update(AgentDescription(sensors=twice))
        provider.update(AgentDescription(software=("sfglab 2",)))
        beat = await asyncio.wait_for(sent.get(), 60)
        assert beat.revision == 1, "the bad one changed nothing"
        assert 50 < beat.period_s <= 60, "the instants stay where they were"
        metadata = await metadata_of(here)
        assert (metadata.revision, metadata.software) == (1, ["sfglab 2"])


async def test_the_periods_are_kept_and_announced(sim):
    schedule, loop = (
        heartbeat.Schedule(startup_period_s=1, steady_period_s=3, startup_s=4),
        asyncio.get_running_loop(),
    )
    begins_s = loop.time()
    async with sim.node("status") as node, running(node, schedule=schedule) as (_, sent):
        beats = [(await sent.get(), round(loop.time() - begins_s, 6)) for _ in range(7)]
    said = [(at_s, beat.phase, beat.period_s) for beat, at_s in beats]
    assert said == [*((s, 0, 1.0) for s in range(4)), *((s, 1, 3.0) for s in (4, 7, 10))]
    assert len({beat.incarnation for beat, _ in beats}) == 1


@pytest.mark.live
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


S = 1_000_000_000
SIZE = {"width": 640, "height": 360, "rate_hz": 30.0}
STREAM = StreamDescription(topic=TOPIC, type=FFMPEG, codec="h264", camera_info_topic=INFO, **SIZE)
CAMERA = SensorDescription(name="camera_front", model="D435", streams=(STREAM,))
DESCRIPTION = AgentDescription(
    sensors=(CAMERA,), accelerators=("h264_nvenc",), software=("sfglab 1",)
)


def test_names_on_the_wire_are_the_papers():
    assert heartbeat.heartbeat_topic() == "/global/agent_heartbeat"
    assert heartbeat.metadata_service("go2") == "/global/go2/get_metadata"


@pytest.mark.parametrize(
    ("schedule", "instants", "startup_s"),
    [
        (heartbeat.Schedule(), [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 15, 20, 25], 10),
        (
            heartbeat.Schedule(startup_period_s=1, steady_period_s=4, startup_s=2.5),
            [0, 1, 2, 3, 7, 11],
            3,
        ),
        (heartbeat.Schedule(startup_s=0), [0, 5, 10], 0),
    ],
    ids=["the paper's", "whole periods", "no start-up"],
)
def test_it_beats_often_at_first_and_who_is_late_goes_on_with_the_next_instant(
    schedule, instants, startup_s
):
    for now_s, next_s in itertools.pairwise(instants):
        for late_ns in (0, round(0.7 * S)):
            assert schedule.next_ns(now_s * S + late_ns) == next_s * S
    assert schedule.phase(startup_s * S) is heartbeat.Phase.STEADY
    assert not startup_s or schedule.phase(startup_s * S - 1) is heartbeat.Phase.STARTUP


PERIODS = st.floats(0.05, 60)


@given(PERIODS, PERIODS, st.floats(0, 100), st.integers(0, 10**12))
def test_the_next_instant_is_after_now_and_at_most_a_period_away(
    startup, steady, lasts, elapsed_ns
):
    schedule = heartbeat.Schedule(startup_period_s=startup, steady_period_s=steady, startup_s=lasts)
    wait_ns = schedule.next_ns(elapsed_ns) - elapsed_ns
    period_s = startup if schedule.phase(elapsed_ns) is heartbeat.Phase.STARTUP else steady
    assert 0 < wait_ns <= round(period_s * S)
    assert schedule.next_ns(elapsed_ns + wait_ns - 1) == elapsed_ns + wait_ns


@pytest.mark.parametrize("name", ["startup_period_s", "steady_period_s", "startup_s"])
@pytest.mark.parametrize("given", [-1.0, math.nan, math.inf, 1e6])
def test_a_schedule_that_no_agent_should_keep_is_refused(name, given):
    why = rf"heartbeat schedule, {name}: given .*, allowed: seconds from"
    with pytest.raises(InvalidValueError, match=why):
        heartbeat.Schedule(**{name: given})


def test_a_heartbeat_survives_the_wire_and_a_description_becomes_the_metadata_message():
    beat = heartbeat.Heartbeat(
        agent="go2", incarnation=2**63, revision=3, phase=1, period_s=5.0, version="1.2"
    )
    wire = serialize(beat.to_message(10**18))
    assert heartbeat.Heartbeat.from_message(deserialize(wire, heartbeat.AGENT_HEARTBEAT)) == beat
    message = DESCRIPTION.to_message("go2", incarnation=5, revision=2, stamp_ns=7 * S)
    again = deserialize(serialize(message), type(message))
    assert (again.agent, again.incarnation, again.revision, again.stamp.sec) == ("go2", 5, 2, 7)
    assert (again.accelerators, again.software) == (["h264_nvenc"], ["sfglab 1"])
    (sensor,) = again.sensors
    (stream,) = sensor.streams
    assert (sensor.name, sensor.model) == ("camera_front", "D435")
    assert all(getattr(stream, name) == value for name, value in asdict(STREAM).items())


@pytest.mark.parametrize(
    "topic", [TOPIC.replace("global", "local"), TOPIC.replace("go2", "husky"), "no name"]
)
def test_a_stream_that_does_not_cross_its_agents_border_and_a_wrong_agents_name_are_refused(topic):
    stream = StreamDescription(topic=topic, type="sensor_msgs/msg/CompressedImage", codec="jpeg")
    description = AgentDescription(sensors=(SensorDescription(name="x", streams=(stream,)),))
    with pytest.raises(DescriptionError, match=topic):
        StatusSettings(agent="go2", description=description)
    with pytest.raises(FqnError):
        StatusSettings(agent="camera")


@pytest.mark.parametrize(
    "values", [{"wheels": 4}, {"sensors": [{"wheels": 4}]}, {"sensors": ["camera"]}]
)
def test_values_that_are_no_description_are_refused(values):
    with pytest.raises(DescriptionError):
        AgentDescription.from_values(values)

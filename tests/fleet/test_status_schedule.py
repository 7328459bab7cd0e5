"""When an agent beats, and what it may say of itself."""

from __future__ import annotations

import math
from dataclasses import asdict

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.bus.address import BusAddress
from sfglab.component import argument_of, config_from_argument
from sfglab.errors import InvalidValueError
from sfglab.fleet.status.description import (
    AgentDescription,
    DescriptionError,
    SensorDescription,
    StreamDescription,
)
from sfglab.fleet.status.heartbeat import (
    Heartbeat,
    Phase,
    Schedule,
    heartbeat_topic,
    metadata_service,
)
from sfglab.fleet.status.node import StatusConfig, StatusSettings
from sfglab.messages import deserialize, message_type, serialize
from sfglab.names import FqnError

S = 1_000_000_000
STREAM = StreamDescription(
    topic="/global/go2/camera_front/color/ffmpeg",
    type="ffmpeg_image_transport_msgs/msg/FFMPEGPacket",
    codec="h264",
    camera_info_topic="/global/go2/camera_front/color/camera_info",
    width=640,
    height=360,
    rate_hz=30.0,
)
DESCRIPTION = AgentDescription(
    sensors=(SensorDescription(name="camera_front", model="D435", streams=(STREAM,)),),
    accelerators=("h264_nvenc",),
    software=("sfglab 1",),
)


def instants(schedule: Schedule, count: int) -> list[float]:
    found = [0]
    while len(found) < count:
        found.append(schedule.next_ns(found[-1]))
    return [t / S for t in found]


def test_names_on_the_wire_are_the_papers():
    assert heartbeat_topic() == "/global/agent_heartbeat"
    assert metadata_service("go2") == "/global/go2/get_metadata"


def test_by_default_it_beats_every_second_for_ten_and_every_five_afterwards():
    assert instants(Schedule(), 14) == [0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 15, 20, 25]
    assert Schedule().phase(10 * S - 1) is Phase.STARTUP
    assert Schedule().phase(10 * S) is Phase.STEADY


def test_the_start_up_lasts_whole_periods_and_may_be_missing():
    odd = Schedule(startup_period_s=1, steady_period_s=4, startup_s=2.5)
    assert instants(odd, 6) == [0, 1, 2, 3, 7, 11]
    assert odd.phase(round(2.9 * S)) is Phase.STARTUP
    none = Schedule(startup_s=0)
    assert instants(none, 3) == [0, 5, 10]
    assert none.phase(0) is Phase.STEADY


def test_whoever_was_late_goes_on_with_the_next_instant():
    assert Schedule().next_ns(round(3.7 * S)) == 4 * S
    assert Schedule().next_ns(round(33 * S)) == 35 * S


PERIODS = st.floats(0.05, 60)


@given(PERIODS, PERIODS, st.floats(0, 100), st.integers(0, 10**12))
def test_the_next_instant_is_after_now_and_at_most_a_period_away(startup, steady, lasts, elapsed_ns):
    schedule = Schedule(startup_period_s=startup, steady_period_s=steady, startup_s=lasts)
    wait_ns = schedule.next_ns(elapsed_ns) - elapsed_ns
    period_s = startup if schedule.phase(elapsed_ns) is Phase.STARTUP else steady
    assert 0 < wait_ns <= round(period_s * S)
    assert schedule.next_ns(elapsed_ns + wait_ns - 1) == elapsed_ns + wait_ns


@pytest.mark.parametrize("name", ["startup_period_s", "steady_period_s", "startup_s"])
@pytest.mark.parametrize("given", [-1.0, math.nan, math.inf, 1e6])
def test_a_schedule_that_no_agent_should_keep_is_refused(name, given):
    with pytest.raises(
        InvalidValueError, match=rf"heartbeat schedule, {name}: given .*, allowed: seconds from"
    ):
        Schedule(**{name: given})


def test_a_heartbeat_survives_the_wire():
    beat = Heartbeat(agent="go2", incarnation=2**63, revision=3, phase=1, period_s=5.0, version="1.2")
    wire = serialize(beat.to_message(10**18))
    assert (
        Heartbeat.from_message(deserialize(wire, message_type("sfglab_interfaces/msg/AgentHeartbeat"))) == beat
    )


def test_a_description_becomes_the_metadata_message():
    message = DESCRIPTION.to_message("go2", incarnation=5, revision=2, stamp_ns=7 * S)
    again = deserialize(serialize(message), type(message))
    assert (again.agent, again.incarnation, again.revision, again.stamp.sec) == ("go2", 5, 2, 7)
    assert (again.accelerators, again.software) == (["h264_nvenc"], ["sfglab 1"])
    (sensor,) = again.sensors
    (stream,) = sensor.streams
    assert (sensor.name, sensor.model) == ("camera_front", "D435")
    assert all(getattr(stream, name) == value for name, value in asdict(STREAM).items())


@pytest.mark.parametrize(
    "topic", ["/local/go2/camera_front/color/ffmpeg", "/global/husky/camera_front/color/ffmpeg", "no name"]
)
def test_a_stream_that_does_not_cross_its_agents_border_is_refused(topic):
    stream = StreamDescription(topic=topic, type="sensor_msgs/msg/CompressedImage", codec="jpeg")
    description = AgentDescription(sensors=(SensorDescription(name="x", streams=(stream,)),))
    with pytest.raises(DescriptionError, match=topic):
        StatusSettings(agent="go2", description=description)


def test_sensors_that_share_a_name_are_refused():
    twice = AgentDescription(sensors=(SensorDescription(name="x"), SensorDescription(name="x")))
    with pytest.raises(DescriptionError, match="names that differ"):
        twice.check("go2")


def test_an_agents_name_is_checked_before_anything_starts():
    with pytest.raises(FqnError):
        StatusSettings(agent="camera")


def test_the_configuration_survives_the_way_to_its_process():
    config = StatusConfig(
        address=BusAddress(domain_id=3, interface="lo"),
        settings=StatusSettings(agent="go2", description=DESCRIPTION, schedule=Schedule(startup_s=2)),
        detect=False,
    )
    assert config_from_argument(StatusConfig, argument_of(config)) == config


@pytest.mark.parametrize("values", [{"wheels": 4}, {"sensors": [{"wheels": 4}]}, {"sensors": ["camera"]}])
def test_values_that_are_no_description_are_refused(values):
    with pytest.raises(DescriptionError):
        AgentDescription.from_values(values)

"""When an agent beats, what it says of itself, and its provider: paper A, section 4.2."""

import asyncio
import itertools
from functools import partial

import numpy as np
import pytest

from sfglab.bus.sim import run_simulated
from sfglab.component import beside
from sfglab.errors import InvalidValueError
from sfglab.fleet.discovery.config import DiscoverySettings, Timing
from sfglab.fleet.status import heartbeat
from sfglab.fleet.status.config import StatusSettings
from sfglab.fleet.status.description import (
    AgentDescription,
)
from sfglab.fleet.status.heartbeat import Heartbeat, Schedule
from sfglab.fleet.status.node import StatusProvider
from sfglab.messages import service_type
from sfglab.qos import LATCHED

S = 1_000_000_000
# As the paper prints them.
TOPIC = "/global/agent_heartbeat"
SERVICE = "/global/go2/get_metadata"
TYPE = "sfglab_interfaces/msg/AgentHeartbeat"
STARTUP_S = 4.5  # five whole periods of 1 s
CHANGE_S = 18.5  # when the description changes


async def metadata_of(node):
    client = node.create_client(heartbeat.GET_METADATA, SERVICE)
    response = await client.call(service_type(heartbeat.GET_METADATA).request(), timeout_s=60)
    client.close()
    assert (response.success, response.message) == (True, "")
    return response.metadata


async def provide(world):
    """Return when the provider started, what two subscribers received, and the service's answer."""
    received = {"first": [], "late": []}
    now = asyncio.get_running_loop().time

    def subscribe(node, name):
        def note(message):
            received[name].append((now(), Heartbeat.from_message(message)))

        node.create_subscription(TYPE, TOPIC, note, LATCHED)

    async with (
        world.node("status", host="robot") as robot,
        world.node("subscriber", host="station") as station,
    ):
        subscribe(station, "first")
        schedule = Schedule(startup_s=STARTUP_S)
        provider = StatusProvider(robot, StatusSettings(agent="go2", schedule=schedule))
        started_ns = robot.get_clock().now_ns()
        async with beside(provider.run()):
            await asyncio.sleep(CHANGE_S - 1)
            subscribe(station, "late")
            await asyncio.sleep(1)
            provider.update(AgentDescription(software=("new",)))
            await asyncio.sleep(5)
            answer = await metadata_of(station)
    return started_ns, received, answer


def test_a_status_provider_does_what_section_4_2_states():
    started_ns, received, answer = run_simulated(provide, seed=0)
    times_s, beats = zip(*received["first"], strict=True)
    # Each second, then each five seconds, and at once after a change.
    assert np.allclose(times_s, [0, 1, 2, 3, 4, 5, 10, 15, CHANGE_S, 20], atol=0.1)
    # A heartbeat announces the time until the next one.
    assert np.allclose([beat.period_s for beat in beats], [1] * 5 + [5, 5, 5, 1.5, 5], atol=0.1)
    assert [beat.phase for beat in beats] == [0] * 5 + [1] * 5
    assert {(beat.agent, beat.incarnation) for beat in beats} == {("go2", started_ns)}
    assert [beat.revision for beat in beats] == [0] * 8 + [1] * 2
    # A late joiner receives the last heartbeat at once.
    late_s, late = received["late"][0]
    assert late == beats[7]
    assert late_s < CHANGE_S - 0.5
    assert (answer.agent, answer.incarnation, answer.revision) == ("go2", started_ns, 1)
    assert answer.software == ["new"]


def test_the_papers_schedule_is_the_default_and_the_startup_phase_lasts_whole_periods():
    for schedule, instants in (
        (Schedule(), [*range(10), 10, 15, 20]),
        (Schedule(steady_period_s=4, startup_s=2.5), [0, 1, 2, 3, 7, 11]),
        (Schedule(startup_s=0), [0, 5, 10]),
    ):
        for now_s, next_s in itertools.pairwise(instants):
            assert schedule.next_ns(now_s * S) == next_s * S


@pytest.mark.parametrize(
    ("settings", "named"),
    [
        (partial(Schedule, startup_period_s=0), "heartbeat schedule, startup_period_s: given 0"),
        (partial(Timing, missed=0), "discovery, missed: given 0"),
        (partial(DiscoverySettings, agent="a", max_agents=901), "discovery, max_agents: given 901"),
    ],
)
def test_times_and_numbers_out_of_bounds_are_refused(settings, named):
    with pytest.raises(InvalidValueError, match=named):
        settings()

"""Paper A, section 4.2: the heartbeats of a status provider in virtual time, to the tenth of a second."""

import asyncio

import numpy as np

from sfglab.bus.sim import run_simulated
from sfglab.component import beside
from sfglab.fleet.status.description import AgentDescription
from sfglab.fleet.status.heartbeat import GET_METADATA, Heartbeat, Schedule
from sfglab.fleet.status.node import StatusProvider, StatusSettings
from sfglab.messages import service_type
from sfglab.qos import LATCHED

# As the paper prints them.
TOPIC = "/global/agent_heartbeat"
SERVICE = "/global/go2/get_metadata"
TYPE = "sfglab_interfaces/msg/AgentHeartbeat"
STARTUP_S = 4.5  # five whole periods of 1 s
CHANGE_S = 18.5  # when the description changes


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
        settings = StatusSettings(agent="go2", schedule=Schedule(startup_s=STARTUP_S))
        provider = StatusProvider(robot, settings)
        started_ns = robot.get_clock().now_ns()
        async with beside(provider.run()):
            await asyncio.sleep(CHANGE_S - 1)
            subscribe(station, "late")
            await asyncio.sleep(1)
            client = station.create_client(GET_METADATA, SERVICE)
            request = service_type(GET_METADATA).request()
            answer = await client.call(request, timeout_s=10)
            provider.update(AgentDescription(software=("new",)))
            await asyncio.sleep(5)
    return started_ns, received, answer.metadata


def test_a_status_provider_does_what_section_4_2_states():
    started_ns, received, answer = run_simulated(provide, seed=0)
    times_s, beats = zip(*received["first"], strict=True)
    # Each second, then each five seconds, and at once after a change.
    assert np.allclose(times_s, [0, 1, 2, 3, 4, 5, 10, 15, CHANGE_S, 20], atol=0.1)
    # A heartbeat announces the time until the next one.
    assert np.allclose([beat.period_s for beat in beats[5:]], [5, 5, 5, 1.5, 5], atol=0.1)
    assert [beat.phase for beat in beats] == [0] * 5 + [1] * 5
    assert {(beat.agent, beat.incarnation) for beat in beats} == {("go2", started_ns)}
    assert [beat.revision for beat in beats] == [0] * 8 + [1] * 2
    # A late joiner receives the last heartbeat at once.
    late_s, late = received["late"][0]
    assert late == beats[7]
    assert late_s < CHANGE_S - 0.5
    assert (answer.agent, answer.incarnation, answer.revision) == ("go2", started_ns, 0)

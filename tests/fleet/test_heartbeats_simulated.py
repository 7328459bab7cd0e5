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

PAPER_TOPIC = "/global/agent_heartbeat"
PAPER_SERVICE = "/global/{agent}/get_metadata"
HEARTBEAT_TYPE = "sfglab_interfaces/msg/AgentHeartbeat"


async def stated(world):
    """Return what section 4.2 states of a status provider, and whether it is so on the simulated bus."""
    heard = {"first": [], "late": []}
    now, startup_s = asyncio.get_running_loop().time, 4.5  # 5 whole periods
    async with (
        world.node("status", host="robot") as robot,
        world.node("ear", host="station") as ear,
    ):

        def listen(name):
            def note(message):
                heard[name].append((now(), Heartbeat.from_message(message)))

            ear.create_subscription(HEARTBEAT_TYPE, PAPER_TOPIC, note, LATCHED)

        listen("first")
        provider = StatusProvider(
            robot, StatusSettings(agent="go2", schedule=Schedule(startup_s=startup_s))
        )
        begun_ns = robot.get_clock().now_ns()
        async with beside(provider.run()):
            await asyncio.sleep(17.5)
            listen("late")
            await asyncio.sleep(1)
            client = ear.create_client(GET_METADATA, PAPER_SERVICE.format(agent="go2"))
            answer = (
                await client.call(service_type(GET_METADATA).request(), timeout_s=10)
            ).metadata
            provider.update(AgentDescription(software=("new",)))
            await asyncio.sleep(5)
    times, beats = zip(*heard["first"], strict=True)
    steady = [beat.period_s for beat in beats[5:]]
    starts, late = [("go2", begun_ns, revision) for revision in [0] * 8 + [1] * 2], heard["late"][0]
    expected_s = [0, 1, 2, 3, 4, 5, 10, 15, 18.5, 20]
    return {
        "1 s, then 5 s, and at once what changed": np.allclose(times, expected_s, atol=0.1),
        "the time until the next is announced": np.allclose(steady, [5, 5, 5, 1.5, 5], atol=0.1),
        "the phase": [beat.phase for beat in beats] == [0] * 5 + [1] * 5,
        "the agent, its start and its revision": [
            (b.agent, b.incarnation, b.revision) for b in beats
        ]
        == starts,
        "who joins late hears the last one at once": late[1] == beats[7] and late[0] < 18,
        "the service answers for the same start": (
            answer.agent,
            answer.incarnation,
            answer.revision,
        )
        == starts[0],
    }


def test_a_status_provider_does_what_section_4_2_states():
    found = run_simulated(stated, seed=0)
    assert [fact for fact, holds in found.items() if not holds] == []

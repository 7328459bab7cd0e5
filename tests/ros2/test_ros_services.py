"""Services and actions beside real rclpy on Fast DDS: of our own nodes, and across two routers."""

import asyncio
import signal
import statistics
import sys
from collections import Counter
from pathlib import Path

import psutil
import pytest
from beside import ANSWER_S, agents, asked, component, kill, started, until

from sfglab.bus import BusTimeoutError, Node
from sfglab.bus.address import BusAddress
from sfglab.bus.parameters import READ_ONLY, flat
from sfglab.bus.ros.services import PYTHON_VARIABLE
from sfglab.fields import to_json
from sfglab.fleet.decoder.config import DecoderConfig
from sfglab.messages import service_type

pytestmark = [pytest.mark.live, pytest.mark.ros]

CALLS = 1000
SET_BOOL = "std_srvs/srv/SetBool"
NUMBERS = [0, 1, 1, 2, 3, 5]
ENABLE, OURS_TOO, COUNT = "/global/one/enable", "/global/one/ours", "/global/one/count"
LATER, AT_ONCE = "/global/one/later", "/global/one/at_once"
DOMAINS = {"one": 31, "two": 32}
PROGRAM = "sfglab/bus/ros/program.py"
ENDED = {"succeeded": 4, "canceled": 5}
BESIDE = "ROS 2 beside each router"
netns = pytest.mark.netns
OURS = """
import asyncio, json, sys
from sfglab.bus import Node
from sfglab.component import claim_standard_output
from sfglab.messages import service_type

SET_BOOL = service_type("std_srvs/srv/SetBool")

async def main():
    report, loop = claim_standard_output(), asyncio.get_running_loop()
    async with Node("ours", domain_id=int(sys.argv[1]), interface="lo") as node:
        report({"is": "ready"})
        while line := await loop.run_in_executor(None, sys.stdin.readline):
            order = json.loads(line)
            if order["do"] == "serve":
                answer = lambda request: SET_BOOL.response(success=request.data, message="")
                node.create_service(SET_BOOL.name, order["service"], answer)
                report({"is": "serving"})
                continue
            client = node.create_client(SET_BOOL.name, order["service"])
            requests = [SET_BOOL.request(data=n % 2 == 1) for n in range(order["times"])]
            answers = [(await client.call(one, order["timeout_s"])).success for one in requests]
            report({"is": "called", "answers": answers})
            client.close()

asyncio.run(main())
"""


@pytest.fixture
def ros_node(peer):
    """A function that starts a real node with services and actions, which the test's block ends."""
    program = Path(__file__).with_name("service_peer.py")
    return lambda name, host=None, **values: peer(name, host, program=program, **values)


def node_of_ours(network, name):
    """A process on a host that serves and calls as rmw_cyclonedds does."""
    return started("ours", [sys.executable, "-c", OURS, str(DOMAINS[name])], network.hosts[name])


def programs(parents):
    """Return the programs of ROS 2 that processes of ours have started."""
    found = [child for parent in parents for child in parent.children(recursive=True)]
    return [one for one in found if any(word.endswith(PROGRAM) for word in one.cmdline())]


async def call(ros, times=1, timeout_s=10.0, service=ENABLE):
    return await asked(ros, "call", "called", service=service, times=times, timeout_s=timeout_s)


async def stalled(processes):
    for turn in (psutil.Process.suspend, psutil.Process.resume):
        list(map(turn, processes))
        await asyncio.sleep(1.0)


def alternating(times):
    return [n % 2 == 1 for n in range(times)]


@pytest.mark.feature(
    "Services of a node, as server and client (transport='ros')", condition="ROS 2 beside it"
)
async def test_a_node_serves_and_calls_and_its_program_is_repaired(ros_node, python, domain_id):
    service, heard = service_type(SET_BOOL), []

    def answer(request):
        heard.append(request.data)
        return service.response(success=request.data, message="")

    async def asked_by_us(client, timeout_s=ANSWER_S):
        return (await client.call(service.request(data=True), timeout_s)).success

    async with ros_node("ros") as ros, Node("us", domain_id=domain_id) as node:
        node.create_service(SET_BOOL, "/ours", answer, transport="ros")
        client = node.create_client(SET_BOOL, "/theirs", transport="ros")
        with pytest.raises(BusTimeoutError, match="no server was found"):
            await asked_by_us(client, 0.1)
        await asked(ros, "serve", "serving", service="/theirs")
        assert await asked_by_us(client)
        assert (await call(ros, 20, ANSWER_S, "/ours"))["answers"] == heard == alternating(20)
        stranger = node.create_client(SET_BOOL, "/theirs")

        async def told():
            with pytest.raises(BusTimeoutError) as raised:
                await asked_by_us(stranger, 0.2)
            return "only a server of rmw_fastrtps was found" in str(raised.value)

        await until(told)

        unknown = asyncio.get_running_loop().create_future()
        node.backend.ros.find("nowhere/srv/Nothing_Response", "us", unknown.set_result)
        assert "does not know nowhere/srv/Nothing" in await unknown

        (program,) = programs([psutil.Process()])
        program.send_signal(signal.SIGSTOP)
        lost = asyncio.create_task(asked_by_us(client, 1.0))
        await asyncio.sleep(0)
        kill(program)
        with pytest.raises(BusTimeoutError):
            await lost
        assert await asked_by_us(client)
        assert (await call(ros, 1, ANSWER_S, "/ours"))["answers"] == [False]
    assert not programs([psutil.Process()])


@netns
@pytest.mark.feature("Services across two routers", condition=BESIDE)
@pytest.mark.feature(
    "Services of rmw_fastrtps with nodes of sfglab, across two routers", condition=BESIDE
)
@pytest.mark.feature("Actions across two routers: feedback, cancel, result", condition=BESIDE)
async def test_services_and_actions_cross_two_routers(network, ros_node, python):
    async with agents(network, ros_node, DOMAINS) as ros:
        client, server, count = ros["two"], ros["one"], Counter()
        server.on_report = lambda report: count.update([report["is"]])
        await asked(server, "serve", "serving", service=ENABLE)
        called = await call(client, CALLS, ANSWER_S)
        assert called["answers"] == alternating(CALLS)
        sys.stdout.write(f"p50 {1e3 * statistics.median(called['took_s']):.1f} ms\n")
        async with node_of_ours(network, "one") as ours, node_of_ours(network, "two") as our_client:
            await asked(ours, "serve", "serving", service=OURS_TOO)
            await asked(server, "serve", "serving", service=AT_ONCE)
            for service in (ENABLE, OURS_TOO, AT_ONCE):
                both = [
                    asyncio.create_task(call(one, 50, ANSWER_S, service))
                    for one in (client, our_client)
                ]
                await stalled(programs(psutil.Process().children(recursive=True)))
                assert [one["answers"] for one in await asyncio.gather(*both)] == [
                    alternating(50)
                ] * 2
            await asked(server, "serve", "serving", service=LATER)
            earlier = asyncio.create_task(call(our_client, 500, ANSWER_S, LATER))
            await asyncio.sleep(0.3)  # rclpy must not take what answers those for its own server
            later = asyncio.create_task(call(client, 50, ANSWER_S, LATER))
            await asyncio.sleep(0.2)
            await stalled([psutil.Process(client.pid)])
            assert (await later)["answers"] == alternating(50)
            assert (await earlier)["answers"] == alternating(500)
        assert count["asked"] == CALLS + 750
        await perform(server, client)

        for program in programs(psutil.Process().children(recursive=True)):
            kill(program)

        async def repaired():
            return (await call(client, timeout_s=0.5))["answers"] == [False]

        await until(repaired)
        kill(server)
        assert (await call(client, timeout_s=1.0))["answers"] in ([None], [])


async def perform(server, client):
    await asked(server, "perform", "performing", action=COUNT)
    ended = await asked(client, "act", "acted", action=COUNT, order=4, cancel=False)
    assert (ended["status"], ended["numbers"]) == (ENDED["succeeded"], NUMBERS)
    assert ended["feedbacks"] == [NUMBERS[:n] for n in range(3, 7)]
    ended = await asked(client, "act", "acted", action=COUNT, order=1000, cancel=True)
    assert ended["status"] == ENDED["canceled"]
    assert len(ended["numbers"]) < 1000


@netns
@pytest.mark.feature("Services where no ROS 2 stands beside a router: not announced, which is said")
async def test_without_ros_2_nothing_is_announced_and_it_is_said(network, ros_node, capfd):
    async with agents(network, ros_node, DOMAINS) as ros:
        await asked(ros["one"], "serve", "serving", service=ENABLE)
        called, said = asyncio.create_task(call(ros["two"], timeout_s=3.0)), []

        async def both_said():
            said.extend(line for line in capfd.readouterr().err.splitlines() if ENABLE in line)
            return len(said) == 2

        await until(both_said)
        assert not (await called)["ready"]
    why = f"there is none here: source it, or name its interpreter in {PYTHON_VARIABLE}"
    assert said == 2 * [
        f"service {ENABLE} of rmw_fastrtps stays here: only ROS 2 can serve it, and {why}"
    ]


@pytest.mark.feature(
    "Parameters of router and decoder, to read (what `ros2 param` asks)",
    condition="ROS 2 beside it",
)
async def test_parameters_are_what_the_component_was_told(ros_node, python, domain_id):
    address = BusAddress(domain_id=domain_id)
    streams = ("/global/go2/camera_front/color/ffmpeg", "/global/pi1/camera_front/color/ffmpeg")
    config = DecoderConfig(
        remote=address, local=address, streams=streams, spare=False, parameters="ros"
    )
    async with component(None, "sfglab.fleet.decoder.node", config), ros_node("ros") as ros:
        read = await asked(ros, "parameters", "parameters", node="/agent_decoder")
    said = dict(flat(to_json(config)))
    assert read["values"] == said
    assert {
        name: said[name] for name in ("streams", "local.domain_id", "idle_timeout_s", "replay")
    } == {
        "streams": list(streams),
        "local.domain_id": domain_id,
        "idle_timeout_s": 1.0,
        "replay": True,
    }
    assert (read["read_only"], read["why"]) == (True, READ_ONLY)

"""Services between real processes, framed as rmw_cyclonedds does it."""

from __future__ import annotations

import asyncio

import pytest

from sfglab import bus
from sfglab.messages import default_message, message_type, service_type

pytestmark = pytest.mark.live

SERVICE = "sfglab_interfaces/srv/GetMetadata"
Request = service_type(SERVICE).request
Response = service_type(SERVICE).response
String = message_type("std_msgs/msg/String")

SERVER = """
async with Node("server", domain_id={domain_id}, interface="lo", lease_s=1.0) as node:
    response = service_type("sfglab_interfaces/srv/GetMetadata").response
    calls = 0
    async def answer(request):
        nonlocal calls
        calls += 1
        number = calls
        if number == 2:
            await asyncio.sleep(3600)
        if number == 3:
            raise LookupError("no metadata")
        metadata = default_message("sfglab_interfaces/msg/AgentMetadata")
        return response(success=True, message=str(number), metadata=metadata)
    import logging
    logging.disable()
    node.create_service("sfglab_interfaces/srv/GetMetadata", "/agent/get_metadata", answer)
    say(ready=True)
    await hear()
"""


def node(domain_id, name="here", **options):
    return bus.Node(name, domain_id=domain_id, interface="lo", **options)


def response(text):
    return Response(success=True, message=text, metadata=default_message("sfglab_interfaces/msg/AgentMetadata"))


def test_a_server_survives_slow_and_failing_requests_and_its_death_is_a_timeout(domain_id, child):
    async def scenario():
        async with node(domain_id) as here, child(SERVER.format(domain_id=domain_id)) as server:
            client = here.create_client(SERVICE, "/agent/get_metadata")
            with pytest.raises(bus.ServiceTimeoutError, match="no server was found"):
                await client.call(Request(), timeout_s=0.01)
            await server.hear()
            await client.wait_for_service()
            assert (await client.call(Request())).message == "1"
            for _ in range(2):  # one that takes too long, one that raises
                with pytest.raises(bus.ServiceTimeoutError, match=r"'/agent/get_metadata'.*did not respond"):
                    await client.call(Request(), timeout_s=0.2)
            assert (await client.call(Request())).message == "4"
            await server.kill()
            with pytest.raises(bus.ServiceTimeoutError, match=r"has gone|did not respond"):
                await client.call(Request(), timeout_s=0.2)
            assert await client._pair.changed.wait_until(lambda: not client.service_is_ready(), 60)

    asyncio.run(scenario())


def test_concurrent_calls_of_two_clients_get_their_own_answers(domain_id):
    async def scenario():
        release = asyncio.Event()
        waiting = 0

        async def answer(request):
            nonlocal waiting
            waiting += 1
            number = waiting
            if waiting == 20:
                release.set()
            await release.wait()  # so all twenty are open at once
            await asyncio.sleep(0.001 * (20 - number))  # and are answered in another order
            return response(str(number))

        async with node(domain_id) as here, node(domain_id, "there") as there:
            service = there.create_service(SERVICE, "/s", answer)
            clients = [here.create_client(SERVICE, "/s"), there.create_client(SERVICE, "s")]
            calls = [client.call(Request()) for client in clients for _ in range(10)]
            answers = [int(r.message) for r in await asyncio.gather(*calls)]
            assert sorted(answers) == list(range(1, 21))
            assert service.last_error is None

    asyncio.run(scenario())


def test_a_plain_handler_works_and_a_wrong_response_is_reported(domain_id):
    async def scenario():
        reported = []
        results = [response("plain"), String(data="no response")]
        async with node(domain_id, on_error=lambda error, where: reported.append((error, where))) as here:
            here.create_service(SERVICE, "/s", lambda _: results.pop(0))
            client = here.create_client(SERVICE, "/s")
            assert (await client.call(Request())).message == "plain"
            with pytest.raises(bus.ServiceTimeoutError):
                await client.call(Request(), timeout_s=0.1)
            ((error, where),) = reported
            assert (type(error), where) == (bus.WrongTypeError, "service '/s'")
            with pytest.raises(bus.WrongTypeError, match="GetMetadata_Request"):
                await client.call(String(data="no request"))

    asyncio.run(scenario())


def test_closing_a_client_ends_its_calls(domain_id):
    async def scenario():
        async with node(domain_id) as here:
            asked = asyncio.Event()

            async def never(request):
                asked.set()
                await asyncio.Event().wait()

            here.create_service(SERVICE, "/s", never)
            client = here.create_client(SERVICE, "/s")
            call = asyncio.create_task(client.call(Request()))
            await asyncio.wait_for(asked.wait(), 60)
            client.close()
            with pytest.raises(bus.ClosedError, match=r"client '/s'"):
                await call
            with pytest.raises(bus.ClosedError):
                await client.call(Request())

    asyncio.run(scenario())


def test_the_wire_shows_rmw_cyclonedds_names_and_header(domain_id):
    async def scenario():
        async with node(domain_id) as here:
            here.create_service(SERVICE, "/s", lambda _: response("x"))
            client = here.create_client(SERVICE, "/s")
            await client.call(Request())
            found = {(e.kind.value, e.dds_topic, e.type, e.user_data[:9]) for e in here.graph.endpoints()}
            request, reply = (f"{SERVICE}_{half}" for half in ("Request", "Response"))
            assert found == {
                ("publisher", "rq/sRequest", request, b"clientid="),
                ("subscription", "rq/sRequest", request, b"serviceid"),
                ("publisher", "rr/sReply", reply, b"serviceid"),
                ("subscription", "rr/sReply", reply, b"clientid="),
            }

    asyncio.run(scenario())

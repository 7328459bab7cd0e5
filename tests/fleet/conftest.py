"""Addresses in domains that no other test uses."""

import pytest

from sfglab.bus.address import BusAddress
from sfglab.messages import default_message, service_type

SERVICE = "std_srvs/srv/SetBool"


@pytest.fixture
def domains(free_domains):
    """Addresses in two domains: of remote agents, and of local nodes."""
    remote, local = free_domains(2)
    return BusAddress(domain_id=remote, interface="lo"), BusAddress(domain_id=local, interface="lo")


@pytest.fixture
def calls_cross():
    """Serve at each of two agents' nodes, call the service from the other one, and expect the right replies."""
    types = service_type(SERVICE)

    def answers(name):
        return lambda asked: default_message(types.response, success=asked.data, message=name)

    async def cross(*nodes):
        for node in nodes:
            node.create_service(SERVICE, f"/global/{node.name}/s", answers(node.name))
        for node, other in (nodes, nodes[::-1]):
            client = node.create_client(SERVICE, f"/global/{other.name}/s")
            for number in range(20):
                request = types.request(data=number % 2 == 0)
                response = await client.call(request, timeout_s=30)
                assert (response.success, response.message) == (request.data, other.name)

    return cross

"""Addresses in domains that no other test uses."""

import pytest

from sfglab.bus.address import BusAddress


@pytest.fixture
def domains(free_domains):
    """Addresses in two domains: of remote agents, and of local nodes."""
    remote, local = free_domains(2)
    return BusAddress(domain_id=remote, interface="lo"), BusAddress(domain_id=local, interface="lo")

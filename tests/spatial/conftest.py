"""Fixtures of the spatial tests: DDS domains of their own."""

from __future__ import annotations

import itertools
import os
import socket
from contextlib import closing, suppress

import pytest

_counter = itertools.count(os.getpid() * 11)


@pytest.fixture
def domain_id():
    """A DDS domain that no other test of this run uses."""
    for _ in range(100):
        domain = 100 + next(_counter) % 100
        with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as probe, suppress(OSError):
            probe.bind(("", 7400 + 250 * domain))
            return domain
    pytest.fail("the ports of all DDS domains from 100 to 199 are taken")

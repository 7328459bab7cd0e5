"""DDS domains of a test's own."""

from __future__ import annotations

import itertools
import os
import socket
from contextlib import closing, suppress

import pytest

FIRST, COUNT = 20, 80  # from 102 on a domain's ports lie among those that Linux gives to anybody who asks
_counter = itertools.count(os.getpid() * 13)


def _is_free(domain: int) -> bool:
    """Tell whether nobody on this machine holds a domain's first port (RTPS 2.5, clause 9.6.2.3)."""
    with closing(socket.socket(socket.AF_INET, socket.SOCK_DGRAM)) as probe, suppress(OSError):
        probe.bind(("", 7400 + 250 * domain))
        return True
    return False


@pytest.fixture
def free_domains():
    """A function that returns so many DDS domains that nobody uses, other ones at each call."""

    def take(count: int) -> list[int]:
        candidates = (FIRST + next(_counter) % COUNT for _ in range(COUNT))
        found = list(itertools.islice(filter(_is_free, candidates), count))
        assert len(found) == count, f"the ports of all DDS domains {FIRST} to {FIRST + COUNT - 1} are taken"
        return found

    return take


@pytest.fixture
def domain_id(free_domains):
    """A DDS domain that nobody uses."""
    return free_domains(1)[0]

"""An agent at a terminal, with its real router: what is said, how it is ended, and what it refuses."""

import asyncio
import signal
import subprocess
import sys

import pytest

from sfglab.bus.address import BusAddress
from sfglab.fleet.agent.app import ComponentError, serve_agent
from sfglab.fleet.agent.plan import AgentConfig

pytestmark = [pytest.mark.live]

DEADLINE_S = 60

TERMINAL = """
import sys
from sfglab.bus.address import BusAddress
from sfglab.fleet.agent.app import serve_agent
from sfglab.fleet.agent.plan import AgentConfig
from sfglab.component import run
local, remote = (BusAddress(domain_id=int(domain), interface="lo") for domain in sys.argv[1:])
config = AgentConfig(agent="go2", local=local, remote=remote, components=("router",))
run(serve_agent(config, lambda line: print(line, flush=True)))
"""


@pytest.fixture
def domains(free_domains):
    return tuple(free_domains(2))


@pytest.fixture
def terminal(domains):
    """An agent with a router, as a person starts it, ready."""
    argv = [sys.executable, "-c", TERMINAL, *map(str, domains)]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, text=True) as process:
        try:
            local, remote = domains
            first = f"agent go2: its own domain {local} on lo, the global domain {remote} on lo; starting\n"
            assert process.stdout.readline() == first
            assert process.stdout.readline() == "router: ready\n"
            assert process.stdout.readline() == "agent go2: ready, end it with Ctrl-C\n"
            yield process
        finally:
            process.kill()


@pytest.mark.parametrize(
    "numbers", [[signal.SIGINT], [signal.SIGTERM], [signal.SIGHUP], 2 * [signal.SIGINT]], ids=str
)
def test_a_signal_ends_an_agent_in_order_and_a_second_interrupt_is_no_error(terminal, numbers):
    for number in numbers:
        terminal.send_signal(number)
    assert terminal.stdout.read() == "agent go2: everything has ended\n"
    assert terminal.wait(DEADLINE_S) == 0


def test_a_second_agent_on_the_same_domains_is_refused_in_one_sentence(terminal, domains):
    said = []
    local, remote = (BusAddress(domain_id=domain, interface="lo") for domain in domains)
    config = AgentConfig(agent="go2", local=local, remote=remote, components=("router",))
    between = "router between the domains {} and {}: process ".format(*domains)
    with pytest.raises(ComponentError, match=f"^{between}"):
        asyncio.run(serve_agent(config, said.append))
    assert len(said) == 1, "nothing but the beginning is said"

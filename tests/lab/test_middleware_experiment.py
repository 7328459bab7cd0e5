"""The middleware experiment: known measurements give known tables, and the formula counts simulated endpoints."""

import asyncio
from functools import partial

import pytest
from made_logs import made_run

from sfglab.bus.sim import run_simulated
from sfglab.component import beside
from sfglab.errors import InvalidValueError
from sfglab.fleet.discovery.config import DiscoverySettings
from sfglab.fleet.discovery.node import AgentDiscoverer
from sfglab.fleet.router.config import RouterSettings
from sfglab.fleet.router.node import Router
from sfglab.fleet.status.config import StatusSettings
from sfglab.fleet.status.node import StatusProvider
from sfglab.lab.bench import Options
from sfglab.lab.experiments.middleware import BEYOND, costs, exp, fleets
from sfglab.lab.experiments.middleware.experiment import (
    ASKING,
    DATA_WAYS,
    HUB,
    PEERS,
    PUBLISHED,
    STANDARD,
    WAYS,
    fleets_of,
)
from sfglab.lab.experiments.middleware.live import shared_address
from sfglab.lab.experiments.middleware.results import announcements, endpoints, unit_costs

NODES = 4


async def endpoints_of_simulated(way, count, world):
    """Run agents with routers until each has discovered all others; return the endpoints in the global domain."""
    found = {f"agent{number}": set() for number in range(count)}
    publishes = way == PUBLISHED
    bodies = []
    for agent, peers in found.items():
        world.host(agent)
        node = partial(world.node, host=agent, domain_id=1, reach="host")
        near = node("router", process="router")
        far = world.node("router", process="router", host=agent)
        status = StatusSettings(agent=agent, publish_description=publishes)
        settings = DiscoverySettings(agent=agent, use_published_descriptions=publishes)
        bodies += [
            Router(near, far, RouterSettings(agent=agent)),
            StatusProvider(node("status"), status),
            AgentDiscoverer(
                node("discoverer"), settings, on_event=lambda e, p=peers: p.add(e.agent)
            ),
        ]
    async with beside(*(body.run() for body in bodies)):
        async with asyncio.timeout(60):
            while any(len(peers) < count - 1 for peers in found.values()):
                await asyncio.sleep(0.01)
        return world.announced()


@pytest.mark.parametrize("count", [2, 5])
@pytest.mark.parametrize("way", [ASKING, PUBLISHED])
def test_the_formula_counts_the_endpoints_of_simulated_agents(way, count):
    counted = run_simulated(partial(endpoints_of_simulated, way, count))
    assert counted == endpoints(way, count, NODES)


def test_an_agent_receives_the_announcements_of_the_endpoints_of_all_others():
    assert announcements(PUBLISHED, 6, NODES) == 5 * 5
    assert announcements(ASKING, 6, NODES) == pytest.approx(5 * (4 + 2 * 5))
    assert announcements(STANDARD, 6, NODES) == 5 * NODES * 18 * NODES
    assert announcements(ASKING, 1000, NODES) > announcements(STANDARD, 1000, NODES)


@pytest.fixture
def run(tmp_path):
    """A run with known times, bytes and costs."""
    cells, hosts, flows = [], [], []
    for cell, way in enumerate(WAYS):
        kind = {"cell": cell, "mode": way, "agents": 6, "talkers": 2, "listeners": 2}
        cells.append(kind | {"cpu_s": 6.0, "window_s": 9.0})
        for host in range(6):
            agent = {"cell": cell, "host": host, "censored": way == PEERS and host == 0}
            hosts.append(agent | {"resolved_s": 1.0 + cell, "own_bytes": 1e3 * (1 + cell)})
    for repeat in range(5):
        for kind in ("message", "image"):
            for place, way in enumerate(DATA_WAYS):
                flow = {"repeat": repeat, "way": way, "kind": kind, "sent": 50, "received": 49}
                # A repetition is slow for all ways.
                flows.append(flow | {"latency_ms": 1.0 + place + repeat, "cpu_ms": 2.0 + place})
    sessions = {"agents": 1000, "known_s": 12.0, "presence_bytes": 4e5, "described_bytes": 2e6}
    tables = {"cell": cells, "host": hosts, "flow": flows}
    tables["sessions"] = [{"agents": 10}, sessions]
    return made_run(exp, tmp_path / "made.mcap", tables)


def test_fleets_and_costs_are_medians_by_way(run):
    found = fleets(run).set_index("way")
    assert {way: found.loc[way, "own_bytes"].value for way in WAYS} == dict(
        zip(WAYS, range(1000, 6000, 1000), strict=True)
    )
    assert found["given up"].to_dict() == dict.fromkeys(WAYS, 0) | {PEERS: 1}
    cost = costs(run).set_index(["kind", "way"])
    assert cost.loc[("image", HUB), "cpu_ms"].value == 4.0
    beyond = cost.loc[("message", HUB), BEYOND]
    assert (beyond.value, beyond.low, beyond.high) == (1.0, 1.0, 1.0)
    assert cost.loc[("message", HUB), "latency_ms"].high > 5


def test_an_announcement_costs_what_the_largest_fleet_received_and_computed(run):
    found = unit_costs(run)
    assert found["own_bytes"].to_dict() == pytest.approx(
        {
            way: 1e3 * (1 + place) / announcements(way, 6, NODES)
            for place, way in enumerate((STANDARD, ASKING, PUBLISHED))
        }
    )
    assert set(found["resolved_s"]) == {1.0 / announcements(STANDARD, 6, NODES)}


def test_both_figures_are_drawn_and_name_the_numbers(run):
    figures = {name: figure.get_suptitle() for name, (figure, _) in exp.figures(run).items()}
    assert "1,000 Zenoh sessions discover each other within 12.0 s" in figures["middleware_scale"]
    assert "2.00 ms longer between Zenoh peers, and" in figures["middleware_cost"]


def test_all_ways_are_measured_next_to_each_other():
    config = exp.config(seed=3, repeats=2)
    cells = fleets_of(config)
    assert len(set(cells)) == len(cells) == 2 * 2 * len(WAYS)
    for first in range(0, len(cells), len(WAYS)):
        group = cells[first : first + len(WAYS)]
        assert {cell.mode for cell in group} == {*WAYS}
        assert len({(cell.agents, cell.repeat) for cell in group}) == 1


def test_more_sessions_than_a_hub_accepts_are_refused():
    with pytest.raises(InvalidValueError, match="sessions"):
        exp.config(sessions=[1001])


def test_agents_meet_at_the_hub_or_at_the_first_peer():
    class Hosts:
        def address(self, host):
            return f"address_of_{host}"

        def interface(self, _host):
            return "eth0"

    hosts = Hosts()
    assert shared_address(hosts, HUB, "agent_2").config().connect == ("tcp/address_of_hub:7447",)
    first, second = (shared_address(hosts, PEERS, f"agent_{n}").config() for n in (1, 2))
    assert (first.connect, second.connect) == ((), ("tcp/address_of_agent_1:7447",))
    assert shared_address(hosts, ASKING, "agent_2").interface == "eth0"


def smoke(path, separate=None, **changes):
    return asyncio.run(
        exp.run("smoke", path=path / "run.mcap", options=Options(separate=separate), **changes)
    )


def test_without_separate_hosts_nothing_is_passed_off_as_live(tmp_path):
    run = smoke(tmp_path, separate=False)
    assert all(run[table].empty for table in ("cell", "host", "sessions", "flow"))
    assert exp.figures(run) == {}


@pytest.mark.live
@pytest.mark.netns
@pytest.mark.zenoh
@pytest.mark.slow
def test_a_run_measures_fleets_sessions_and_flows_of_all_ways(tmp_path):
    run = smoke(tmp_path)
    assert not run["host"]["censored"].any()
    assert set(run["cell"]["mode"]) == {*WAYS}
    assert (run["host"]["own_bytes"] > 500).all()
    [sessions] = run["sessions"].itertuples()
    assert sessions.descriptions == sessions.agents
    # A heartbeat of 300 B of each other session, and its description of 1,200 B.
    assert sessions.presence_bytes > 64 * (sessions.agents - 1)
    assert sessions.described_bytes - sessions.presence_bytes > 1200 * (sessions.agents - 1)
    received = run["flow"].set_index(["kind", "way"])["received"]
    assert len(received) == 2 * len(DATA_WAYS)
    # A busy machine drops images.
    assert (received["message"] > 0).all()

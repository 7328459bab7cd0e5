"""The discovery experiment: known fleets give known claims."""

import asyncio
import os
import signal
import subprocess
import sys
from itertools import groupby, product

import pytest
from made_logs import CLAIMS, made_run

from sfglab.bus.address import BusAddress
from sfglab.errors import InvalidValueError
from sfglab.lab.bench import Options
from sfglab.lab.claims import How, Verdict, judge
from sfglab.lab.experiments.discovery import exp, results
from sfglab.lab.experiments.discovery.experiment import (
    LAUNCHED,
    ROUTED,
    STANDARD,
    Cell,
    Stage,
    cells_of,
    host_names,
)
from sfglab.lab.experiments.discovery.live import ROUTER, LiveFleet
from sfglab.lab.testbed import Testbed
from sfglab.lab.workers.ros_nodes import LISTENER, TALKER, RosNodesConfig, endpoints_of
from sfglab.processes import Member, ProcessFailedError, ProcessGroup

TABLES = ("cell", "host")


def fleet(cell, mode, agents, pace_s=1.0, *, nodes=10, seconds=1.0, received=1.0, censored=False):
    """Return rows of a live fleet by table."""
    kind = {"cell": cell, "mode": mode, "agents": agents, "repeat": cell, "pace_s": pace_s}
    kind |= {"talkers": nodes, "listeners": nodes, "window_s": 10.0, "cpu_s": 6.0}
    agent = {"cell": cell, "resolved_s": seconds, "own_bytes": received, "censored": censored}
    return {"cell": [kind], "host": [agent | {"host": host} for host in range(agents)]}


@pytest.fixture
def made(tmp_path):
    """Give a function that returns the run whose log holds some fleets."""

    def make(*fleets, name="made.mcap"):
        tables = {name: [row for one in fleets for row in one.get(name, ())] for name in TABLES}
        return made_run(
            exp, tmp_path / name, {table: rows for table, rows in tables.items() if rows}
        )

    return make


@pytest.fixture
def run(made):
    """A run with known times and bytes; fleets of few nodes, and those started at once, must not be mixed in."""
    sparse = []
    for nodes in (1, 2, 3):
        received = 36e6 * (nodes / 10) ** 2
        sparse.append(fleet(10 + nodes, STANDARD, 6, 0.0, nodes=nodes, received=received))
    return made(
        fleet(0, LAUNCHED, 2, seconds=1.2),
        fleet(1, LAUNCHED, 6, seconds=1.6, received=36e4),
        fleet(2, LAUNCHED, 6, 0.0, seconds=14.4),
        fleet(3, ROUTED, 2, seconds=0.2),
        fleet(4, ROUTED, 6, seconds=0.6, received=36e3),
        fleet(5, ROUTED, 6, 0.0, seconds=9.0),
        fleet(6, ROUTED, 12, nodes=1),
        *sparse,
    )


def test_the_claims_are_those_of_the_largest_fleets_at_a_pace_with_the_papers_nodes(run):
    claims = exp.measure(run)
    assert {one.how for one in claims.values()} == {How.LIVE}
    values = {name.removeprefix("A-DISC-"): one.estimate.value for name, one in claims.items()}
    ours = {"TIME-OURS": 0.6, "BYTES-OURS": 3.0}
    assert values == pytest.approx({"TIME": 1.6, "BYTES": 2.0, **ours})
    grows = {"s at 2 agents": 1.2, "times as long at 6 agents as at 2": 1.6 / 1.2}
    assert claims["A-DISC-TIME"].ends == pytest.approx(grows)
    assert claims["A-DISC-BYTES"].ends == pytest.approx({"MB received by standard": 36.0})
    assert claims["A-DISC-BYTES"].under["with 4 and 6 nodes"].value == pytest.approx(2.0)


def test_what_another_pace_changes_is_undecided(made):
    fleets = [
        fleet(0, LAUNCHED, 2, seconds=1.2),
        fleet(1, LAUNCHED, 6, seconds=1.6),
        fleet(2, LAUNCHED, 6, 2.0, seconds=4.8),
    ]
    for cells, verdict in ((fleets[:2], Verdict.REPRODUCED), (fleets, Verdict.UNDECIDED)):
        measured = exp.measure(made(*cells, name=verdict.name))["A-DISC-TIME"]
        assert judge(CLAIMS["A-DISC-TIME"], measured) is verdict


def test_a_fleet_of_one_agent_is_refused():
    with pytest.raises(InvalidValueError, match="agents"):
        exp.config(stages=[{"mode": STANDARD, "agents": [1]}])


def test_agents_that_were_given_up_are_counted(made):
    run = made(fleet(0, LAUNCHED, 6, censored=True), fleet(1, ROUTED, 6))
    assert results.fleet_table(run)["agents given up"].tolist() == [6, 0]
    claims = exp.measure(run)
    assert "6 of 6 agents were given up" in claims["A-DISC-TIME"].reason
    assert "given up" not in claims["A-DISC-TIME-OURS"].reason


def test_fleets_of_two_or_started_at_once_do_not_answer_claims_about_six(made):
    live = []
    for mode in (STANDARD, LAUNCHED, ROUTED):
        live += [fleet(len(live), mode, 2), fleet(len(live) + 1, mode, 6, 0.0)]
    assert exp.measure(made(*live)) == {}


def test_standard_and_routed_fleets_of_one_size_are_run_side_by_side():
    stages = (
        Stage(mode=STANDARD, agents=(2, 3)),
        Stage(mode=ROUTED, agents=(2, 3), repeats=2),
        Stage(mode=ROUTED, agents=(2,), talkers=1, listeners=1),
    )
    for seed in range(5):
        cells = cells_of(stages, seed)
        assert len(set(cells)) == 2 + 4 + 1
        groups = [size for size, _ in groupby(cells, lambda cell: (cell.agents, cell.talkers))]
        assert sorted(groups) == [(2, 1), (2, 10), (3, 10)]


@pytest.mark.parametrize("role", [TALKER, LISTENER])
def test_a_demo_node_has_the_eighteen_endpoints_of_humble(role):
    plans = {(plan.topic, plan.writer) for plan in endpoints_of(role, "/a/n", "/a/chatter")}
    services = {(topic, writes) for topic, writes in plans if topic.startswith(("rq/", "rr/"))}
    assert len(services) == 12
    assert ("rq/a/n/get_parametersRequest", False) in services
    assert all(writes is topic.startswith("rr/") for topic, writes in services)
    both_ways = product(("ros_discovery_info", "rt/parameter_events"), (False, True))
    own = {("rt/rosout", True), ("rt/a/chatter", role == TALKER)}
    assert plans - services == {*both_ways, *own}


@pytest.mark.live
async def test_ros_nodes_of_two_agents_find_each_other_completely():
    def member(name):
        address = BusAddress(domain_id=83, interface="lo")
        config = RosNodesConfig(
            namespace=f"/{name}", address=address, talkers=2, listeners=1, peers=1
        )
        return Member(name=name, module="sfglab.lab.workers.ros_nodes", config=config)

    async with ProcessGroup(map(member, "ab")) as group:
        for found in (await group.ask("resolved", timeout_s=60, do="start")).values():
            assert (found["endpoints"], found["announcements"]) == (3 * 18, 6)


def test_an_idle_component_is_loaded_before_it_starts_and_keeps_its_orders(tmp_path):
    (tmp_path / "toy.py").write_text(
        "import sys\nassert sys.argv[1:2] != ['told']\n"
        "def main():\n    print(sys.argv[1], sys.stdin.readline().strip(), flush=True)\n"
    )
    argv = [sys.executable, "-m", "sfglab.lab.workers.idle", "toy", "told"]
    environment = {**os.environ, "PYTHONPATH": f"{tmp_path}:{os.environ.get('PYTHONPATH', '')}"}
    for orders, started in (("start\nfirst order\n", "told first order\n"), ("", "")):
        done = subprocess.run(
            argv, input=orders, env=environment, capture_output=True, text=True, check=True
        )
        assert done.stdout == f'{{"is": "idle"}}\n{started}'


def short(path, *modes, separate=None, **changes):
    stages = tuple(Stage(mode=mode, agents=(2,), talkers=1, listeners=1) for mode in modes)
    changes = {"stages": stages, **changes}
    return asyncio.run(
        exp.run("smoke", path=path / "run.mcap", options=Options(separate=separate), **changes)
    )


@pytest.mark.live
@pytest.mark.netns
def test_a_fleet_that_takes_too_long_is_given_up_and_marked(tmp_path):
    run = short(tmp_path, STANDARD, timeout_s=0.001)
    assert run["host"]["censored"].all()
    assert (run["host"]["resolved_s"] < 5).all()


@pytest.mark.live
@pytest.mark.netns
async def test_a_router_that_dies_is_noticed_long_before_the_time_limit():
    class Broken(LiveFleet):
        async def _begin(self, host):
            await super()._begin(host)
            self[f"{host}, {ROUTER}"].signal(signal.SIGKILL)

    cell = Cell(mode=ROUTED, agents=2, talkers=1, listeners=1, repeat=0)
    with Testbed(*host_names(2)) as testbed:
        async with Broken(cell, testbed, multicast="default") as fleet:
            with pytest.raises(ProcessFailedError, match="router"):
                await asyncio.wait_for(fleet.measure(300.0), 60)


def test_without_separate_hosts_nothing_is_passed_off_as_live(tmp_path):
    run = short(tmp_path, STANDARD, separate=False)
    assert run["cell"].empty
    assert run.metadata("hosts")["separate"] is False
    assert exp.measure(run) == {}

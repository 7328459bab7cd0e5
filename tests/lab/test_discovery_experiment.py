"""The discovery experiment: known fleets give known claims, simulated ones grow as the model says."""

import asyncio
import json
import os
import signal
import subprocess
import sys

import pytest
from made_logs import CLAIMS, made_run

from sfglab.bus.address import BusAddress
from sfglab.errors import InvalidValueError, SfglabError
from sfglab.lab.bench import Options
from sfglab.lab.claims import How, Verdict, judge
from sfglab.lab.experiments.discovery import Fleet, exp, results
from sfglab.lab.experiments.discovery import simulated as world
from sfglab.lab.experiments.discovery.experiment import (
    LAUNCHED,
    PUBLISHING,
    QUERYING,
    ROUTED,
    STANDARD,
    Cell,
    Scale,
    Stage,
    cells_of,
    host_names,
)
from sfglab.lab.experiments.discovery.live import ROUTER, LiveFleet
from sfglab.lab.testbed import Testbed
from sfglab.lab.workers.ros_nodes import LISTENER, TALKER, RosNodesConfig, endpoints_of
from sfglab.processes import Member, ProcessFailedError, ProcessGroup

NODES = {"talkers": 10, "listeners": 10}
TABLES = ("cell", "host", "simulated")


def known(mode: str, agents: int, host: int) -> tuple[float, float]:
    """Seconds and bytes of an agent: standard takes longer the later the agent, routed is alike."""
    if mode == LAUNCHED:
        return 1 + 0.1 * agents, 1e4 * agents**2
    return (
        (10.0 * agents + host, 1e6 * agents**2)
        if mode == STANDARD
        else (0.1 * agents, 1e3 * agents**2)
    )


def fleet(cell, mode, agents, pace_s=1.0, *, slower=1, censored=False, **nodes):
    """Return rows of a live fleet by table, so many times slower than known; bytes are for 10 + 10."""
    hosts = []
    for host in range(agents):
        seconds, received = known(mode, agents, host)
        row = {"cell": cell, "host": host, "resolved_s": slower * seconds, "censored": censored}
        hosts.append({**row, "own_bytes": received * (nodes.get("talkers", 10) / 10) ** 2})
    kind = {"cell": cell, "mode": mode, "agents": agents, "repeat": cell, **NODES}
    kind["pace_s"] = pace_s
    times = {"window_s": 10.0, "cpu_s": 6.0}
    return {"cell": [{**kind, **times, **nodes}], "host": hosts}


def simulated(mode, agents, seed):
    """Return rows of a simulated fleet by table."""
    rows = []
    for host in range(agents):
        seconds, _ = known(mode, agents, host)
        row = {"mode": mode, "agents": agents, "seed": seed, "host": host, **NODES}
        rows.append({**row, "resolved_s": seconds})
    return {"simulated": rows}


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
    """A run with known figures; fleets of few nodes, and those started at once, must not be mixed in."""
    fleets = [
        (STANDARD, 2),
        (STANDARD, 6),
        *[(mode, n) for mode in (ROUTED, LAUNCHED) for n in (2, 6, 2, 6)],
    ]
    cells = [fleet(i, *one) for i, one in enumerate(fleets)]
    few = fleet(len(cells), ROUTED, 12, talkers=1, listeners=1)
    once = [
        fleet(20 + i, mode, 6, 0.0, slower=9) for i, mode in enumerate((STANDARD, LAUNCHED, ROUTED))
    ]
    sparse = [fleet(30 + n, STANDARD, 6, 0.0, talkers=n, listeners=n) for n in (1, 2, 3)]
    return made(*cells, few, *once, *sparse, simulated(ROUTED, 100, 0))


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
    table = results.fleet_table(run).set_index(["method", "agents", "time between starts (s)"])
    standard = table.loc[("plain ROS 2", 6, 1.0)]
    assert standard["discovery time, median (s)"] == 62.5
    assert standard["cores busy, mean"] == pytest.approx(0.6)
    at_once = table.loc[("paper's method", 6, 0.0)]
    assert at_once["discovery time, median (s)"] == pytest.approx(14.4)


def test_what_another_pace_changes_is_undecided(made):
    fleets = [fleet(0, LAUNCHED, 2), fleet(1, LAUNCHED, 6), fleet(2, LAUNCHED, 6, 2.0, slower=3)]
    for cells, verdict in ((fleets[:2], Verdict.REPRODUCED), (fleets, Verdict.UNDECIDED)):
        measured = exp.measure(made(*cells, name=verdict.name))["A-DISC-TIME"]
        assert judge(CLAIMS["A-DISC-TIME"], measured) is verdict


@pytest.mark.parametrize(
    ("field", "change"),
    [("agents", [1]), ("talkers", 0), ("listeners", 0), ("simulated", [1]), ("simulated", [1001])],
)
def test_a_fleet_of_one_agent_too_many_or_without_nodes_is_refused(field, change):
    changes = {"stages": [{"mode": STANDARD, "agents": [2], field: change}]}
    if field == "simulated":
        changes = {"simulated": {"agents": change}}
    with pytest.raises(InvalidValueError, match=field):
        exp.config(**changes)


def test_a_simulated_fleet_that_is_not_complete_in_time_says_so(monkeypatch):
    monkeypatch.setattr(world, "LIMIT_S", 0.01)
    with pytest.raises(SfglabError, match=r"of 3 simulated agents had discovered all others"):
        world.simulate_fleet(Fleet(mode=ROUTED, agents=3), 0)


def test_agents_that_were_given_up_are_counted(made):
    pairs = [fleet(3, LAUNCHED, 2), fleet(4, ROUTED, 2)]
    fleets = [fleet(0, STANDARD, 6), fleet(1, LAUNCHED, 6, censored=True), fleet(2, ROUTED, 6)]
    run = made(*fleets, *pairs)
    table = results.fleet_table(run).set_index(["method", "agents"])["agents given up"]
    assert table.to_dict() == {
        ("paper's method", 2): 0,
        ("paper's method", 6): 6,
        ("plain ROS 2", 6): 0,
        ("sfglab variant", 2): 0,
        ("sfglab variant", 6): 0,
    }
    claims = exp.measure(run)
    assert "6 of 6 agents were given up" in claims["A-DISC-TIME"].reason
    assert "given up" not in claims["A-DISC-TIME-OURS"].reason


def test_fleets_of_two_started_at_once_or_simulated_do_not_answer_claims_about_six(made):
    fleets = [(mode, *how) for mode in (STANDARD, LAUNCHED, ROUTED) for how in ((2, 1.0), (6, 0.0))]
    live = [fleet(i, *one) for i, one in enumerate(fleets)]
    assert (
        exp.measure(made(*live, *(simulated(mode, 6, 0) for mode in (QUERYING, PUBLISHING)))) == {}
    )


def test_standard_and_routed_fleets_of_one_size_are_run_side_by_side():
    stages = (
        Stage(mode=STANDARD, agents=(2, 3)),
        Stage(mode=ROUTED, agents=(2, 3, 5), repeats=2),
        Stage(mode=ROUTED, agents=(2,), talkers=1, listeners=1),
    )
    cells = cells_of(stages, 1)
    assert len(cells) == len(set(cells)) == 2 + 6 + 1
    kinds = [(c.agents, c.talkers) for c in cells]
    runs = [kind for i, kind in enumerate(kinds) if i == 0 or kinds[i - 1] != kind]
    assert sorted(runs) == [(2, 1), (2, 10), (3, 10), (5, 10)]


def test_profiles_simulate_the_same_largest_fleet_and_fleets_are_named_the_largest_last():
    profiles = [exp.config(profile).simulated.agents for profile in ("quick", "paper")]
    assert [max(agents) for agents in profiles] == [25, 25]
    fleets = world.fleets_of(exp.config(simulated=Scale(agents=(10, 2))))
    wanted = [(QUERYING, 2), (PUBLISHING, 2), (QUERYING, 10), (PUBLISHING, 10)]
    assert [(one.mode, one.agents) for one in fleets] == wanted


def test_a_demo_node_has_the_eighteen_endpoints_of_humble():
    for role in (TALKER, LISTENER):
        plans = endpoints_of(role, "/a/n", "/a/chatter")
        assert len(plans) == 18
        assert sum(p.writer for p in plans) == (10 if role == TALKER else 9)
        services = [p for p in plans if p.topic[:3] in ("rq/", "rr/")]
        assert len(services) == 12
        assert all(p.writer is (p.topic[:3] == "rr/") for p in services)
        names = {(p.topic, p.writer) for p in plans} - {(p.topic, p.writer) for p in services}
        both = {
            (name, way)
            for name in ("ros_discovery_info", "rt/parameter_events")
            for way in (False, True)
        }
        assert names == both | {("rt/rosout", True), ("rt/a/chatter", role == TALKER)}
    assert "rq/a/n/get_parametersRequest" in {p.topic for p in plans}
    assert results.endpoints(STANDARD, 2, 8) == 2 * 8 * 18


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
    options = {"text": True, "stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    with subprocess.Popen(argv, **options, env=environment) as process:
        assert json.loads(process.stdout.readline()) == {"is": "idle"}
        assert process.communicate("start\nfirst order\n", timeout=60)[0] == "told first order\n"
        assert process.returncode == 0
    done = subprocess.run(
        argv, input="", capture_output=True, text=True, env=environment, check=True
    )
    assert done.stdout == '{"is": "idle"}\n', "whoever is gone starts nothing"


def short(path, *modes, separate=None, **changes):
    stages = tuple(Stage(mode=mode, agents=(2,), talkers=1, listeners=1) for mode in modes)
    changes = {"stages": stages, "simulated": Scale(), **changes}
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


@pytest.mark.parametrize("agents", [2, 5])
@pytest.mark.parametrize("mode", [QUERYING, PUBLISHING])
def test_every_routed_agent_finds_all_others_over_endpoints_by_formula(mode, agents):
    fleet = Fleet(mode=mode, agents=agents)
    rows = world.simulate_fleet(fleet, 0)
    assert [row["host"] for row in rows] == list(range(agents))
    assert all(0.03 < row["resolved_s"] < 5 for row in rows)
    assert {row["endpoints"] for row in rows} == {results.endpoints(mode, agents, 20)}
    assert world.simulate_fleet(fleet, 0) == rows

"""The discovery experiment: known fleets give known claims, and short live ones prove themselves."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys

import psutil
import pytest

from sfglab.bus.address import BusAddress
from sfglab.errors import InvalidValueError
from sfglab.lab.bench import Options
from sfglab.lab.claims import How
from sfglab.lab.experiments.discovery import exp
from sfglab.lab.experiments.discovery.experiment import ROUTED, STANDARD, Scale, Stage, cells_of
from sfglab.lab.experiments.discovery.stage import Ingress
from sfglab.lab.hosts.host import InterfaceBytes
from sfglab.lab.workers.rosnodes import RosNodesConfig
from sfglab.lab.workers.rosstack import LISTENER, TALKER, endpoints_of
from sfglab.processes import Member, ProcessGroup
from sfglab.record import LogWriter

NODES = {"talkers": 10, "listeners": 10}


def known(mode: str, agents: int, host: int) -> tuple[float, float]:
    """Seconds and bytes of an agent: standard takes longer the later the agent, routed is alike."""
    return (10.0 * agents + host, 1e6 * agents**2) if mode == STANDARD else (0.1 * agents, 1e3 * agents**2)


def write(log: LogWriter, table: str, **row):
    log.write_row(table, exp.tables[table](**row), log_time_ns=0)


def write_fleet(log: LogWriter, cell: int, mode: str, agents: int, *, censored: bool = False, **nodes: int):
    for host in range(agents):
        seconds, received = known(mode, agents, host)
        own = {"own_bytes": received, "fleet_bytes": 2 * received, "own_packets": received / 1e3}
        write(log, "host", cell=cell, host=host, resolved_s=seconds, censored=censored, **own)
    seconds, _ = known(mode, agents, agents - 1)
    times = {
        "resolved_s": seconds,
        "signal_s": 0.001,
        "window_s": 10.0,
        "nodes_cpu_s": 5.0,
        "components_cpu_s": 1.0,
    }
    kind = {
        "cell": cell,
        "mode": mode,
        "agents": agents,
        "repeat": cell,
        "censored": censored,
        **NODES,
        **nodes,
    }
    write(log, "cell", **kind, **times, machine_percent=3.0, steal_percent=0.0)


def write_simulated(log: LogWriter, mode: str, agents: int, seed: int):
    for host in range(agents):
        seconds, received = known(mode, agents, host)
        row = {"mode": mode, "agents": agents, "seed": seed, "host": host, "censored": False, **NODES}
        write(log, "simulated", **row, resolved_s=seconds, rx_bytes=received)


@pytest.fixture
def made(tmp_path):
    """Give a function that returns the run of what another one wrote into its log."""

    def make(fill):
        path = tmp_path / "made.mcap"
        with LogWriter(path) as log:
            log.write_metadata("config", {"experiment": "discovery"})
            fill(log)
        return exp.load(path)

    return make


@pytest.fixture
def run(made):
    """A run with known figures; fleets of few nodes beside it must not be mixed in."""

    def fill(log):
        fleets = [(STANDARD, 2), (STANDARD, 6), *[(ROUTED, n) for n in (2, 4, 6) for _ in range(2)]]
        for cell, (mode, agents) in enumerate(fleets):
            write_fleet(log, cell, mode, agents)
        write_fleet(log, len(fleets), ROUTED, 12, talkers=1, listeners=1)
        write_simulated(log, ROUTED, 100, 0)

    return made(fill)


def test_the_claims_are_those_of_the_largest_fleets_with_the_papers_nodes(run):
    claims = exp.measure(run)
    time, received = claims["A-DISC-TIME"], claims["A-DISC-BYTES"]
    assert (time.how, received.how) == (How.LIVE, How.LIVE)
    assert time.estimate.value == pytest.approx(0.6)
    assert received.estimate.value == pytest.approx(3.0)
    assert time.details["agents"] == received.details["agents"] == "6"
    assert time.details["standard, 6 agents"] == "62.50 s (60.00 to 65.00)"


def test_an_agent_that_was_given_up_is_named(made):
    def fill(log):
        write_fleet(log, 0, STANDARD, 6, censored=True)
        write_fleet(log, 1, ROUTED, 6)

    details = exp.measure(made(fill))["A-DISC-TIME"].details
    assert details["standard, 6 agents"].endswith("6 agents given up")
    assert "given up" not in details["routed, 6 agents"]


def test_without_live_fleets_the_figures_are_simulated_and_say_so(made):
    def fill(log):
        for seed in range(2):
            for mode in (STANDARD, ROUTED):
                write_simulated(log, mode, 6, seed)

    simulated = made(fill)
    claims = exp.measure(simulated)
    assert {m.how for m in claims.values()} == {How.SIMULATED}
    assert claims["A-DISC-BYTES"].estimate.value == pytest.approx(3.0)
    assert set(exp.figures(simulated)) == {"discovery_scale"}


def test_the_figures_draw_from_the_log_alone(run):
    drawn = exp.figures(run)
    assert set(drawn) == {"discovery_fleet", "discovery_scale"}
    for figure, twin in drawn.values():
        figure.canvas.draw()
        json.dumps(twin)
    fleets = {(f["mode"], f["agents"], f["talkers"]): f for f in drawn["discovery_fleet"][1]["fleets"]}
    assert fleets[ROUTED, 6, 10]["agent_s"] == pytest.approx(0.6)
    assert fleets[STANDARD, 6, 10]["own_bytes"] == pytest.approx(36e6)
    assert drawn["discovery_scale"][1]["simulated"][0]["agents"] == 100


def test_standard_and_routed_fleets_of_one_size_are_run_side_by_side():
    stages = (
        Stage(mode=STANDARD, agents=(2, 3)),
        Stage(mode=ROUTED, agents=(2, 3, 5), repeats=2),
        Stage(mode=ROUTED, agents=(2,), talkers=1, listeners=1),
    )
    cells = cells_of(exp.config(stages=stages, seed=1))
    assert len(cells) == len(set(cells)) == 2 + 6 + 1
    kinds = [(c.agents, c.talkers) for c in cells]
    runs = [kind for i, kind in enumerate(kinds) if i == 0 or kinds[i - 1] != kind]
    assert sorted(runs) == [(2, 1), (2, 10), (3, 10), (5, 10)]


def test_profiles_reach_their_sizes_and_stages_make_sense():
    with pytest.raises(InvalidValueError, match="mode: given 'proxy', allowed: standard and routed"):
        Stage(mode="proxy", agents=(2,))
    with pytest.raises(InvalidValueError, match="from 2 agents"):
        Stage(mode=ROUTED, agents=(2, 1))
    assert max(exp.config("quick").simulated.agents) == 100
    assert max(exp.config("paper").simulated.agents) == 1000


def test_ingress_is_interpolated_between_readings(monkeypatch):
    class Meter:
        received = 0

        def interface_bytes(self):
            self.received += 1000
            return InterfaceBytes(self.received, 0, self.received // 100, 0)

    stamps = iter((0, 10, 20))
    monkeypatch.setattr("sfglab.lab.experiments.discovery.stage.time.time_ns", lambda: next(stamps))
    ingress = Ingress([Meter()])
    for _ in range(3):
        ingress.read()
    assert ingress.between(0, 0, 15) == (pytest.approx(1500), pytest.approx(15))
    assert ingress.between(0, 10, 20) == (pytest.approx(1000), pytest.approx(10))
    assert ingress.between(0, 0, 99) == (pytest.approx(2000), pytest.approx(20))


def test_a_demo_node_has_the_eighteen_endpoints_of_humble():
    for role in (TALKER, LISTENER):
        plans = endpoints_of(role, "/a/n", "/a/chatter")
        assert len(plans) == 18
        assert sum(p.writer for p in plans) == (10 if role == TALKER else 9)
        services = [p for p in plans if p.topic[:3] in ("rq/", "rr/")]
        assert len(services) == 12
        assert all(p.writer is (p.topic[:3] == "rr/") for p in services)
        names = {(p.topic, p.writer) for p in plans} - {(p.topic, p.writer) for p in services}
        assert names == {
            ("ros_discovery_info", True),
            ("ros_discovery_info", False),
            ("rt/rosout", True),
            ("rt/parameter_events", True),
            ("rt/parameter_events", False),
            ("rt/a/chatter", role == TALKER),
        }
    assert "rq/a/n/get_parametersRequest" in {p.topic for p in plans}


@pytest.mark.live
def test_ros_nodes_of_two_agents_find_each_other_completely():
    def member(name):
        address = BusAddress(domain_id=83, interface="lo")
        config = RosNodesConfig(namespace=f"/{name}", address=address, talkers=2, listeners=1, peers=1)
        return Member(name=name, module="sfglab.lab.workers.rosnodes", config=config)

    async def scenario():
        async with ProcessGroup(lambda _, command: command, map(member, "ab")) as group:
            for found in (await group.ask("resolved", timeout_s=60, do="start")).values():
                assert found["endpoints"] == found["expected"] == 3 * 18
                assert (found["participants"], found["announcements"]) == (3, 6)
            await group.expect("settled", timeout_s=60)

    asyncio.run(scenario())


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
    done = subprocess.run(argv, input="", capture_output=True, text=True, env=environment, check=True)
    assert done.stdout == '{"is": "idle"}\n', "whoever is gone starts nothing"


def short(path, *modes, separate=None, **changes):
    stages = tuple(Stage(mode=mode, agents=(2,), talkers=1, listeners=1) for mode in modes)
    changes = {"stages": stages, "simulated": Scale(), **changes}
    return asyncio.run(exp.run("smoke", path=path / "run.mcap", options=Options(separate=separate), **changes))


@pytest.mark.live
@pytest.mark.netns
@pytest.mark.slow
def test_a_short_live_run_finds_all_peers_and_leaves_nothing(tmp_path):
    before = {p.pid for p in psutil.Process().children(recursive=True)}
    run = short(tmp_path, STANDARD, ROUTED)
    assert run.metadata("hosts")["separate"] is True
    cells, hosts = run["cell"], run["host"]
    assert len(cells) == 2
    assert not cells["censored"].any()
    assert not hosts["censored"].any()
    assert hosts["resolved_s"].between(0.001, 15).all()
    assert (hosts["own_bytes"] > 500).all()
    assert (hosts["fleet_bytes"] >= hosts["own_bytes"]).all()
    cpu_s = cells.set_index("mode")["components_cpu_s"]
    assert cpu_s[ROUTED] > 0
    assert cpu_s[STANDARD] == 0
    assert exp.measure(run) == {}, "two agents do not answer claims about six"
    assert {p.pid for p in psutil.Process().children(recursive=True)} <= before


@pytest.mark.live
@pytest.mark.netns
def test_a_fleet_that_takes_too_long_is_given_up_and_marked(tmp_path):
    run = short(tmp_path, STANDARD, timeout_s=0.001)
    assert run["cell"]["censored"].all()
    assert run["host"]["censored"].all()
    assert (run["host"]["resolved_s"] < 5).all()


def test_without_separate_hosts_nothing_is_passed_off_as_live(tmp_path):
    run = short(tmp_path, STANDARD, separate=False)
    assert run["cell"].empty
    assert run.metadata("hosts")["separate"] is False
    assert exp.measure(run) == {}

"""The discovery experiment: known fleets give known claims, and short live ones prove themselves."""

from __future__ import annotations

import asyncio
import json
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import psutil
import pytest

from sfglab.bus.address import BusAddress
from sfglab.component import argument_of
from sfglab.lab.claims import How
from sfglab.lab.experiments import discovery
from sfglab.lab.experiments.discovery.config import ROUTED, STANDARD, Config, Scale, Stage
from sfglab.lab.experiments.discovery.ingress import Ingress
from sfglab.lab.experiments.discovery.rows import FleetRow, HostRow, SimulatedRow
from sfglab.lab.experiments.discovery.run import cells_of
from sfglab.lab.experiments.profiles import ConfigError
from sfglab.lab.hosts.host import InterfaceBytes
from sfglab.lab.workers.rosnodes import RosNodesConfig
from sfglab.lab.workers.rosstack import LISTENER, TALKER, endpoints_of
from sfglab.processes import LineProcess
from sfglab.record import LogReader, LogWriter


def known(mode: str, agents: int, host: int) -> tuple[float, float]:
    """Seconds and bytes of an agent: standard takes longer the later the agent, routed is alike."""
    return (10.0 * agents + host, 1e6 * agents**2) if mode == STANDARD else (0.1 * agents, 1e3 * agents**2)


def write_fleet(log: LogWriter, cell: int, mode: str, agents: int, nodes: tuple[int, int] = (10, 10), **more):
    for host in range(agents):
        seconds, received = known(mode, agents, host)
        row = HostRow(
            cell=cell,
            host=host,
            resolved_s=seconds,
            censored=more.get("censored", False),
            own_bytes=received,
            fleet_bytes=2 * received,
            own_packets=received / 1e3,
        )
        log.write_row("host", row, log_time_ns=cell * 100 + host)
    row = FleetRow(
        cell=cell,
        mode=mode,
        agents=agents,
        talkers=nodes[0],
        listeners=nodes[1],
        repeat=cell,
        resolved_s=known(mode, agents, agents - 1)[0],
        censored=more.get("censored", False),
        signal_s=0.001,
        window_s=10.0,
        nodes_cpu_s=5.0,
        components_cpu_s=1.0,
        machine_percent=3.0,
        steal_percent=0.0,
    )
    log.write_row("cell", row, log_time_ns=cell * 100 + 99)


@pytest.fixture
def made_log(tmp_path):
    """A log as a run writes it, with known figures; fleets of few nodes beside it must not be mixed in."""
    path = tmp_path / "made.mcap"
    with LogWriter(path) as log:
        log.write_metadata("config", {"experiment": "discovery"})
        log.write_metadata("hosts", {"description": "made", "separate": True})
        fleets = [(STANDARD, 2), (STANDARD, 6), *[(ROUTED, n) for n in (2, 4, 6) for _ in range(2)]]
        for cell, (mode, agents) in enumerate(fleets):
            write_fleet(log, cell, mode, agents)
        write_fleet(log, len(fleets), ROUTED, 12, nodes=(1, 1))
        for host in range(100):
            row = SimulatedRow(
                mode=ROUTED,
                agents=100,
                talkers=10,
                listeners=10,
                seed=0,
                host=host,
                resolved_s=1.0,
                rx_bytes=1e6,
                censored=False,
            )
            log.write_row("simulated", row, log_time_ns=0)
    return path


def test_the_claims_are_those_of_the_largest_fleets_with_the_papers_nodes(made_log):
    claims = discovery.measure_claims(made_log)
    time, received = claims["A-DISC-TIME"], claims["A-DISC-BYTES"]
    assert (time.how, received.how) == (How.LIVE, How.LIVE)
    assert time.estimate.value == pytest.approx(0.6)
    assert received.estimate.value == pytest.approx(3.0)
    assert time.details["agents"] == received.details["agents"] == "6"
    assert time.details["standard, 6 agents"] == "62.50 s (60.00 to 65.00)"
    assert "12" not in time.details["agents"]


def test_an_agent_that_was_given_up_is_named(tmp_path):
    path = tmp_path / "given_up.mcap"
    with LogWriter(path) as log:
        log.write_metadata("config", {})
        log.write_metadata("hosts", {})
        write_fleet(log, 0, STANDARD, 6, censored=True)
        write_fleet(log, 1, ROUTED, 6)
    details = discovery.measure_claims(path)["A-DISC-TIME"].details
    assert details["standard, 6 agents"].endswith("6 agents given up")
    assert "given up" not in details["routed, 6 agents"]


def test_without_live_fleets_the_figures_are_simulated_and_say_so(tmp_path):
    path = tmp_path / "simulated.mcap"
    with LogWriter(path) as log:
        log.write_metadata("config", {})
        log.write_metadata("hosts", {"separate": False})
        for seed in range(2):
            for mode in (STANDARD, ROUTED):
                for host in range(6):
                    seconds, received = known(mode, 6, host)
                    row = SimulatedRow(
                        mode=mode,
                        agents=6,
                        talkers=10,
                        listeners=10,
                        seed=seed,
                        host=host,
                        resolved_s=seconds,
                        rx_bytes=received,
                        censored=False,
                    )
                    log.write_row("simulated", row, log_time_ns=0)
    claims = discovery.measure_claims(path)
    assert {m.how for m in claims.values()} == {How.SIMULATED}
    assert claims["A-DISC-BYTES"].estimate.value == pytest.approx(3.0)
    assert set(discovery.figures(path)) == {"discovery_scale"}


def test_the_figures_draw_from_the_log_alone(made_log):
    drawn = discovery.figures(made_log)
    assert set(drawn) == {"discovery_fleet", "discovery_scale"}
    for figure, twin in drawn.values():
        figure.canvas.draw()
        json.dumps(twin)
    fleets = {(f["mode"], f["agents"], f["talkers"]): f for f in drawn["discovery_fleet"][1]["fleets"]}
    assert fleets[ROUTED, 6, 10]["agent_s"] == pytest.approx(0.6)
    assert fleets[STANDARD, 6, 10]["own_bytes"] == pytest.approx(36e6)
    assert drawn["discovery_scale"][1]["simulated"][0]["agents"] == 100


def test_standard_and_routed_fleets_of_one_size_are_run_side_by_side():
    config = Config(
        profile="x",
        stages=(
            Stage(mode=STANDARD, agents=(2, 3)),
            Stage(mode=ROUTED, agents=(2, 3, 5), repeats=2),
            Stage(mode=ROUTED, agents=(2,), talkers=1, listeners=1),
        ),
    )
    cells = cells_of(config, rng=np.random.default_rng(1))
    assert len(cells) == len(set(cells)) == 2 + 6 + 1
    kinds = [(c.agents, c.talkers) for c in cells]
    runs = [kind for i, kind in enumerate(kinds) if i == 0 or kinds[i - 1] != kind]
    assert sorted(runs) == [(2, 1), (2, 10), (3, 10), (5, 10)]


def test_profiles_are_known_by_name_and_stages_make_sense():
    with pytest.raises(ConfigError, match="allowed are smoke, quick, paper"):
        Config.of_profile("fast")
    with pytest.raises(ConfigError, match="allowed are standard and routed"):
        Stage(mode="proxy", agents=(2,))
    with pytest.raises(ConfigError, match="from 2 agents"):
        Stage(mode=ROUTED, agents=(2, 1))
    assert Config.of_profile("paper", seed=3).seed == 3
    assert max(Config.of_profile("quick").simulated.agents) == 100
    assert max(Config.of_profile("paper").simulated.agents) == 1000


def test_ingress_is_interpolated_between_readings(monkeypatch):
    class Meter:
        received = 0

        def interface_bytes(self):
            self.received += 1000
            return InterfaceBytes(self.received, 0, self.received // 100, 0)

    stamps = iter((0, 10, 20))
    monkeypatch.setattr("sfglab.lab.experiments.discovery.ingress.time.time_ns", lambda: next(stamps))
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
    async def scenario():
        async def start(name):
            config = RosNodesConfig(
                namespace=f"/{name}",
                address=BusAddress(domain_id=83, interface="lo"),
                talkers=2,
                listeners=1,
                peers=1,
            )
            argv = [sys.executable, "-m", "sfglab.lab.workers.rosnodes", argument_of(config)]
            return await LineProcess.start(name, argv)

        agents = [await start("a"), await start("b")]
        try:
            for agent in agents:
                await agent.expect("ready", timeout_s=60)
            for agent in agents:
                agent.order(do="start")
            for agent in agents:
                found = await agent.expect("resolved", timeout_s=60)
                assert found["endpoints"] == found["expected"] == 3 * 18
                assert (found["participants"], found["announcements"]) == (3, 6)
                await agent.expect("settled", timeout_s=60)
        finally:
            await asyncio.gather(*(agent.close() for agent in agents))

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


def short(*modes: str) -> Config:
    stages = tuple(Stage(mode=mode, agents=(2,), talkers=1, listeners=1) for mode in modes)
    return replace(Config.of_profile("smoke"), stages=stages, simulated=Scale())


@pytest.mark.live
@pytest.mark.netns
@pytest.mark.slow
def test_a_short_live_run_finds_all_peers_and_leaves_nothing(tmp_path):
    before = {p.pid for p in psutil.Process().children(recursive=True)}
    log = asyncio.run(discovery.run(short(STANDARD, ROUTED), tmp_path / "run.mcap"))
    results = discovery.load_results(log)
    assert results.setting["separate"] is True
    assert len(results.cells) == 2
    assert not results.cells["censored"].any()
    assert not results.hosts["censored"].any()
    assert results.hosts["resolved_s"].between(0.001, 15).all()
    assert (results.hosts["own_bytes"] > 500).all()
    assert (results.hosts["fleet_bytes"] >= results.hosts["own_bytes"]).all()
    cpu_s = results.cells.set_index("mode")["components_cpu_s"]
    assert cpu_s[ROUTED] > 0
    assert cpu_s[STANDARD] == 0
    assert discovery.measure_claims(log) == {}, "two agents do not answer claims about six"
    assert {p.pid for p in psutil.Process().children(recursive=True)} <= before


@pytest.mark.live
@pytest.mark.netns
def test_a_fleet_that_takes_too_long_is_given_up_and_marked(tmp_path):
    config = replace(short(STANDARD), timeout_s=0.001)
    log = asyncio.run(discovery.run(config, tmp_path / "run.mcap"))
    results = discovery.load_results(log)
    assert results.cells["censored"].all()
    assert results.hosts["censored"].all()
    assert (results.hosts["resolved_s"] < 5).all()


def test_without_separate_hosts_nothing_is_passed_off_as_live(tmp_path):
    log = asyncio.run(discovery.run(short(STANDARD), tmp_path / "run.mcap", separate=False))
    with LogReader(log) as reader:
        assert "cell" not in reader.tables
        assert reader.metadata("hosts")["separate"] is False
    assert discovery.measure_claims(log) == {}

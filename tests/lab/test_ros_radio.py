"""Real Fast DDS over the lossy radio between hosts: beside the model, and as `sfglab qos --rmw` recommends."""

import sys
from dataclasses import replace

import numpy as np
import pytest
from commands import called

from sfglab.lab.experiments.transmission.live import Cell
from sfglab.lab.live_flows import MODES, QUIET, live_hosts
from sfglab.qos import QoSProfile
from sfglab.rtps import PRESETS, Flow, Medium, Scenario, run
from sfglab.rtps.session import age_ms
from sfglab.rtps.vendors import SEND_BUFFER_BYTES

pytestmark = [pytest.mark.live, pytest.mark.ros, pytest.mark.netns]

CELL = {
    "kind": "lossy",
    "rate_hz": 100.0,
    "depth": 800,
    "size_bytes": 24,
    "loss": 0.08,
    "overhead_us": 300,
}
CALM = Medium(rate_bps=1e8, loss=0.0, overhead_s=50e-6)
RADIO = {"queue_frames": 500, "queue_rule": "tail", "burst_frames": 0, "access_point": False}

FRAME_TRUE_BYTES = 2048 + 256
"""Bytes of a socket's buffer per frame of 1.3 kB: a block of 2 kB and its sk_buff (Linux 6.18, SIOCOUTQ)."""


@pytest.mark.parametrize(("preset", "stalls"), [("fast_dds_sync", True), ("fast_dds_async", False)])
async def test_a_deep_history_stalls_in_the_mode_in_which_the_model_says_so(preset, stalls):
    scenario = replace(Cell(**CELL, **RADIO, preset=preset).scenario(2.0), drain_s=2.0)
    async with live_hosts("robot", "station", ros=MODES[preset]) as hosts:
        played = await hosts.play(scenario, seed=5)
    flows = [outcome.flows["topic"] for outcome in (played.outcome, run(played.scenario, seed=5))]
    soon = [np.sum(flow.latency_ns < 500_000_000) / len(flow.fate) for flow in flows]
    assert played.radio.lost > 10
    assert [share < 0.5 for share in soon] == [stalls, stalls], soon


async def test_chains_and_local_caches_run_on_ros2_as_in_the_model():
    flow = {"source": "robot", "target": "station", "rate_hz": 100.0, "qos": QoSProfile(depth=100)}
    flows = (
        Flow(name="cached", change_s=0.1, cached=True, phase_s=1e-3, **flow),
        Flow(name="hello", size_bytes=14, then="move", service_s=5e-3, **flow),
        Flow(name="move", size_bytes=14, source="station", target="robot", qos=flow["qos"]),
    )
    times = {"vendor": PRESETS["fast_dds_sync"], "duration_s": 1.0, "drain_s": 3.0}
    async with live_hosts("robot", "station", ros="SYNCHRONOUS") as hosts:
        played = await hosts.play(Scenario(flows=flows, medium=CALM, **times), seed=3)
    cached, hello, move = (played.outcome.flows[flow.name] for flow in flows)
    assert 1 < len(cached.fate) < 40, "what did not change is held back"
    assert 50 < len(hello.fate) == len(move.fate), "at most a machine that is busy with others"
    assert cached.loss == hello.loss == move.loss == 0
    assert (move.published_ns >= hello.published_ns + 5_000_000).all()


# Make a host's frames wait in its kernel for their airtime: rate in bytes per second, overhead in bytes.
BLOCK = """
import sys
from pyroute2 import IPRoute
rate, overhead = map(int, sys.argv[1:])
with IPRoute() as netlink:
    [index] = netlink.link_lookup(ifname="eth0")
    netlink.tc("add", "htb", index=index, handle=0x10000, default=0x10)
    burst = overhead + 1514
    limits = {"rate": rate, "burst": burst, "cburst": burst, "overhead": overhead}
    netlink.tc("add-class", "htb", index=index, handle=0x10010, parent=0x10000, **limits)
"""


# ROS 2's usual ten: of fewer, a sending thread that waits for a CPU loses more (of five 13 % beside six loops).
@pytest.mark.parametrize(("preset", "depth"), [("fast_dds_sync", 1000), ("fast_dds_async", 10)])
async def test_a_queue_that_blocks_slows_who_publishes_as_in_the_model(preset, depth, monkeypatch):
    frames = SEND_BUFFER_BYTES // FRAME_TRUE_BYTES
    air = {"loss": 0.0, "overhead_us": 10_000, "queue_frames": frames, "queue_rule": "block"}
    # So large that none shares a frame with the next one, as those of a thread do that waits for a CPU.
    kind = {"preset": preset, "rate_hz": 400.0, "depth": depth, "size_bytes": 1200}
    cell = CELL | RADIO | air | kind
    # Linux wakes who waits at half the buffer: 46 are published at once, of five seconds' 541 a twelfth.
    scenario = replace(Cell(**cell).scenario(5.0), drain_s=3.0)
    scenario = replace(scenario, medium=replace(scenario.medium, shared=False))
    async with live_hosts("robot", "station", ros=MODES[preset]) as hosts:
        network = hosts._network
        set_radio = network.set_radio

        def block(medium, *, seed=0):
            if medium == scenario.medium:
                rate = medium.rate_bps / 8
                limits = [str(round(value)) for value in (rate, medium.overhead_s * rate)]
                for host in network.hosts.values():
                    host.run([sys.executable, "-c", BLOCK, *limits], 60, check=True)
                medium = QUIET
            set_radio(medium, seed=seed)

        monkeypatch.setattr(network, "set_radio", block)
        played = await hosts.play(scenario, seed=5)
    live, model = (
        outcome.flows["topic"] for outcome in (played.outcome, run(played.scenario, seed=5))
    )
    assert model.loss == 0.0
    assert live.loss < 0.1
    assert len(live.fate) == pytest.approx(len(model.fate), rel=0.15)
    assert len(live.fate) < 1000, "of 2,000"
    assert np.median(live.latency_ns) == pytest.approx(np.median(model.latency_ns), rel=0.3)


RATE_MAX_HZ, SECONDS = 400.0, 2.0
PLANNED = CELL | RADIO | {"loss": 0.08, "overhead_us": 4000}
TOPICS = """
link: {rate_mbps: 20, overhead_us: 4000, loss: 0.08, contention: 0.15}
vendor: cyclone_dds
rate_max_hz: 400
agents: [robot]
topics:
  /state: {from: robot, to: station, size_bytes: 24, change_s: 0.05}
"""


@pytest.mark.parametrize(
    ("rmw", "preset"), [("sync", "fast_dds_sync"), ("async", "fast_dds_async")]
)
async def test_the_station_is_up_to_date_as_recommended_and_not_as_printed_or_by_default(
    rmw, preset, tmp_path
):
    (file := tmp_path / "topics.yaml").write_text(TOPICS)

    def planned(method):
        printed = called("qos", str(file), "--rmw", f"fastrtps-{rmw}", "--method", method)
        _, rate_hz, depth, *_ = printed.splitlines()[1].split()
        return float(rate_hz), int(depth)

    ways = {"ours": planned("ours"), "paper": planned("paper"), "default": (RATE_MAX_HZ, 10)}
    age = {}
    async with live_hosts("robot", "station", ros=MODES[preset]) as hosts:
        for way, (rate_hz, depth) in ways.items():
            cell = {**PLANNED, "preset": preset, "rate_hz": rate_hz, "depth": depth}
            scenario = replace(Cell(**cell).scenario(SECONDS), drain_s=1.0)
            played = await hosts.play(scenario, seed=1)
            age[way] = age_ms(played.outcome.flows["topic"], duration_s=SECONDS)
    # The air carries 250 frames a second: what waits in the queue decides, not how busy this machine is.
    assert 3 * age["ours"] < min(age["paper"], age["default"]), (ways, age)

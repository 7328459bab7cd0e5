"""What `sfglab qos --rmw` recommends, on real ROS 2 and a lossy link, against the paper's and the default."""

import pytest
from commands import called

from sfglab.lab.experiments.transmission.stage import live_hosts
from sfglab.lab.experiments.transmission.validation import MODES, scenario_of_cell
from sfglab.rtps.session import age_ms

pytestmark = [pytest.mark.live, pytest.mark.ros, pytest.mark.netns]

RATE_MAX_HZ, SECONDS = 400.0, 2.0
AIR = {"loss": 0.08, "overhead_us": 4000, "queue_frames": 500, "queue_rule": "tail"}
CELL = {**AIR, "size_bytes": 24, "burst_frames": 0, "access_point": False}
TOPICS = f"""
link: {{rate_mbps: 20, overhead_us: {AIR["overhead_us"]}, loss: {AIR["loss"]}, contention: 0.15}}
vendor: cyclone_dds
rate_max_hz: {RATE_MAX_HZ}
agents: [robot]
topics:
  /state: {{from: robot, to: station, size_bytes: 24, change_s: 0.05}}
"""


@pytest.mark.parametrize(("rmw", "preset"), [("sync", "fast_dds_sync"), ("async", "fast_dds_async")])
async def test_the_station_is_up_to_date_as_recommended_and_neither_as_printed_nor_by_default(
    rmw, preset, tmp_path
):
    (file := tmp_path / "topics.yaml").write_text(TOPICS)

    def planned(method):
        said = called("qos", str(file), "--rmw", f"fastrtps-{rmw}", "--method", method).splitlines()[1].split()
        return float(said[1]), int(said[2])

    ways = {"ours": planned("ours"), "printed": planned("printed"), "default": (RATE_MAX_HZ, 10)}
    age = {}
    async with live_hosts("robot", "station", ros=MODES[preset]) as hosts:
        for way, (rate_hz, depth) in ways.items():
            cell = {**CELL, "preset": preset, "rate_hz": rate_hz, "depth": depth}
            played = await hosts.play(scenario_of_cell(cell, duration_s=SECONDS, drain_s=1.0), seed=1)
            age[way] = age_ms(played.outcome.flows["topic"], duration_s=SECONDS)
    # The air carries 250 frames a second: what waits in the queue decides, not how busy this machine is.
    assert 3 * age["ours"] < min(age["printed"], age["default"]), (ways, age)

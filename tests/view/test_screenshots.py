"""The fleet of the viewer's screenshot."""

import pytest
import screenshots
from seen import read_recording

pytest.importorskip("rerun", reason="the extra 'view' is not installed")


def test_the_fleet_has_its_cloud_its_lost_agent_and_nothing_that_fails(tmp_path, monkeypatch):
    monkeypatch.setattr(screenshots, "_MOMENTS", 16)
    screenshots.record_fleet(tmp_path / "fleet.rrd")
    shown = read_recording(tmp_path / "fleet.rrd")
    root = "/agents/go2/global/camera_front/aligned_depth/compressed_depth"
    for place in ((f"{root}/cloud", "Points3D:positions"), (root, "DepthImage:buffer")):
        assert len(shown[place]) == 16
    for agent, life in (("go2", "alive"), ("pi3", "late")):
        states = shown[f"/agents/{agent}/heartbeat/life", "StateChange:state"]
        assert states[-1].content == [life]
    assert {entity for entity, _ in shown} >= {"/tf/go2/base", "/tf/pi1/base"}

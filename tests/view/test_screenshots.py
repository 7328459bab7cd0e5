"""The fleet of the viewer's screenshot, and the driver that a screenshot needs."""

import sys
from pathlib import Path

import pytest
from seen import read_recording

from sfglab.errors import SfglabError

sys.path.append(str(Path(__file__).parents[2] / "tools"))

import screenshots

pytest.importorskip("rerun", reason="the extra 'view' is not installed")


def test_without_a_driver_there_is_no_screenshot_but_one_sentence(tmp_path, monkeypatch):
    for name in screenshots._NAMED_DRIVERS:
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(screenshots, "_DRIVERS", (str(tmp_path / "icd.d"),))
    told = "needs a Vulkan driver, such as the package mesa-vulkan-drivers"
    with pytest.raises(SfglabError, match=told):
        screenshots.main(tmp_path, ["viewer"])
    assert not list(tmp_path.iterdir())


def test_the_fleet_has_its_cloud_its_lost_agent_and_nothing_that_fails(tmp_path, monkeypatch):
    monkeypatch.setattr(screenshots, "_MOMENTS", 16)
    screenshots.record_fleet(tmp_path / "fleet.rrd")
    shown = read_recording(tmp_path / "fleet.rrd")
    root = "/agents/go2/global/camera_front/aligned_depth/compressed_depth"
    assert len(shown[f"{root}/cloud", "Points3D:positions"]) == 16
    assert len(shown[root, "DepthImage:buffer"]) == 16
    for agent, life in (("go2", "alive"), ("pi3", "late")):
        states = shown[f"/agents/{agent}/heartbeat/life", "StateChange:state"]
        assert states[-1].content == [life]
    assert {entity for entity, _ in shown} >= {"/tf/go2/base", "/tf/pi1/base"}

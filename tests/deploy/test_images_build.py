"""The images as they come out of a real builder, on a real Debian: what they run, say and refuse."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from esslingen import FILE, PROJECT

from sfglab.deploy.deployment import deployment_of
from sfglab.deploy.release import make_release
from sfglab.fleet.fleet_file import load_fleet
from sfglab.lab.trial_build import trial_build, why_not

CACHE = os.environ.get("SFGLAB_TEST_CACHE")


def test_a_machine_without_tools_is_told_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setenv("PATH", str(tmp_path))
    release, _ = make_release(PROJECT, "")
    (check,) = trial_build(deployment_of(load_fleet(FILE), "pi1", release), tmp_path / "w", tmp_path, print)
    assert check.why == "buildah, debootstrap not installed (apt install buildah debootstrap)"


@pytest.mark.slow
@pytest.mark.skipif(bool(why_not()), reason=why_not() or "can run")
@pytest.mark.skipif(CACHE is None, reason="downloads 300 MB: name a folder to keep them in SFGLAB_TEST_CACHE")
def test_every_promise_holds_in_a_real_image(tmp_path):
    said: list[str] = []
    release, data = make_release(PROJECT, FILE.read_text())
    deployment = deployment_of(load_fleet(FILE), "workstation", release)
    wheel = tmp_path / release.wheel
    wheel.write_bytes(data)
    checks = trial_build(deployment, wheel, tmp_path, said.append, cache=Path(CACHE or tmp_path))
    assert [check for check in checks if check.held < check.checked] == [], "\n".join(said[-30:])
    assert len(checks) == 12
    assert list(tmp_path.iterdir()) == [wheel]

"""Which ROS 2 is beside us is what `make ros` made and what is sourced; without any one sentence says so."""

import pytest

from sfglab.lab.ros2 import RosMissingError, distribution, distributions


@pytest.fixture
def root(tmp_path, monkeypatch):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "claims.yaml").touch()
    monkeypatch.setenv("SFGLAB_ROOT", str(tmp_path))
    for name in ("AMENT_PREFIX_PATH", "ROS_DISTRO"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


def test_what_is_there_is_found_and_named(root, monkeypatch):
    with pytest.raises(RosMissingError, match=r"^needs ROS 2: make ros$"):
        distribution()
    for name in ("jazzy", "kilted"):
        (root / f".venv-{name}").mkdir()
    (root / ".venv-jazzy" / ".ready").touch()  # the other is being made
    monkeypatch.setenv("ROS_DISTRO", "humble")
    assert [str(one) for one in distributions().values()] == ["jazzy (make ros)"]
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/opt/ros/humble")
    assert [str(one) for one in distributions().values()] == ["jazzy (make ros)", "humble (sourced)"]
    assert distribution().name == "jazzy"


def test_a_program_runs_without_what_would_mislead_its_interpreter(root, monkeypatch):
    (root / ".venv-jazzy").mkdir()
    (root / ".venv-jazzy" / ".ready").touch()
    argv = distribution().argv("script.py", "name", ROS_DOMAIN_ID=7)
    assert argv[0] == "env"
    assert {"--unset=PYTHONPATH", "--unset=LD_LIBRARY_PATH", "ROS_DISTRO=jazzy", "ROS_DOMAIN_ID=7"} < {*argv}
    assert argv[-3:] == [str(root / ".venv-jazzy" / "bin" / "python"), "script.py", "name"]

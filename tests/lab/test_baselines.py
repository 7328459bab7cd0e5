"""Real ROS 2 beside us: which there is, ratios of known figures, a log apart, and where there is none."""

import asyncio

import pandas as pd
import pytest

from sfglab.lab.bench import Options
from sfglab.lab.experiments import ros2
from sfglab.lab.experiments.ros2.experiment import REAL, STAND_IN, TABLE
from sfglab.lab.ros2 import RosMissingError, distribution, distributions


def rows(kind, factor):
    """Three repetitions, with two values each whose median counts."""
    of = {"setting": "1", "quantity": "time (s)", "kind": kind}
    return [of | {"repeat": r, "value": factor * v} for r in range(3) for v in (r + 1, r + 3)]


def test_a_ratio_is_the_stand_in_s_median_over_the_real_one_s():
    alone = {"setting": "2", "quantity": "time (s)", "kind": REAL, "repeat": 0, "value": 1.0}
    table = pd.DataFrame([*rows(REAL, 2.0), *rows(STAND_IN, 1.0), alone])
    (line,) = ros2.compared(table).to_dict("records")
    assert (line["setting"], line[REAL], line[STAND_IN]) == ("1", 6.0, 3.0)
    assert line["stand-in / ROS 2"].startswith("0.5 times [")


@pytest.fixture
def root(tmp_path, monkeypatch):
    (tmp_path / "data").mkdir()
    (tmp_path / "data" / "claims.yaml").touch()
    monkeypatch.setenv("SFGLAB_ROOT", str(tmp_path))
    for name in ("AMENT_PREFIX_PATH", "ROS_DISTRO"):
        monkeypatch.delenv(name, raising=False)
    return tmp_path


@pytest.mark.live
@pytest.mark.parametrize(
    ("separate", "why"),
    [
        pytest.param(None, "needs ROS 2; install it with make ros", marks=pytest.mark.netns),
        (
            False,
            "needs network namespaces: real ROS 2 would discover other nodes of this network",
        ),
    ],
    ids=["no ROS 2", "one host"],
)
@pytest.mark.parametrize("part", ros2.BASELINES)
def test_where_it_cannot_be_measured_one_sentence_says_so(root, part, separate, why):
    options = Options(only=frozenset({part}), separate=separate)
    run = asyncio.run(ros2.exp.run("smoke", path=root / "smoke.mcap", options=options))
    assert run.skipped(part) == why
    assert run[TABLE].empty


@pytest.mark.live
@pytest.mark.ros
@pytest.mark.netns
@pytest.mark.parametrize("part", ros2.BASELINES)
def test_a_smoke_run_measures_both_sides(tmp_path, part):
    options = Options(only=frozenset({part}))
    run = asyncio.run(ros2.exp.run("smoke", path=tmp_path / "smoke.mcap", options=options))
    assert run.skipped(part) == ""
    table = run[TABLE]
    assert set(table["kind"]) == {REAL, STAND_IN}
    assert (table["value"] > 0).all()
    assert set(ros2.compared(table)["quantity"]) == set(table["quantity"])


def test_what_is_there_is_found_and_named(root, monkeypatch):
    with pytest.raises(RosMissingError, match=r"^needs ROS 2; install it with make ros$"):
        distribution()
    for name in ("jazzy", "kilted"):
        (root / f".venv-{name}").mkdir()
    (root / ".venv-jazzy" / ".ready").touch()  # the other is being made
    monkeypatch.setenv("ROS_DISTRO", "humble")
    assert [str(one) for one in distributions().values()] == ["jazzy (make ros)"]
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/opt/ros/humble")
    found = [str(one) for one in distributions().values()]
    assert found == ["jazzy (make ros)", "humble (sourced)"]
    # A program runs without what would mislead its interpreter.
    env, *words, python, script, name = distribution().argv("script.py", "name", ROS_DOMAIN_ID=7)
    assert (env, script, name) == ("env", "script.py", "name")
    assert python == str(root / ".venv-jazzy" / "bin" / "python")
    usual = {"--unset=PYTHONPATH", "--unset=LD_LIBRARY_PATH", "ROS_DISTRO=jazzy"}
    assert usual | {"ROS_DOMAIN_ID=7"} < {*words}

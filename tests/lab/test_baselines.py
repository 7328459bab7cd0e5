"""Real ROS 2 beside us: which there is, ratios of known figures, a log apart, and where there is none."""

import asyncio
import shutil

import pytest
from made_logs import made_run, reference

from sfglab.lab.baselines import PART, REAL, STAND_IN, beside, compared
from sfglab.lab.bench import Options
from sfglab.lab.experiments import decode_once, discovery, latency
from sfglab.lab.ros2 import RosMissingError, distribution, distributions

EXPERIMENTS = [discovery.exp, latency.exp, decode_once.exp]


def rows(kind, factor):
    """Three repetitions, with two figures each whose median counts."""
    of = {"setting": "2 x 2", "quantity": "time (s)", "kind": kind}
    return [of | {"repeat": r, "value": factor * v} for r in range(3) for v in (r + 1, r + 3)]


def test_a_ratio_is_the_stand_in_s_median_over_the_real_one_s(tmp_path):
    exp = latency.exp
    run = made_run(exp, tmp_path / "made.mcap", {PART: [*rows(REAL, 2.0), *rows(STAND_IN, 1.0)]})
    (line,) = compared(exp, run).to_dict("records")
    assert (line[REAL], line[STAND_IN]) == (6.0, 3.0)
    assert line["ratio"].startswith("0.5 times ROS 2 [")
    _, shown = exp.draw("latency_ros2", run)
    assert shown["compared"]["quantity"] == ["time (s)"]


def test_what_was_measured_apart_counts_beside_a_log_without_it(tmp_path):
    exp = discovery.exp
    run = made_run(exp, tmp_path / "made.mcap", {})
    assert beside(exp, run).empty
    assert compared(exp, run).empty
    apart = made_run(exp, tmp_path / "apart.mcap", {PART: rows(REAL, 1.0)})
    shutil.move(apart.log, tmp_path / "made_ros2.mcap")
    assert len(beside(exp, run)) == 6
    assert exp.draw("discovery_ros2", run)[1]["apart"] == "made_ros2.mcap"


@pytest.mark.parametrize("exp", EXPERIMENTS, ids=lambda exp: exp.name)
def test_the_reference_has_both_sides_and_no_other_claims(exp, monkeypatch):
    run = reference(exp)
    assert {REAL, STAND_IN} <= set(beside(exp, run)["kind"])
    assert not compared(exp, run).empty
    without, table = exp.load(run.log), run.table
    monkeypatch.setattr(
        without, "table", lambda name: table(name).iloc[: 0 if name == PART else None]
    )
    assert without[PART].empty
    assert exp.measure(without) == exp.measure(run), "claims are measured without it"


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
    ("exp", "separate", "why"),
    [
        pytest.param(discovery.exp, None, "needs ROS 2: make ros", marks=pytest.mark.netns),
        (
            latency.exp,
            False,
            "needs network namespaces: real ROS 2 would meet whoever else is on this network",
        ),
    ],
    ids=["no ROS 2", "one host"],
)
def test_where_it_cannot_be_measured_one_sentence_says_so(root, exp, separate, why):
    options = Options(only=frozenset({PART}), separate=separate)
    run = asyncio.run(exp.run("smoke", path=root / "smoke.mcap", options=options))
    assert run.skipped(PART) == why
    assert run[PART].empty


@pytest.mark.live
@pytest.mark.ros
@pytest.mark.netns
@pytest.mark.parametrize("exp", EXPERIMENTS, ids=lambda exp: exp.name)
def test_a_smoke_run_measures_both_sides(tmp_path, exp):
    changes, more = ({"timeout_s": 60.0}, {"routed"}) if exp is discovery.exp else ({}, set())
    options = Options(only=frozenset({PART}))
    run = asyncio.run(exp.run("smoke", path=tmp_path / "smoke.mcap", options=options, **changes))
    assert run.skipped(PART) == ""
    rows = beside(exp, run)
    assert set(rows["kind"]) == {REAL, STAND_IN} | more
    assert (rows["value"] > 0).all()
    if exp is discovery.exp:  # nobody was given up
        assert (rows[rows["quantity"].str.startswith("until")]["value"] < 60).all()
    assert set(compared(exp, run)["quantity"]) == set(rows["quantity"])
    assert exp.draw(f"{exp.name}_{PART}", run)[1]["apart"] == ""


@pytest.mark.live
@pytest.mark.ros
@pytest.mark.netns
@pytest.mark.parametrize(("exp", "none"), [(latency.exp, 0), (decode_once.exp, ())])
def test_who_asks_for_no_subscriber_is_told_so(tmp_path, exp, none):
    options = Options(only=frozenset({PART}))
    run = asyncio.run(exp.run("smoke", path=tmp_path / "smoke.mcap", options=options, ros2=none))
    assert run.skipped(PART) == "ros2: none was asked for"


def test_what_is_there_is_found_and_named(root, monkeypatch):
    with pytest.raises(RosMissingError, match=r"^needs ROS 2: make ros$"):
        distribution()
    for name in ("jazzy", "kilted"):
        (root / f".venv-{name}").mkdir()
    (root / ".venv-jazzy" / ".ready").touch()  # the other is being made
    monkeypatch.setenv("ROS_DISTRO", "humble")
    assert [str(one) for one in distributions().values()] == ["jazzy (make ros)"]
    monkeypatch.setenv("AMENT_PREFIX_PATH", "/opt/ros/humble")
    assert [str(one) for one in distributions().values()] == [
        "jazzy (make ros)",
        "humble (sourced)",
    ]
    assert distribution().name == "jazzy"
    # A program runs without what would mislead its interpreter.
    argv = distribution().argv("script.py", "name", ROS_DOMAIN_ID=7)
    assert argv[0] == "env"
    assert {
        "--unset=PYTHONPATH",
        "--unset=LD_LIBRARY_PATH",
        "ROS_DISTRO=jazzy",
        "ROS_DOMAIN_ID=7",
    } < {*argv}
    assert argv[-3:] == [str(root / ".venv-jazzy" / "bin" / "python"), "script.py", "name"]

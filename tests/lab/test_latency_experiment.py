"""The latency experiment: known delays are found again. Its live run is that of its notebook."""

import numpy as np
import pytest
from made_logs import CLAIMS, made_run

from sfglab.lab.claims import entry_for, render_in_full
from sfglab.lab.experiments.latency import analysis, checks, exp
from sfglab.lab.experiments.latency.experiment import looks_of
from sfglab.lab.experiments.latency.stage import PATHS

MS = 10**6
GLASS_MS = {"standard": 8, "decoder": 9, "agent": 11, "container": 12, "on_demand": 12}
FIRST_MS = {"standard": 500, "decoder": 60, "agent": 75, "container": 900, "on_demand": 1200}
BEFORE = [path for path in PATHS if path != "container"]
REPEATS, STRANGER = 4, 10**6


def looked(look, repeat, path, ordered_ns):
    row = {
        "look": look,
        "repeat": repeat,
        "path": path,
        "phase": 0.5,
        "pictures": 6,
        "ordered_ns": ordered_ns,
    }
    replayed = 15 if path in ("decoder", "agent") else 0
    first_ns = ordered_ns + (FIRST_MS[path] + 10 * repeat) * MS
    return {**row, "first_ns": first_ns, "replay_packets": replayed}


def run_of(file, paths):
    """A log as a run writes it, with known delays, and a slow beginning of every look."""
    stray = REPEATS * len(PATHS)
    tables = {
        "idle": [{"label": label, "cpu_percent": 1.5} for label in ("camera", "keeper", "router")],
        "look": [looked(stray, REPEATS, "agent", 0)],
        "sight": [{"look": stray, "number": STRANGER, "seen_ns": 1}],
        "camera": [],
    }
    for repeat in range(REPEATS):
        for place, name in enumerate(paths):
            look, started_ns = repeat * len(PATHS) + place, (repeat * 10 + place) * 1000 * MS
            tables["look"].append(looked(look, repeat, name, started_ns))
            for position in range(6):
                number, stamp_ns = 6 * look + position, started_ns + position * 150 * MS
                late = 100 if position < 3 else 0  # what the first pictures are must not count
                seen_ns = stamp_ns + (GLASS_MS[name] + repeat + late) * MS
                tables["camera"].append({"number": number, "stamp_ns": stamp_ns})
                tables["sight"].append({"look": look, "number": number, "seen_ns": seen_ns})
    return made_run(exp, file, tables, stream={"encoder": "none", "gop_s": 1.0})


@pytest.fixture
def made(tmp_path):
    return run_of(tmp_path / "made.mcap", PATHS)


def test_what_a_path_adds_is_found_within_a_repetition(made):
    assert analysis.glass_median(made, "standard").value == pytest.approx(8 + 1.5)
    assert analysis.added(made, "decoder").value == pytest.approx(1)
    assert analysis.added(made, "container", to="agent").value == pytest.approx(1)
    assert "on_demand" not in set(analysis.sights(made)["path"])
    assert analysis.idle_cost(made, "keeper") == pytest.approx(1.5)


def test_a_picture_that_the_camera_did_not_send_is_noticed(made):
    table = checks(made).set_index("path")
    assert table["unknown"].to_dict() == {path: int(path == "agent") for path in PATHS}
    assert table.loc["standard", "oldest_ms"] == pytest.approx(8 + 3 + 100)


def judged(run):
    return {name: entry_for(CLAIMS[name], measured) for name, measured in exp.measure(run).items()}


def test_the_papers_way_and_ours_are_claims_of_their_own(made):
    entries = judged(made)
    found = {
        name: (entry.measured.estimate.value, entry.verdict.value)
        for name, entry in entries.items()
    }
    assert found == {
        "A-G2G": (pytest.approx(4), "deviates"),
        "A-G2G-OURS": (pytest.approx(3), "deviates"),
        "A-FIRST": (pytest.approx(915 / 515), "reproduced"),
        "A-FIRST-OURS": (pytest.approx(90 / 515), "better"),
    }
    assert entries["A-FIRST"].measured.ends == {"on demand (ms)": 915, "standard (ms)": 515}
    said = "loading adds 400 ms [400, 400] in a container and 700 ms [700, 700] in a new process"
    assert said in entries["A-FIRST"].measured.reason


def test_a_log_without_the_papers_way_leaves_its_claims_open_and_says_why(tmp_path):
    old = run_of(tmp_path / "old.mcap", BEFORE)
    entries = judged(old)
    for name in ("A-G2G", "A-FIRST"):
        assert entries[name].verdict.value == "not yet"
        assert "the log has no looks through a component container" in entries[name].reason
        assert entries[name].as_json()["value"] is None
        assert "nan" not in render_in_full([entries[name]])
    assert entries["A-FIRST-OURS"].verdict.value == "better"
    assert "container" not in str(exp.figures(old)["latency"][1].keys())


def test_every_repetition_asks_all_paths_at_one_phase_and_phases_cover_the_group():
    config = exp.config(repeats=10)
    looks = looks_of(config, rng=np.random.default_rng(1))
    assert len(looks) == 10 * len(PATHS) - 5
    orders = set()
    for repeat in range(10):
        asked = [look for look in looks if look.repeat == repeat]
        assert {look.path for look in asked} == set(PATHS) - (
            {"on_demand"} if repeat % 2 else set()
        )
        assert len({look.phase for look in asked}) == 1
        orders.add(tuple(look.path for look in asked))
    assert len(orders) > 1
    assert sorted({int(10 * look.phase) for look in looks}) == list(range(10))

"""The latency experiment: known delays are found again. Its live run is that of its notebook."""

import numpy as np
import pytest
from made_logs import made_run

from sfglab.lab.experiments.latency import checks, exp
from sfglab.lab.experiments.latency.analysis import (
    added,
    first_mean,
    first_ratio,
    glass_median,
    idle_cost,
    sights,
)
from sfglab.lab.experiments.latency.experiment import looks_of
from sfglab.lab.experiments.latency.stage import PATHS

MS = 10**6
GLASS_MS = {"standard": 8, "decoder": 9, "agent": 11, "on_demand": 11}
FIRST_MS = {"standard": 500, "decoder": 60, "agent": 75, "on_demand": 1000}
REPEATS, STRANGER = 4, 10**6


def looked(look, repeat, path, ordered_ns):
    row = {"look": look, "repeat": repeat, "path": path, "phase": 0.5, "pictures": 6, "ordered_ns": ordered_ns}
    replayed = 15 if path in ("decoder", "agent") else 0
    first_ns = ordered_ns + (FIRST_MS[path] + 10 * repeat) * MS
    return {**row, "first_ns": first_ns, "replay_packets": replayed}


@pytest.fixture
def made(tmp_path):
    """A log as a run writes it, with known delays, and a slow beginning of every look."""
    stray = REPEATS * len(PATHS)
    tables = {
        "idle": [{"label": label, "cpu_percent": 1.5} for label in ("camera", "keeper", "router")],
        "look": [looked(stray, REPEATS, "agent", 0)],
        "sight": [{"look": stray, "number": STRANGER, "seen_ns": 1}],
        "camera": [],
    }
    for repeat in range(REPEATS):
        for place, name in enumerate(PATHS):
            look, started_ns = repeat * len(PATHS) + place, (repeat * 10 + place) * 1000 * MS
            tables["look"].append(looked(look, repeat, name, started_ns))
            for position in range(6):
                number, stamp_ns = 6 * look + position, started_ns + position * 150 * MS
                late = 100 if position < 3 else 0  # what the first pictures are must not count
                seen_ns = stamp_ns + (GLASS_MS[name] + repeat + late) * MS
                tables["camera"].append({"number": number, "stamp_ns": stamp_ns})
                tables["sight"].append({"look": look, "number": number, "seen_ns": seen_ns})
    return made_run(exp, tmp_path / "made.mcap", tables, stream={"encoder": "none", "gop_s": 1.0})


def test_what_a_path_adds_is_found_within_a_repetition_and_first_pictures_by_their_means(made):
    assert glass_median(made, "standard").value == pytest.approx(8 + 1.5)
    assert added(made, "decoder").value == pytest.approx(1)
    assert added(made, "agent").value == pytest.approx(3)
    assert "on_demand" not in set(sights(made)["path"])
    assert first_mean(made, "standard").value == pytest.approx(515)
    assert first_ratio(made, "agent").value == pytest.approx(90 / 515)
    assert first_ratio(made, "on_demand").value == pytest.approx(1015 / 515)
    assert idle_cost(made, "keeper") == pytest.approx(1.5)


def test_a_picture_that_the_camera_did_not_send_is_noticed(made):
    table = checks(made).set_index("path")
    assert table["unknown"].to_dict() == {"standard": 0, "decoder": 0, "agent": 1, "on_demand": 0}
    assert table.loc["standard", "oldest_ms"] == pytest.approx(8 + 3 + 100)


def test_claims_and_figure_come_from_the_log_alone(made):
    claims = exp.measure(made)
    assert claims["A-G2G"].estimate.value == pytest.approx(1)
    assert claims["A-FIRST"].estimate.value == pytest.approx(90 / 515)
    ((name, (figure, shown)),) = exp.figures(made).items()
    assert name == "latency"
    assert len(figure.axes) == 2
    assert shown["first_ratio_agent"]["value"] == pytest.approx(90 / 515)


def test_every_repetition_asks_all_paths_at_one_phase_and_phases_cover_the_group():
    config = exp.config(repeats=10)
    looks = looks_of(config, rng=np.random.default_rng(1))
    assert len(looks) == 10 * len(PATHS)
    orders = set()
    for repeat in range(10):
        asked = [look for look in looks if look.repeat == repeat]
        assert {look.path for look in asked} == set(PATHS)
        assert len({look.phase for look in asked}) == 1
        orders.add(tuple(look.path for look in asked))
    assert len(orders) > 1
    assert sorted({int(10 * look.phase) for look in looks}) == list(range(10))

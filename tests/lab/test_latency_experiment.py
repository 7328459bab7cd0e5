"""The latency experiment: known delays are found again. Its live run is that of its notebook."""

from itertools import product

import pytest
from made_logs import CLAIMS, made_run

from sfglab.lab.claims import entry_for
from sfglab.lab.experiments.latency import exp, results
from sfglab.lab.experiments.latency.experiment import PATHS, groups_of

MS = 10**6
GLASS_MS = {"standard": 8, "decoder": 9, "agent": 11, "container": 12, "on_demand": 12}
FIRST_MS = {"standard": 500, "decoder": 60, "agent": 75, "container": 900, "on_demand": 1200}
REPEATS = 4


def looked(look, repeat, path, ordered_ns):
    first_ns = ordered_ns + (FIRST_MS[path] + 10 * repeat) * MS
    times = {"ordered_ns": ordered_ns, "first_ns": first_ns}
    return {"look": look, "repeat": repeat, "path": path, "pictures": 6, **times}


@pytest.fixture
def made(tmp_path):
    """A log as a run writes it, with known delays, and a slow beginning of every look."""
    tables = {"look": [], "sight": [], "camera": []}
    for look, (repeat, name) in enumerate(product(range(REPEATS), PATHS)):
        started_ns = look * 1000 * MS
        tables["look"].append(looked(look, repeat, name, started_ns))
        for position in range(6):
            number, stamp_ns = 6 * look + position, started_ns + position * 150 * MS
            late = 100 if position < 3 else 0  # what the first pictures are must not count
            seen_ns = stamp_ns + (GLASS_MS[name] + repeat + late) * MS
            tables["camera"].append({"number": number, "stamp_ns": stamp_ns})
            tables["sight"].append({"look": look, "number": number, "seen_ns": seen_ns})
    return made_run(exp, tmp_path / "made.mcap", tables, stream={"encoder": "none"})


def test_what_a_path_adds_is_found_within_a_repetition(made):
    assert results.look_medians(made)["standard"].median() == pytest.approx(8 + 1.5)
    assert results.added(made, "decoder").value == pytest.approx(1)
    assert results.added(made, "container", to="agent").value == pytest.approx(1)
    assert "on_demand" not in set(results.sights(made)["path"])


def test_the_papers_way_and_ours_are_claims_of_their_own(made):
    measured = exp.measure(made)
    found = {}
    for name, finding in measured.items():
        entry = entry_for(CLAIMS[name], finding)
        found[name] = (finding.estimate.value, entry.verdict.value)
    assert found == {
        "A-G2G": (pytest.approx(4), "deviates"),
        "A-G2G-OURS": (pytest.approx(3), "deviates"),
        "A-FIRST": (pytest.approx(915 / 515), "reproduced"),
        "A-FIRST-OURS": (pytest.approx(90 / 515), "better"),
    }
    first = measured["A-FIRST"]
    assert first.ends == {"on demand (ms)": 915, "standard (ms)": 515}
    said = "Loading the decoder adds 400 ms [400, 400] in a running container and 700 ms [700, 700] in a new process"
    assert said in first.reason


def test_every_repetition_subscribes_on_all_paths_at_one_phase_and_phases_cover_the_gop():
    groups = groups_of(exp.config(repeats=10, seed=1))
    counter = 0
    for repeat, group in enumerate(groups):
        assert (group.repeat, group.first) == (repeat, counter)
        counter += len(group.paths)
        left_out = {"on_demand"} if repeat % 2 else set()
        assert sorted(group.paths) == sorted(set(PATHS) - left_out)
    assert len({group.paths for group in groups}) > 1
    assert sorted(int(10 * group.phase) for group in groups) == list(range(10))

"""Budgets of messages' ways: what a log says of them; live runs are in `tests/notebooks`."""

import pytest
from made_logs import made_run

from sfglab.lab.experiments.performance import LEAST, RATES_HZ, WAYS, budget, exp, slower

LEAST_US = {"prepare_us": 0.0, "write_us": 70.0, "hand_over_us": 30.0, "read_us": 40.0}
WAY_US = {"prepare_us": 10.0, "write_us": 100.0, "hand_over_us": 200.0, "read_us": 50.0}


def test_the_least_of_a_way_is_its_copies_hand_overs_and_passes_and_paces_are_compared_by_bouts(
    tmp_path,
):
    slow_us = WAY_US | {"hand_over_us": 560.0}
    rows = [
        {"way": name, "rate_hz": rate_hz, "bout": bout, "number": number, **us}
        for bout in range(4)
        for number in range(3)
        for rate_hz, way_us in zip(RATES_HZ, (slow_us, WAY_US), strict=True)
        for name, us in (dict.fromkeys(WAYS, way_us) | {LEAST: LEAST_US}).items()
    ]
    run = made_run(exp, tmp_path / "a.mcap", {"step": rows})
    table = budget(run).groupby("rate_hz")
    warm = table.get_group(RATES_HZ[1]).set_index("way")
    assert warm["least"].loc[list(WAYS)].tolist() == [140, 210, 30, 60]
    assert table[["whole", "prepare"]].agg(["min", "max"]).to_numpy().tolist() == [
        [720, 720, 10, 10],
        [360, 360, 10, 10],
    ]
    assert slower(run, "64 B, router").value == pytest.approx(2)

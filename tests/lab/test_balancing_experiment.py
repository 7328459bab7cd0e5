"""The experiment on caches and balanced QoS: known staleness is found, a broken cache is seen, runs repeat."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from made_logs import broken, ran, reference

from sfglab.arp.cache import Decision
from sfglab.arp.robots import SENSORS
from sfglab.lab.experiments.balancing import exp, experiment, staleness
from sfglab.lab.experiments.balancing.experiment import QOS, readings, staleness_of
from sfglab.lab.experiments.balancing.optimum import balance_checks, balance_rows
from sfglab.rtps import Drop, Fate, FlowOutcome
from sfglab.units import NS_PER_S

SMALL = {"rates_hz": (100,), "stale_s": 5.0, "stale_seeds": 1, "weights": 2}
REFERENCE = reference(exp)


@pytest.mark.parametrize("name", SENSORS)
def test_readings_repeat_as_long_as_the_sensor_says(name):
    sensor = SENSORS[name]
    duration_s = 400 * sensor.change_s
    values = readings(
        sensor, rate_hz=20 / sensor.change_s, duration_s=duration_s, rng=np.random.default_rng(1)
    )
    changes = sum(a != b for a, b in pairwise(values))
    assert 320 < changes < 480, "400 are expected, and a few are too short to be read"


def test_a_cache_that_forgets_a_change_fails_its_checks(tmp_path, monkeypatch):
    class Deaf(experiment.LocalCache):
        def offer(self, topic, value, *, now_ns, size_bytes=0):
            if now_ns == 0:
                return super().offer(topic, value, now_ns=now_ns, size_bytes=size_bytes)
            return Decision.HELD

    monkeypatch.setattr(experiment, "LocalCache", Deaf)
    run = ran(exp, tmp_path / "deaf.mcap", **SMALL)
    assert broken(run["check"]).keys() >= {
        "LC: the station always knows the sensor's value",
        "LC: the model's compiled cache lets the same readings pass",
    }
    assert exp.measure(run)["B-LC"].estimate.value < 1


def test_stale_time_is_from_the_change_to_the_next_value_that_arrives():
    # Value 2 is lost at 2 s; the station believes 1 until 3 arrives at 5.5 s.
    arrives = np.array([True, False, True])
    outcome = FlowOutcome(
        name="a",
        published_ns=np.array([0, 2, 5]) * NS_PER_S,
        received_ns=np.array([1, 0, 5.5]) * NS_PER_S,
        value=np.array([1, 2, 3], np.int32),
        fate=np.where(arrives, Fate.DELIVERED, Fate.OVERWRITTEN).astype(np.int8),
        dropped=np.where(arrives, Drop.NOT, Drop.MEDIUM).astype(np.int8),
    )
    expected = {"stale_share": (1 + 3.5) / 10, "longest_s": 3.5, "messages_hz": 0.3}
    assert staleness_of(outcome, 10.0) == pytest.approx(expected)


def test_a_longest_silence_makes_the_station_wrong_for_less_time():
    share = staleness(REFERENCE).set_index(["qos", "silence_s"])["stale_share"]
    for qos in QOS:
        assert share[qos, 0.2] < share[qos, 0.0] / 2


def test_a_wrong_optimum_fails_its_checks():
    rows = list(balance_rows(exp.config("smoke", **SMALL)))
    assert all(check.held == check.checked for check in balance_checks(rows))
    wrong = [replace(row, depth=row.depth * 1.001) for row in rows]
    found = [c.check for c in balance_checks(wrong) if c.held < c.checked]
    assert found == [
        "OPT: D is the closed form's",
        "OPT: Eq. 5 holds with nothing to spare, and Dmin <= D <= Dmax",
    ]
    both = [replace(row, depth=row.depth / 2, depth_closed=row.depth_closed / 2) for row in rows]
    assert [c.check for c in balance_checks(both) if c.held < c.checked] == found[1:], (
        "Eq. 5 by itself"
    )


def test_a_run_gives_the_same_again(tmp_path):
    one, two = (ran(exp, tmp_path / name, **SMALL) for name in ("one.mcap", "two.mcap"))
    assert all(one.table(table).equals(two.table(table)) for table in exp.tables)

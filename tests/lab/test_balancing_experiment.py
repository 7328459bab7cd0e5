"""The experiment on caches and balanced QoS: known staleness is found, a broken cache is seen, runs repeat."""

from __future__ import annotations

from dataclasses import asdict, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from sfglab.arp.cache import Decision
from sfglab.arp.robots import SENSORS
from sfglab.lab.claims import How
from sfglab.lab.experiments import balancing
from sfglab.lab.experiments.balancing import caches
from sfglab.lab.experiments.balancing import stale as stale_module
from sfglab.lab.experiments.balancing.config import Config
from sfglab.lab.experiments.balancing.optimum import balance_checks, balance_rows
from sfglab.lab.experiments.balancing.readings import readings
from sfglab.lab.experiments.profiles import ConfigError
from sfglab.qos import QoSProfile
from sfglab.record import LogReader
from sfglab.rtps import Drop, Fate, FlowOutcome

ROOT = Path(__file__).parents[2]
S = 1_000_000_000
SMALL = replace(Config.of_profile("smoke"), rates_hz=(100,), stale_s=5.0, stale_seeds=1, weights=2)


@pytest.mark.parametrize("name", SENSORS)
def test_readings_repeat_as_long_as_the_sensor_says(name):
    sensor = SENSORS[name]
    duration_s = 400 * sensor.change_s
    values = readings(sensor, rate_hz=20 / sensor.change_s, duration_s=duration_s, rng=np.random.default_rng(1))
    changes = sum(a != b for a, b in pairwise(values))
    assert 320 < changes < 480, "400 are expected, and a few are too short to be read"


def test_a_cache_that_forgets_a_change_fails_its_checks(monkeypatch):
    class Deaf(caches.LocalCache):
        def offer(self, topic, value, *, now_ns, size_bytes=0):
            if now_ns == 0:
                return super().offer(topic, value, now_ns=now_ns, size_bytes=size_bytes)
            return Decision.HELD

    monkeypatch.setattr(caches, "LocalCache", Deaf)
    _, checks = caches.cache_rows(SMALL)
    broken = {row.check for row in checks if row.held < row.checked}
    assert "LC: the station always knows the sensor's value" in broken
    assert "LC: the model's compiled cache lets the same readings pass" in broken


def flow_outcome(published_s, received_s, values):
    received = np.array([0 if r is None else round(r * S) for r in received_s])
    return FlowOutcome(
        name="a",
        published_ns=np.array([round(p * S) for p in published_s]),
        received_ns=received,
        value=np.array(values, np.int32),
        fate=np.where(received > 0, Fate.DELIVERED, Fate.OVERWRITTEN).astype(np.int8),
        dropped=np.where(received > 0, Drop.NOT, Drop.MEDIUM).astype(np.int8),
    )


def test_stale_time_is_from_the_change_to_the_next_value_that_arrives():
    # Value 2 is lost at 2 s; the station believes 1 until 3 arrives at 5.5 s.
    outcome = flow_outcome([0, 2, 5], [1, None, 5.5], [1, 2, 3])
    row = stale_module._row("reliable", 0.0, 0, outcome, 10.0)
    assert row.stale_share == pytest.approx((1 + 3.5) / 10)
    assert row.longest_s == pytest.approx(3.5)
    assert row.messages_hz == pytest.approx(0.3)


def test_a_longest_silence_makes_the_station_wrong_for_less_time():
    rows, _ = stale_module.stale_rows(replace(SMALL, stale_s=120.0, silences_s=(0.0, 0.2)))
    share = {(row.qos, row.silence_s): row.stale_share for row in rows}
    for qos in stale_module.QOS:
        assert share[qos, 0.2] < share[qos, 0.0] / 2


def test_a_wrong_optimum_fails_its_checks():
    rows = balance_rows(SMALL)
    assert all(check.held == check.checked for check in balance_checks(rows))
    wrong = [replace(row, depth=row.depth * 1.001) for row in rows]
    assert [c.check for c in balance_checks(wrong) if c.held < c.checked] == ["OPT: D is the closed form's"]


def test_a_run_is_a_log_that_fills_its_claims_and_the_same_again(tmp_path, monkeypatch):
    monkeypatch.setenv("SFGLAB_ROOT", str(ROOT))
    tables = []
    for name in ("one", "two"):
        log = balancing.run(SMALL, tmp_path / f"{name}.mcap")
        with LogReader(log) as reader:
            tables.append({t: reader.table(t) for t in ("cache", "stale", "shown", "balance", "front")})
    for table, first in tables[0].items():
        assert first.equals(tables[1][table]), table
    measured = balancing.measure_claims(log)
    assert set(measured) == {"B-LC", "B-CC", "B-OPT", "B-TAB1"}
    assert all(m.estimate.value == 1 and m.how is How.EXACT for m in measured.values())
    assert set(balancing.figures(log)) == {"balancing_caches", "balancing_stale", "balancing_qos"}


def test_the_front_has_a_trade_off_and_the_printed_optimum_is_no_better(tmp_path, monkeypatch):
    monkeypatch.setenv("SFGLAB_ROOT", str(ROOT))
    log = balancing.run(replace(SMALL, weights=5, rates_hz=(100, 1000)), tmp_path / "a.mcap")
    front = balancing.load_results(log).front
    for _, group in front.groupby("rate_max_hz"):
        ours = group[group["method"] == "ours"].sort_values("freshness")
        assert (ours["latency_ms"].diff().dropna() >= -1e-6).all(), "fresher is later"
        printed = group[group["method"] == "printed"].iloc[0]
        assert (ours["up_to_date"].max()) > printed["up_to_date"]
    assert (front[front["method"] == "ours"]["utilisation"] <= 0.9 + 1e-6).all()


def test_unknown_profiles_are_refused():
    with pytest.raises(ConfigError, match="given 'long'"):
        Config.of_profile("long")
    assert asdict(Config.of_profile("quick", seed=3))["seed"] == 3


def test_the_model_qos_is_what_the_rows_say():
    assert stale_module.QOS["reliable"] == QoSProfile(depth=1)

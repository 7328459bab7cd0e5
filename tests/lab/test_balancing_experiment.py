"""Caches and balanced QoS: what is broken fails its checks, and explorers compute what caches do."""

from dataclasses import replace

import numpy as np
import pytest
from made_logs import DATA, broken, ran, reference

from sfglab.arp.balancing import BalanceInput
from sfglab.arp.cache import Decision, LocalCache
from sfglab.arp.link import at_depths, link_of
from sfglab.arp.robots import SENSORS
from sfglab.arp.topics import load_topics
from sfglab.lab.experiments.balancing import (
    cache_curves,
    channel_loads,
    exp,
    experiment,
)
from sfglab.lab.experiments.balancing.experiment import balance_checks, balance_row, readings
from sfglab.units import NS_PER_S


def test_a_cache_that_misses_changes_fails_its_checks(tmp_path, monkeypatch):
    class Deaf(LocalCache):
        def offer(self, topic, value, *, now_ns, **size):
            return Decision.HELD if now_ns else super().offer(topic, value, now_ns=now_ns, **size)

    monkeypatch.setattr(experiment, "LocalCache", Deaf)
    run = ran(exp, tmp_path / "deaf.mcap", rates_hz=(100,), topics=((10,),))
    assert "LC: the station always knows the sensor's value" in broken(run["check"])
    assert exp.measure(run)["B-LC"].estimate.value < 1


def test_a_wrong_depth_fails_its_checks():
    row = balance_row(BalanceInput(topics=(7, 6, 6), rate_max_hz=100), 0.5)
    wrong = replace(row, depth=1.001 * row.depth)
    assert all(holds for _, holds in balance_checks(row))
    assert [text[5:13] for text, holds in balance_checks(wrong) if not holds] == [
        "D is the",
        "Eq. 5 ho",
    ]


def test_details_of_the_reference_run_say_what_was_saved_and_what_was_recorded():
    details = exp.measure(reference(exp))["B-LC"].details
    assert details["fewer HEARTBEAT frames than with no method"].startswith("55% at 100 Hz")
    assert details["fewer bytes sent"].startswith("87% at 100 Hz")
    assert details["fewer messages sent, electrode (as Float32)"] == "43%"
    assert details["fewer messages sent, electrode (as String)"] == "98%"


def test_the_explorer_has_the_messages_and_outdated_values_of_a_cache_on_a_lossy_link():
    lidar, loss, rate_hz, silence_s = SENSORS["lidar"], 0.3, 100, 0.25
    rng = np.random.default_rng(0)
    values = readings(lidar, rate_hz=rate_hz, duration_s=1000, rng=rng)
    cache = LocalCache(max_silence_ns=round(silence_s * NS_PER_S))
    known, sent, outdated = None, 0, 0
    for place, value in enumerate(values):
        if cache.offer("a", value, now_ns=place * NS_PER_S // rate_hz).passes:
            sent += 1
            known = known if rng.random() < loss else value
        outdated += known != value
    picture = cache_curves(rate_hz=rate_hz, loss_percent=100 * loss, silence_s=silence_s)
    messages, shares = (picture.at(panel.title, lidar.change_s)["y"] for panel in picture.panels)
    assert sent / 1000 == pytest.approx(messages.iloc[-1], rel=0.03)
    # A lidar's value can return to an older one.
    assert 100 * outdated / len(values) == pytest.approx(shares.iloc[-1], rel=0.07)


def test_the_demand_has_a_cache_for_sensors_and_none_for_hello():
    demand = channel_loads(reference(exp))["OPT and local cache (LC)"]
    hellos = {"/hello", "/robot3/localisation"}
    given = load_topics(DATA / "qos" / "paper_b.yaml")
    cached = [replace(topic, cached=topic.name not in hellos) for topic in given.topics]
    link = link_of(replace(given, topics=tuple(cached)))
    rates_hz, depths = np.full(len(cached), 165.667), np.full(len(cached), 827)
    expected = at_depths(link, depths, rates_hz).utilisation(rates_hz)
    assert demand[1000] == pytest.approx(expected, rel=1e-3)

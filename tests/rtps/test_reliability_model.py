"""The protocol against hand-worked schedules and measured figures of real DDS."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from sfglab.errors import InvalidValueError
from sfglab.qos import Durability, History, QoSProfile, Reliability
from sfglab.rtps import (
    FAST_DDS,
    PRESETS,
    Fate,
    Flow,
    Medium,
    Scenario,
    run,
    trace,
)

MS = 1_000_000
S = 1_000_000_000
QUIET = Medium(loss=0.0, overhead_s=0.0, rate_bps=8e6, contention=0.0, shared=False)
LOSSY = replace(QUIET, loss=0.1)
DEEP = QoSProfile(depth=100_000)
KEEP_ALL = QoSProfile(history=History.KEEP_ALL)
BEST_EFFORT = QoSProfile(reliability=Reliability.BEST_EFFORT)
A_FLOW = Flow(name="a", source="robot", target="station", rate_hz=100.0)


def played(medium=QUIET, *, seed=0, vendor=FAST_DDS, duration_s=1.0, drain_s=10.0, **flow):
    flows, times = (replace(A_FLOW, **flow),), {"duration_s": duration_s, "drain_s": drain_s}
    return run(Scenario(flows=flows, medium=medium, vendor=vendor, **times), seed=seed)


def outcome(*args, **kwargs):
    return played(*args, **kwargs).flows["a"]


def test_on_a_quiet_link_samples_keep_their_period_and_take_airtime_latency_and_service():
    # 62 bytes of headers, INFO_TS 12, DATA 24, payload 24: 122 bytes at 1 byte per microsecond.
    medium = replace(QUIET, latency_s=0.005)
    flow = outcome(medium, phase_s=0.003, service_s=0.0001, qos=DEEP)
    assert np.array_equal(flow.published_ns, 3 * MS + np.arange(100) * 10 * MS)
    assert set(flow.latency_ns) == {122_000 + 5 * MS + 100_000}


def test_seeds_lose_samples_of_their_own():
    lossy = replace(QUIET, loss=0.5)
    first, *others = (outcome(lossy, seed=i, qos=BEST_EFFORT, duration_s=20.0) for i in range(4))
    for other, shift in product(others, range(-8, 9)):
        alike = np.mean(first.delivered == np.roll(other.delivered, shift))
        assert 0.4 < alike < 0.6


def test_a_lost_sample_takes_a_heartbeat_a_request_and_a_retransmission():
    """Fast DDS, depth not full: heartbeat after 3 s, request 5 ms later, retransmission 5 ms after that."""
    flow = replace(A_FLOW, rate_hz=1)
    scenario = Scenario(flows=(flow,), medium=QUIET, duration_s=1.0)
    done, _ = trace(scenario, seed=0, lost={"a/DATA/1": True})
    frames_us = (62 + 16 + 32) + (62 + 16 + 28 + 32) + 122
    assert done.counts["lost"] == 1
    assert done.flows["a"].latency_ns.tolist() == [3 * S + 10 * MS + frames_us * 1000]


def test_a_small_depth_loses_what_is_overwritten_before_its_retransmission():
    assert 0.06 < outcome(LOSSY, qos=QoSProfile(depth=1), duration_s=20).loss < 0.14


@pytest.mark.parametrize(
    ("durability", "acknacks"), [(Durability.VOLATILE, 100), (Durability.TRANSIENT_LOCAL, 991)]
)
def test_an_acknowledged_sample_leaves_a_volatile_history_only(durability, acknacks):
    """One ACKNACK for each ten samples, when the history is full; or for each, once there have been ten."""
    qos = QoSProfile(depth=10, durability=durability)
    assert played(qos=qos, duration_s=10.0).counts["acknack"] == acknacks


def test_a_reader_overwrites_in_its_own_history_what_waits_for_the_executor_or_behind_a_gap():
    slow = outcome(qos=QoSProfile(depth=5), rate_hz=1000, service_s=0.002)
    assert 0.4 < slow.loss < 0.6
    assert (slow.fate[~slow.delivered] == Fate.LATE).all()
    shallow = outcome(LOSSY, rate_hz=1000, reader_depth=10, qos=QoSProfile(depth=1000))
    assert (shallow.fate == Fate.LATE).sum() > 300


@pytest.mark.parametrize("vendor", PRESETS.values(), ids=lambda vendor: vendor.name)
def test_a_history_that_keeps_all_loses_nothing(vendor):
    medium = replace(QUIET, loss=0.3)
    assert outcome(medium, vendor=vendor, qos=DEEP, duration_s=2.0, drain_s=300.0).loss == 0


@pytest.mark.parametrize(
    ("preset", "depth", "low_ms", "high_ms"),
    [
        ("fast_dds_sync", 800, 1000, 2000),  # measured: 1371 and 1386 ms
        ("fast_dds_foxy", 800, 1000, 2000),  # read: as synchronous, its bytes do not add up
        ("fast_dds_async", 800, 1, 8),  # measured: 3.2 and 2.3 ms
        ("fast_dds_async", 10, 1, 8),  # measured: 2.3 and 3.5 ms
        ("fast_dds_sync", 10, 4, 12),  # measured: 8.1 and 8.4 ms
    ],
)
def test_latencies_at_3_percent_loss_are_those_of_real_fast_dds(preset, depth, low_ms, high_ms):
    given = {"vendor": PRESETS[preset], "qos": QoSProfile(depth=depth), "duration_s": 9.0}
    runs = [outcome(Medium(loss=0.03), seed=seed, **given) for seed in range(6)]
    assert low_ms < np.mean(np.concatenate([flow.latency_ns for flow in runs])) / MS < high_ms


@pytest.mark.parametrize(("size_bytes", "sample"), [(60, 807), (200, 392), (1000, 100)])
def test_a_heartbeat_rides_with_the_same_sample_as_on_real_fast_dds(size_bytes, sample):
    """Measured: rclpy of Jazzy and Kilted, synchronous."""
    given = {"vendor": PRESETS["fast_dds_sync"], "qos": QoSProfile(depth=999), "drain_s": 0.1}
    given |= {"rate_hz": 1e3, "size_bytes": size_bytes}
    for count in (sample - 1, sample):
        done = played(Medium(loss=0.0), duration_s=(count - 0.5) / 1e3, **given)
        assert done.counts["acknack"] == (count == sample)


@pytest.mark.parametrize(
    ("mode", "rule", "depth", "throttled"),
    [
        ("async", "block", 1, True),  # a full history waits for the thread that sends
        ("async", "block", 4000, False),  # what waits there travels together
        ("sync", "block", 1, True),  # the publishing thread waits
        ("async", "tail", 1, False),
    ],
)
def test_what_a_crowded_medium_costs_depends_on_who_waits(mode, rule, depth, throttled):
    """It carries some 600 samples per second of 1,000."""
    medium = Medium(loss=0.0, overhead_s=1.5e-3, queue_frames=50, queue_rule=rule)
    given = {"vendor": PRESETS[f"fast_dds_{mode}"], "qos": QoSProfile(depth=depth)}
    done = played(medium, rate_hz=1000.0, duration_s=3.0, **given)
    assert (done.counts["throttled"] > 0) == throttled
    assert (done.flows["a"].loss > 0.3) == (rule == "tail")


@pytest.mark.parametrize(("relayed", "loss", "airtime"), [(False, 0.1, 1.0), (True, 0.19, 1.9)])
def test_best_effort_loses_as_often_as_it_is_on_air_and_an_access_point_costs_twice(
    relayed, loss, airtime
):
    medium = replace(LOSSY, shared=True, access_point=relayed)
    done = played(medium, qos=BEST_EFFORT, duration_s=40.0)
    assert done.flows["a"].loss == pytest.approx(loss, abs=0.02)
    assert done.counts["airtime_ns"] == pytest.approx(airtime * 4000 * 122_000, rel=0.02)
    assert done.counts["heartbeat"] == done.counts["acknack"] == done.counts["repeated"] == 0


CHAIN = replace(A_FLOW, then="b", change_s=0.1), replace(A_FLOW, name="b", rate_hz=0.0)


def test_a_chain_publishes_the_value_that_was_processed():
    values = run(Scenario(flows=CHAIN), seed=1).flows
    arrived = values["a"].value[values["a"].delivered]
    assert len(arrived) > 1000
    assert values["b"].value.tolist() == arrived.tolist()


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Scenario(flows=(CHAIN[0], replace(CHAIN[1], then="b"))), "'b': then: given 'b'"),
        (
            lambda: Scenario(flows=(CHAIN[0], replace(CHAIN[1], change_s=1.0))),
            "without change_s: $",
        ),
        (lambda: replace(A_FLOW, qos=KEEP_ALL), "history: given 'keep_all', allowed: keep_last"),
        (lambda: replace(FAST_DDS, nack_most=257), "Fast DDS: nack_most: given 257"),
    ],
)
def test_bad_scenarios_are_refused_with_the_place(build, message):
    with pytest.raises(InvalidValueError, match=message):
        build()

"""The reliability model against hand-worked schedules, invariants, and a known saw-tooth."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from sfglab.errors import InvalidValueError
from sfglab.qos import Durability, History, QoSProfile, Reliability
from sfglab.rtps import CYCLONE_DDS, FAST_DDS, PRESETS, Drop, Fate, Flow, Medium, Scenario, run

MS = 1_000_000
S = 1_000_000_000
QUIET = Medium(loss=0.0, overhead_s=0.0, rate_bps=8e6, contention=0.0, shared=False)
KEEP_ALL = QoSProfile(history=History.KEEP_ALL)
BEST_EFFORT = QoSProfile(reliability=Reliability.BEST_EFFORT)


def one(medium=QUIET, *, duration_s=1.0, vendor=FAST_DDS, **flow):
    values = {"source": "robot", "target": "station", "rate_hz": 100.0, **flow}
    return Scenario(
        flows=(Flow(name="a", **values),), medium=medium, vendor=vendor, duration_s=duration_s
    )


def outcome(scenario, seed=0):
    return run(scenario, seed=seed).flows["a"]


def test_latency_on_a_quiet_link_is_airtime_latency_and_service():
    # 62 bytes of headers, INFO_TS 12, DATA 24, payload 24: 122 bytes at 1 byte a microsecond.
    flow = outcome(
        one(replace(QUIET, latency_s=0.005), size_bytes=24, service_s=0.0001, qos=KEEP_ALL)
    )
    assert set(flow.latency_ns) == {122_000 + 5 * MS + 100_000}
    assert flow.loss == 0


def test_seeds_lose_samples_of_their_own():
    scenario = one(replace(QUIET, loss=0.5), duration_s=20.0, qos=BEST_EFFORT)
    lost = [outcome(scenario, seed).fate != Fate.DELIVERED for seed in range(6)]
    pairs = [(a, b) for b in range(6) for a in range(b)]
    alike = [np.mean(lost[a] == np.roll(lost[b], by)) for a, b in pairs for by in range(-8, 9)]
    assert min(alike) > 0.4
    assert max(alike) < 0.6


def test_publications_keep_their_period():
    flow = outcome(one(rate_hz=50, phase_s=0.003))
    assert np.array_equal(flow.published_ns, 3 * MS + np.arange(50) * 20 * MS)


def test_samples_queue_behind_each_other_on_a_shared_medium():
    medium = replace(QUIET, shared=True)
    given = {"target": "station", "rate_hz": 10, "qos": BEST_EFFORT, "size_bytes": 24}
    flows = tuple(Flow(name=name, source=name, **given) for name in "ab")
    done = run(Scenario(flows=flows, medium=medium, duration_s=1), seed=0)
    assert set(done.flows["a"].latency_ns) == {122_000}
    assert set(done.flows["b"].latency_ns) == {244_000}


def test_a_lost_sample_is_repaired_by_heartbeat_request_and_repeat():
    """Fast DDS, depth not full: heartbeat after 3 s, request 5 ms later, repair 5 ms after that."""
    medium = replace(QUIET, loss=0.3)
    scenario = one(medium, rate_hz=1, duration_s=1.0, qos=QoSProfile(depth=10), size_bytes=24)
    for seed in range(200):
        flow = outcome(scenario, seed)
        if flow.dropped[0] == Drop.MEDIUM and flow.fate[0] == Fate.DELIVERED:
            break
    frames_us = (62 + 16 + 32) + (62 + 16 + 28 + 32) + 122
    waits = flow.latency_ns[0] - 10 * MS - frames_us * 1000
    assert waits % (3 * S) == 0, "whole heartbeat periods, and nothing else"


def test_overwritten_before_repair_is_what_a_small_depth_loses():
    medium = replace(QUIET, loss=0.1)
    small = outcome(one(medium, qos=QoSProfile(depth=1), duration_s=20))
    # A request names 256 samples, and while the history has room, heartbeats are 3 s apart.
    large = outcome(replace(one(medium, qos=QoSProfile(depth=5000), duration_s=20), drain_s=60.0))
    assert 0.06 < small.loss < 0.14
    assert large.loss == 0
    lost = small.fate == Fate.OVERWRITTEN
    assert lost.any()
    assert (small.dropped[lost] != Drop.NOT).all()


def test_an_acknowledged_sample_leaves_a_volatile_history_and_stays_in_a_transient_local_one():
    volatile, latched = (
        run(one(qos=QoSProfile(depth=10, durability=durability), duration_s=10.0), seed=0).counts
        for durability in (Durability.VOLATILE, Durability.TRANSIENT_LOCAL)
    )
    assert volatile["acknack"] == 100, "one for each ten samples: then the history is full"
    assert latched["acknack"] == 991, "one for each, once there have been ten"


def test_a_slow_reader_overwrites_in_its_own_history():
    flow = outcome(one(qos=QoSProfile(depth=5), rate_hz=1000, service_s=0.002))
    assert 0.4 < flow.loss < 0.6
    assert (flow.fate[~flow.delivered] == Fate.LATE).all()


def test_a_full_queue_drops_at_the_sender():
    flow = outcome(one(Medium(loss=0, rate_bps=1e5, queue_frames=3), qos=BEST_EFFORT, rate_hz=1000))
    assert (flow.dropped == Drop.QUEUE).sum() > 100
    assert (flow.dropped == Drop.MEDIUM).sum() == 0


def test_the_local_cache_publishes_changes_only():
    done = run(one(change_s=0.5, cached=True, rate_hz=100, duration_s=100, qos=KEEP_ALL), seed=3)
    values = done.flows["a"].value
    assert (np.diff(values) > 0).all()
    assert 150 < len(values) < 250
    assert done.counts["held"] == 10_000 - len(values)


def test_the_longest_silence_bounds_gaps():
    flow = outcome(
        one(change_s=10, cached=True, max_silence_s=0.2, rate_hz=100, duration_s=20, qos=KEEP_ALL)
    )
    assert np.diff(flow.published_ns).max() == 200 * MS


def test_cache_control_saves_processing_and_not_frames():
    with_, without = (
        run(
            one(change_s=0.5, service_s=0.001, compare_s=compare, duration_s=20, qos=KEEP_ALL),
            seed=3,
        )
        for compare in (1e-5, None)
    )
    assert with_.counts["data"] == without.counts["data"]
    assert with_.counts["processed"] < without.counts["processed"] / 10
    assert with_.counts["processed"] + with_.counts["compared"] == without.counts["processed"]


def test_a_chain_carries_the_value_on():
    flows = (
        Flow(name="hello", source="r1", target="station", rate_hz=10, then="move"),
        Flow(name="move", source="station", target="r1"),
    )
    done = run(Scenario(flows=flows, medium=QUIET, duration_s=2), seed=0).flows
    assert np.array_equal(done["hello"].value, done["move"].value)
    assert np.array_equal(done["move"].published_ns, done["hello"].received_ns)


def test_missed_deadlines_are_counted_and_change_nothing():
    qos = QoSProfile(reliability=Reliability.BEST_EFFORT, deadline_ns=15 * MS)
    flow = outcome(one(replace(QUIET, loss=0.2), qos=qos, duration_s=10))
    gaps = np.diff(flow.received_ns[flow.delivered])
    assert flow.deadlines_missed() == (gaps // (15 * MS)).sum() > 0


def flat_out(*, piggyback):
    """Fast-DDS issue 19: a reliable writer flat out, a history of about 100, heartbeats every 3 s."""
    vendor = replace(FAST_DDS, piggyback_when_full=piggyback)
    medium = Medium(
        loss=0.001, rate_bps=100e6, overhead_s=0, contention=0, shared=False, queue_frames=50_000
    )
    return outcome(
        one(medium, vendor=vendor, rate_hz=770, qos=QoSProfile(depth=100), duration_s=30), 5
    )


def test_without_piggyback_delivery_stalls_until_the_next_heartbeat_3_s_apart():
    flow = flat_out(piggyback=False)
    received_s = flow.received_ns[flow.delivered] / S
    stalled = np.diff(received_s) > 0.5
    between_s = np.diff(received_s[1:][stalled])
    assert stalled.sum() >= 5
    assert np.allclose(between_s, 3 * np.round(between_s / 3), atol=0.02)
    assert flow.loss > 0.3


def test_with_piggyback_the_saw_tooth_is_gone():
    flow = flat_out(piggyback=True)
    assert np.diff(flow.received_ns[flow.delivered]).max() < 0.2 * S
    assert flow.loss < 0.01


# --- Readers that answer at once, and repairs that travel together: Cyclone DDS.


@pytest.mark.parametrize(
    ("rate_hz", "frames"),
    [(100, (200, 1, 2)), (5, (10, 0, 10))],
    ids=["in a row, the first and the last", "after a pause, each at once"],
)
def test_a_prompt_reader_acknowledges(rate_hz, frames):
    counts = run(one(vendor=CYCLONE_DDS, rate_hz=rate_hz, duration_s=2.0), seed=1).counts
    assert (counts["data"], counts["heartbeat"], counts["acknack"]) == frames


def test_a_prompt_reader_asks_for_what_is_new_at_once_and_for_the_same_again_after_the_delay():
    medium, qos = replace(QUIET, loss=0.1), QoSProfile(depth=100)
    flow = outcome(one(medium, vendor=CYCLONE_DDS, qos=qos, duration_s=20), 1)
    assert flow.loss == 0
    late_ns = flow.latency_ns[flow.latency_ns > 5 * MS]
    # A loss shows with the next sample, 10 ms later; a lost repair or request costs 100 ms more.
    assert 10 * MS < np.median(late_ns) < 80 * MS
    assert ((late_ns > 10 * MS) & (late_ns < 12 * MS)).sum() > 20


def test_prompt_repairs_travel_together():
    medium, qos = Medium(rate_bps=1e6, queue_frames=50), QoSProfile(depth=1000)
    done = run(one(medium, vendor=CYCLONE_DDS, rate_hz=1000, qos=qos, duration_s=2.0), seed=1)
    fate = done.flows["a"].fate
    assert done.counts["repeated"] > 100
    assert done.counts["repeated"] > 10 * (done.counts["data"] - len(fate)), (
        "repeated in few frames"
    )
    assert set(fate.tolist()) <= {Fate.DELIVERED, Fate.OVERWRITTEN, Fate.UNDERWAY, Fate.LATE}


@settings(max_examples=30, deadline=None)
@given(
    st.sampled_from(list(PRESETS.values())), st.sampled_from([0.0, 0.1, 0.3]), st.integers(0, 20)
)
def test_keep_all_loses_nothing(vendor, loss, seed):
    scenario = one(replace(QUIET, loss=loss), vendor=vendor, qos=KEEP_ALL, duration_s=2.0)
    assert outcome(replace(scenario, drain_s=300.0), seed).loss == 0


A_FLOW = Flow(name="a", source="r", target="s", rate_hz=1)


@pytest.mark.parametrize(
    ("build", "message"),
    [
        (lambda: Scenario(flows=(A_FLOW, A_FLOW)), "different names"),
        (lambda: Scenario(flows=(replace(A_FLOW, then="b"),)), "then: given 'b'"),
        (lambda: Scenario(flows=(A_FLOW,), medium=Medium(loss=1.0)), "loss"),
        (lambda: Scenario(flows=(A_FLOW,), medium=Medium(latency_s=-1.0)), "latency_s from 0"),
        (
            lambda: Medium(queue_rule="middle"),
            "queue_rule: given 'middle', allowed: tail, head, block",
        ),
        (lambda: Medium(access_point=True, shared=False), "access_point"),
        (lambda: Medium(stall_s=0.2, stall_every_s=0.1), "stall_s < stall_every_s"),
        (lambda: replace(FAST_DDS, heartbeat_ns=0), "heartbeat"),
        (lambda: replace(FAST_DDS, piggyback_bytes=-1), "bytes"),
        *(
            (
                lambda f=f: Scenario(flows=(replace(A_FLOW, **{f: -1}),)),
                f"{f}: given -1, allowed: 0 and more",
            )
            for f in ("rate_hz", "phase_s", "reader_depth", "compare_s")
        ),
    ],
)
def test_bad_scenarios_are_refused_with_the_place(build, message):
    with pytest.raises(InvalidValueError, match=message):
        build()

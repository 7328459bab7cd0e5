"""Simulated laps: what couples control to communication is what is delivered, and nothing else."""

from dataclasses import replace

import numpy as np
import pytest

from sfglab.arp.hallway import End, Manoeuvre
from sfglab.arp.hallway.simulation import OPTIMUM, LapSettings, SimulatedLap
from sfglab.arp.robots import METHODS
from sfglab.rtps import Medium

PERFECT = Medium(rate_bps=1e13, loss=0.0, shared=False, overhead_s=0.0, contention=0.0)
DEAD = Medium(loss=1 - 1e-12)


def settings(method, **changes):
    depth = OPTIMUM if METHODS[method].optimised else 10
    return replace(LapSettings(method=method, rate_max_hz=100, depth=depth), **changes)


@pytest.mark.parametrize("method", METHODS.values(), ids=METHODS)
def test_over_a_perfect_channel_every_method_completes_the_lap_and_holds_back_what_it_claims(
    method,
):
    lap = SimulatedLap(settings(method.name, medium=PERFECT), 0).run()
    assert (lap.end, lap.robot) == (End.SUCCESS, "")
    counts = lap.outcome.counts
    assert (counts["held"] > 0) == method.local_cache
    assert (counts["compared"] > 0) == (method.cache_control and not method.local_cache)


def test_over_a_dead_channel_no_robot_moves_until_the_lap_is_given_up():
    lap = SimulatedLap(settings("OPT+LC", medium=DEAD), 0, record=True)
    assert lap.run().end is End.TIMEOUT
    assert len({snapshot.poses.tobytes() for snapshot in lap.snapshots}) == 1


@pytest.mark.parametrize(
    ("delay_s", "ends"), [(0.25, {End.SUCCESS}), (1.0, {End.CONTACT, End.STOP})]
)
def test_late_messages_end_a_lap_and_slightly_late_ones_do_not(delay_s, ends):
    # A beam and the command that follows it are late by this much each.
    late = replace(PERFECT, rate_bps=1e8, latency_s=delay_s)
    assert SimulatedLap(settings("none", depth=1000, medium=late), 0).run().end in ends


def test_a_seed_gives_the_same_lap_also_in_pauses():
    paused, at_once = (SimulatedLap(settings("none", depth=1), 3) for _ in range(2))
    while not paused.drive(paused.time_s + 0.33):
        assert paused.verdict is None
    result, other = paused.result(), at_once.run()
    assert (result.ended_ns, result.outcome.counts) == (other.ended_ns, other.outcome.counts)


def test_snapshots_hold_what_the_lidars_measure_and_what_the_station_received():
    lap = SimulatedLap(settings("none", medium=PERFECT), 0, record=True)
    lap.drive(2.0)
    first, *_, before, last = lap.snapshots
    assert [first.manoeuvre, last.manoeuvre] == [Manoeuvre.STOP, Manoeuvre.FORWARD]
    assert np.isinf(first.believed_m).all()
    np.testing.assert_array_equal(last.believed_m, before.measured_m)
    assert last.poses[:, 0] - first.poses[:, 0] == pytest.approx(0.4, abs=0.05)

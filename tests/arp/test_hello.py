"""Flows of paper B's "Hello" and the cells of Table 2's grid."""

import numpy as np
import pytest

from sfglab.arp import hello
from sfglab.arp.robots import METHODS
from sfglab.errors import InvalidValueError
from sfglab.rtps import Medium, run


def cell(**changes):
    usual = {"rate_max_hz": 100, "depth": "10", "method": "none", "duration_s": 2.0}
    return hello.GridCell(**usual | changes)


def flows_of(given):
    return {flow.name: flow for flow in hello.scenario_of(given).flows}


def test_sixteen_sensors_and_hello_go_to_the_station_and_hello_comes_back():
    flows = flows_of(cell())
    assert flows["robot1/lidar"].size_bytes == 24  # of Table 1
    assert flows[hello.HELLO_UP].then == hello.HELLO_DOWN
    down = flows.pop(hello.HELLO_DOWN)
    assert (down.source, down.target, down.rate_hz) == (hello.STATION, "robot1", 0)
    assert [flow.target for flow in flows.values()] == [hello.STATION] * (16 + 1)


@pytest.mark.parametrize("name", METHODS)
def test_a_method_sets_rate_and_caches_of_sensors_and_nothing_else(name):
    method, flows = METHODS[name], flows_of(cell(method=name))
    assert not flows[hello.HELLO_UP].cached  # none repeats another
    rate_hz = hello.balance_of(100).rate_hz if method.optimised else 100
    expected = (method.local_cache, method.cache_control, rate_hz)
    for flow in flows.values():
        if flow.change_s:
            assert (flow.cached, flow.compare_s is not None, flow.rate_hz) == expected


def test_on_a_quiet_channel_hello_takes_two_hops_and_their_nodes_and_a_third_over_robot_3():
    quiet = Medium(loss=0.0, rate_bps=1e12, overhead_s=20e-6, contention=0.0)
    lowest = []
    for hop in (False, True):
        latency_ms = hello.hello_latency_ms(
            run(hello.scenario_of(cell(hop=hop), medium=quiet), seed=0)
        )
        assert len(latency_ms) == 200
        lowest.append(np.quantile(latency_ms, 0.1))
    assert lowest[0] == pytest.approx(2 * 0.02 + 0.18 + 0.06, abs=0.01)
    # A hop more, and its node besides the station's, which plans once less.
    assert lowest[1] - lowest[0] == pytest.approx(0.02 + 0.12 - 0.06, abs=0.01)


def test_a_hello_that_never_arrives_has_an_infinite_time():
    outcome = run(hello.scenario_of(cell(rate_max_hz=200)), seed=0)
    times_ms = hello.hello_times_ms(outcome)
    assert len(times_ms) == len(outcome.flows[hello.HELLO_UP].fate)
    assert 0 < np.isfinite(times_ms).sum() < len(times_ms)


def test_a_depth_that_is_none_is_refused():
    with pytest.raises(InvalidValueError, match="depth: given '0'"):
        cell(depth="0")

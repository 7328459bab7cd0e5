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


@pytest.mark.parametrize("name", ["none", "OPT+LC+CC"])
def test_sixteen_sensors_and_hello_go_to_the_station_and_caches_pass_every_hello(name):
    method = METHODS[name]
    *sensors, up, down = hello.scenario_of(cell(method=name)).flows
    assert [flow.target for flow in (*sensors, up)] == [hello.STATION] * (16 + 1)
    assert (up.then, down.source, down.target) == (down.name, hello.STATION, "robot1")
    rate_hz = hello.balance_of(100).rate_hz if method.optimised else 100
    expected = (rate_hz, method.local_cache, method.cache_control)
    for flow in sensors:
        assert (flow.rate_hz, flow.cached, flow.compare_s is not None) == expected
    assert not up.cached


@pytest.mark.parametrize(("hop", "nodes_ms"), [(False, 0.18 + 0.06), (True, 0.12 + 0.12 + 0.06)])
def test_on_a_quiet_channel_hello_takes_its_hops_and_their_nodes(hop, nodes_ms):
    """With the hop over robot 3 the station plans once less, and robot 3's node once more."""
    quiet = Medium(loss=0.0, rate_bps=1e12, overhead_s=20e-6, contention=0.0)
    outcome = run(hello.scenario_of(cell(hop=hop), medium=quiet), seed=0)
    latency_ms = hello.hello_latency_ms(outcome)
    assert len(latency_ms) == 200
    assert np.quantile(latency_ms, 0.1) == pytest.approx((2 + hop) * 0.02 + nodes_ms, abs=0.01)


def test_a_hello_that_never_arrives_has_an_infinite_time():
    outcome = run(hello.scenario_of(cell(rate_max_hz=200)), seed=0)
    times_ms = hello.hello_times_ms(outcome)
    assert len(times_ms) == len(outcome.flows[hello.HELLO_UP].fate)
    assert 0 < np.isfinite(times_ms).sum() < len(times_ms)


def test_a_depth_that_is_none_is_refused():
    with pytest.raises(InvalidValueError, match="depth: given '0'"):
        cell(depth="0")

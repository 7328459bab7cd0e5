"""The linter's estimates: discovery counted from the file, transforms and streams across the border."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from sfglab.fleet.fleet_file import read_fleet
from sfglab.fleet.lint import lint
from sfglab.fleet.lint.load import ENDPOINT_BYTES, PAIR_BYTES, ROS_ENDPOINTS, transform_bytes
from sfglab.messages import default_message, message_type, serialize


def fleet_of(count: int, inner: str = "", processes: int = 20):
    text = "".join(
        f"  pi{i}: {{domain: {i}, processes: {processes}, lifecycle: false, {inner}}}\n"
        for i in range(1, count + 1)
    )
    return lint(read_fleet(f"fleet: f\nagents:\n{text}"))


def test_with_one_domain_all_are_told_of_all_and_through_routers_only_what_is_wanted_across():
    standard = fleet_of(2).discovery.standard
    assert standard.participants == 40
    assert standard.endpoints == 40 * ROS_ENDPOINTS
    assert standard.pairs == 2 * 20 * 20
    assert standard.announced == 2 * 20 * (20 * ROS_ENDPOINTS)
    talk = "publishes: [/chatter, /global/shared/map], subscribes: [/chatter, /global/shared/map]"
    report = fleet_of(3, talk)
    assert report.discovery.shown == {"pi1": 2, "pi2": 2, "pi3": 2}
    assert report.discovery.routed.participants == 3
    assert report.discovery.routed.pairs == 6
    assert report.discovery.routed.announced == 3 * 2 * 2


def test_a_publisher_nobody_wants_is_not_shown_latched_ones_each_and_a_service_as_two_topics():
    lonely = fleet_of(2, "publishes: [/global/shared/map]")
    assert lonely.discovery.shown == {"pi1": 0, "pi2": 0}
    text = """
fleet: f
agents:
  a1:
    domain: 1
    lifecycle: false
    publishes: [{name: /tf_static, qos: latched, count: 3}, {name: /tf, count: 3}]
  a2: {domain: 2, lifecycle: false, subscribes: [{name: /tf_static, qos: latched}, /tf]}
"""
    shown = lint(read_fleet(text)).discovery.shown
    assert shown == {"a1": 3 + 1, "a2": 2}
    text = "fleet: f\nagents:\n  a1: {domain: 1, lifecycle: false, serves: [/global/a1/reset]}\n"
    text += "  a2: {domain: 2, lifecycle: false, calls: [/global/a1/reset]}\n"
    assert lint(read_fleet(text)).discovery.shown == {"a1": 2, "a2": 2}


def test_the_estimate_lies_among_what_was_measured_on_two_hosts():
    one = 400 * (PAIR_BYTES + 1 * ENDPOINT_BYTES)
    ros = 400 * (PAIR_BYTES + 18 * ENDPOINT_BYTES)
    router = PAIR_BYTES + 20 * ENDPOINT_BYTES
    assert 0.64e6 < one < 0.76e6  # 20 participants a host with one endpoint each
    assert 3.4e6 < ros < 4.2e6  # with 18 each, as a ROS node has
    assert 9_800 < router < 10_510  # routers that show 20 topics


@given(st.integers(2, 7), st.integers(1, 30))
def test_routers_cost_the_same_whatever_runs_inside(count, processes):
    few, many = fleet_of(count, processes=1), fleet_of(count, processes=processes)
    assert few.discovery.routed == many.discovery.routed
    grown = many.discovery.standard.pairs / few.discovery.standard.pairs
    assert grown == pytest.approx(processes**2)


@pytest.mark.parametrize(
    ("parent", "child"), [("map", "base"), ("go2/odom", "go2/base_link"), ("m", "camera_front_color_x")]
)
def test_the_size_of_a_transform_is_that_of_the_message(parent, child):
    stamped = default_message("geometry_msgs/msg/TransformStamped")
    stamped.header.frame_id, stamped.child_frame_id = parent, child
    message = message_type("tf2_msgs/msg/TFMessage")(transforms=[stamped])
    assert transform_bytes(parent, child) == len(serialize(message))


def test_everybody_receives_the_transforms_of_all_others_and_none_that_nobody_asks_for():
    inner = "subscribes: [/tf], tf: {shared_frames: [map], frames: [{child: base, parent: map, rate_hz: 50}]}"
    loads = fleet_of(4, inner).loads
    assert [load.tf_out_hz for load in loads] == [50.0] * 4
    assert [load.tf_in_hz for load in loads] == [150.0] * 4
    assert loads[0].tf_in_bps == pytest.approx(150 * 8 * transform_bytes("map", "pi1/base"))
    inner = "tf: {frames: [{child: base, parent: map, rate_hz: 50}]}"
    assert all(load.tf_out_hz == load.tf_in_hz == 0 for load in fleet_of(3, inner).loads)


def test_a_stream_counts_once_for_each_other_agent_and_unknown_sizes_are_named():
    text = """
fleet: f
agents:
  a1: {domain: 1, publishes: [{name: /global/a1/pose, rate_hz: 10, size_bytes: 100}, /global/a1/twist]}
  a2: {domain: 2, subscribes: [/global/a1/pose, /global/a1/twist]}
  a3: {domain: 3, subscribes: [/global/a1/pose]}
"""
    a1, a2, a3 = lint(read_fleet(text)).loads
    assert (a1.topics_out_bps, a2.topics_in_bps, a3.topics_in_bps) == (16_000, 8_000, 8_000)
    assert (a1.unsized, a2.unsized, a3.unsized) == (("/global/a1/twist",), ("/global/a1/twist",), ())

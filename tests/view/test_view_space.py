"""The frame in which a log's space is drawn, and what a cell with the log says."""

import json

import pytest

from sfglab.lab.explore.viewer import LogViewer
from sfglab.messages import default_message
from sfglab.record import LogReader, LogWriter
from sfglab.view.space import largest_tree


def written(file, *messages):
    """Write transforms, each of topic, edges and time in ms, into a log."""
    with LogWriter(file) as log:
        for topic, edges, at_ms in messages:
            message = default_message("tf2_msgs/msg/TFMessage")
            for parent, child in edges:
                one = default_message("geometry_msgs/msg/TransformStamped", child_frame_id=child)
                one.header.frame_id = parent
                message.transforms.append(one)
            log.write(topic, message, log_time_ns=at_ms * 10**6)
    return file


def tree_of(file):
    with LogReader(file) as log:
        return largest_tree(log)


@pytest.mark.parametrize(
    ("edges", "root"),
    [
        ("map-odom odom-base world-camera", "map"),
        ("a-b map-c", "map"),
        ("b-c a-d", "a"),
        ("/map-/odom odom-base", "map"),
        ("a-b b-a", "a"),
        ("", ""),
    ],
)
@pytest.mark.parametrize("topics", [("/tf", "/tf"), ("/tf_static", "/go2/tf")])
def test_space_is_drawn_in_the_root_of_the_largest_tree(edges, root, topics, tmp_path):
    pairs = [edge.split("-") for edge in edges.split()]
    messages = [
        (topics[0], pairs[:1], 1),
        (topics[1], pairs[1:], 1),
        ("/planned", [("x", "y"), ("y", "z"), ("z", "w")], 1),  # no topic that the viewer takes
    ]
    assert tree_of(written(tmp_path / "a.mcap", *messages)).root == root


@pytest.mark.parametrize(("last_ms", "first"), [(3, 3), (90, 0)])
def test_a_log_begins_where_the_tree_is_complete_unless_that_is_late(tmp_path, last_ms, first):
    messages = [("/tf", [("odom", "base")], step) for step in range(100)]
    file = written(tmp_path / "a.mcap", *messages, ("/tf", [("base", "laser")], last_ms))
    assert tree_of(file).complete_ns == last_ms * 10**6
    assert LogViewer(file).slider.value == first
    assert LogViewer(file, frame="base").slider.value == 0


def test_a_page_that_has_the_viewer_says_what_is_loaded_until_it_is_shown(tmp_path):
    pytest.importorskip("rerun_notebook", reason="the extra 'view' is not installed")
    messages = [("/tf", [("odom", "base")], step) for step in range(1200)]
    shown = LogViewer(written(tmp_path / "a.mcap", *messages))
    assert shown.said.value == "", "a page that only shows the still loads nothing"
    shown.viewer.widget._handle_custom_msg("ready", [])
    assert shown.said.value == "loading 1,200 messages"
    shown.viewer.widget._handle_custom_msg(json.dumps({"type": "time_update", "time": 0}), [])
    assert shown.said.value == "shown: step 0 of 1199, 0.000 s"

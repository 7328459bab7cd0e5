"""The frame in which a log's space is drawn, and files of users that are named by a string."""

import json

import pytest
from made_logs import DATA

from sfglab.arp.topics import load_topics
from sfglab.fleet.fleet_file import load_fleet
from sfglab.lab.claims import load_claims
from sfglab.lab.explore.viewer import LogViewer
from sfglab.messages import default_message
from sfglab.record import LogReader, LogWriter
from sfglab.soc.graph import load_graph
from sfglab.spatial.mocap.mapping import load_mapping
from sfglab.spatial.scene.files import load_scene
from sfglab.view.rerunning import blueprint, layout_of_topics
from sfglab.view.space import largest_tree

TREES = [
    ([("map", "odom"), ("odom", "base"), ("world", "camera")], "map"),
    ([("odom", "base"), ("base", "laser")], "odom"),
    ([("a", "b"), ("map", "c")], "map"),
    ([("b", "c"), ("a", "d")], "a"),
    ([("/map", "/odom"), ("odom", "base")], "map"),
    ([("a", "b"), ("b", "a")], "a"),
    ([], ""),
]


def transforms(edges):
    message = default_message("tf2_msgs/msg/TFMessage")
    for parent, child in edges:
        one = default_message("geometry_msgs/msg/TransformStamped", child_frame_id=child)
        one.header.frame_id = parent
        message.transforms.append(one)
    return message


def written(file, *messages):
    """Write transforms, each of topic, edges and time in ms, into a log."""
    with LogWriter(file) as log:
        for topic, edges, at_ms in messages:
            log.write(topic, transforms(edges), log_time_ns=at_ms * 10**6)
    return file


def tree_of(file):
    with LogReader(file) as log:
        return largest_tree(log)


@pytest.mark.parametrize(("edges", "root"), TREES)
@pytest.mark.parametrize("static", [0, 1, 2])
def test_space_is_drawn_in_the_root_of_the_largest_tree(edges, root, static, tmp_path):
    parts = [("/tf_static", edges[:static], 1), ("/tf", edges[static:], 1)]
    assert tree_of(written(tmp_path / "a.mcap", *parts)).root == root


def test_transforms_of_every_topic_that_the_viewer_takes_count(tmp_path):
    messages = [
        ("/tf", [("map", "a"), ("map", "b")], 1),
        ("/robot/tf", [("odom", "base"), ("base", "laser")], 1),
        ("/robot/tf_static", [("laser", "mirror")], 1),
        ("/planned", [("a", "c"), ("c", "d")], 1),
    ]
    assert tree_of(written(tmp_path / "a.mcap", *messages)).root == "odom"


@pytest.mark.parametrize(("last_ms", "first"), [(3, 3), (90, 0)])
def test_a_log_begins_where_the_tree_is_complete_unless_that_is_late(tmp_path, last_ms, first):
    messages = [("/tf", [("odom", "base")], step) for step in range(100)]
    messages.append(("/tf", [("base", "laser")], last_ms))
    file = written(tmp_path / "a.mcap", *messages)
    assert tree_of(file).complete_ns == last_ms * 10**6
    assert LogViewer(file).slider.value == first
    assert LogViewer(file, frame="base").slider.value == 0


def test_a_page_that_has_the_viewer_says_what_is_loaded_until_it_is_shown(tmp_path):
    pytest.importorskip("rerun_notebook", reason="the extra 'view' is not installed")
    messages = [("/tf", [("odom", "base")], step) for step in range(1200)]
    cell = LogViewer(written(tmp_path / "a.mcap", *messages))
    assert cell.said.value == "", "a page that only shows the still loads nothing"
    page = cell.viewer.widget
    page._handle_custom_msg("ready", [])
    assert cell.said.value == "loading 1,200 messages"
    page._handle_custom_msg(json.dumps({"type": "time_update", "time": 0}), [])
    assert cell.said.value == "shown: step 0 of 1199, 0.000 s"


def test_images_without_camera_info_have_no_place_in_space():
    image, info = "sensor_msgs/msg/CompressedImage", "sensor_msgs/msg/CameraInfo"
    topics = {
        "/front/image_raw/compressed": image,
        "/front/camera_info": info,
        "/mask/compressed": image,
    }
    layout = layout_of_topics(topics, frame="map")
    assert layout.flat == (layout.cameras["/mask/compressed"],)
    assert blueprint(layout) is not None


@pytest.mark.parametrize(
    ("load", "file"),
    [
        (load_graph, "graphs/figure_8.yaml"),
        (load_topics, "qos/paper_b.yaml"),
        (load_scene, "scenes/hall.yaml"),
        (load_mapping, "mocap/two_agents.yaml"),
        (load_fleet, "fleets/lab.yaml"),
        (load_claims, "claims.yaml"),
    ],
)
def test_a_file_is_named_by_a_string_or_a_path(load, file):
    assert load(str(DATA / file)) == load(DATA / file)

"""The frame in which a log's space is drawn, and files of users that are named by a string."""

import json

import pytest
from made_logs import DATA

from sfglab.arp.topics import load_topics
from sfglab.fleet.fleet_file import load_fleet
from sfglab.lab.claims import load_claims
from sfglab.lab.explore.viewer import LogViewer
from sfglab.messages import default_message
from sfglab.record import LogWriter
from sfglab.soc.graph import load_graph
from sfglab.spatial.mocap.mapping import load_mapping
from sfglab.spatial.scene.files import load_scene
from sfglab.view.rerunning import blueprint, layout_of_topics
from sfglab.view.space import largest_tree, largest_tree_root

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
        one = default_message("geometry_msgs/msg/TransformStamped")
        one.header.frame_id, one.child_frame_id = parent, child
        message.transforms.append(one)
    return message


@pytest.mark.parametrize(("edges", "root"), TREES)
@pytest.mark.parametrize("static", [0, 1, 2])
def test_space_is_drawn_in_the_root_of_the_largest_tree(edges, root, static, tmp_path):
    with LogWriter(tmp_path / "a.mcap") as log:
        for topic, part in (("/tf_static", edges[:static]), ("/tf", edges[static:])):
            if part:
                log.write(topic, transforms(part), log_time_ns=1)
    assert largest_tree_root(tmp_path / "a.mcap") == root


def test_a_log_begins_where_the_tree_is_complete_unless_that_is_late(tmp_path):
    for last_ms, first in ((3, 3), (90, 0)):
        file = tmp_path / f"{last_ms}.mcap"
        with LogWriter(file) as log:
            for step in range(100):
                edges = [("odom", "base")]
                if step >= last_ms:
                    edges.append(("base", "laser"))
                log.write("/tf", transforms(edges), log_time_ns=step * 10**6)
        assert largest_tree(file).complete_ns == last_ms * 10**6
        assert LogViewer(file).slider.value == first
        assert LogViewer(file, frame="base").slider.value == 0


def test_transforms_of_every_topic_that_the_viewer_takes_count(tmp_path):
    with LogWriter(tmp_path / "a.mcap") as log:
        log.write("/tf", transforms([("map", "a"), ("map", "b")]), log_time_ns=1)
        log.write("/robot/tf", transforms([("odom", "base"), ("base", "laser")]), log_time_ns=1)
        log.write("/robot/tf_static", transforms([("laser", "mirror")]), log_time_ns=1)
        log.write("/planned", transforms([("a", "c"), ("c", "d")]), log_time_ns=1)
    assert largest_tree_root(tmp_path / "a.mcap") == "odom"


def test_a_page_that_has_the_viewer_says_what_is_loaded_until_it_is_shown(tmp_path):
    pytest.importorskip("rerun_notebook", reason="the extra 'view' is not installed")
    with LogWriter(tmp_path / "a.mcap") as log:
        for step in range(1200):
            log.write("/tf", transforms([("odom", "base")]), log_time_ns=step * 10**6)
    cell = LogViewer(tmp_path / "a.mcap")
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

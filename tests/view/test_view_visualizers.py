"""What each visualizer draws, on paper and in real recordings that are read back."""

from contextlib import closing
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest
from foreign_video import CLOCKS, COUNT, avcc, clocked, ffmpeg_packet
from foreign_video import packets as foreign_packets
from seen import cloud, heartbeat

from sfglab.codecs import (
    TABLE_2,
    CodecError,
    compressed_depth_fields,
    compressed_image_fields,
    ffmpeg_packet_fields,
)
from sfglab.codecs.h264 import H264Encoder
from sfglab.codecs.libav import has_key_frame
from sfglab.errors import InvalidValueError, SfglabError
from sfglab.fleet.status.heartbeat import Phase
from sfglab.lab.experiments.visualisation.recordings import read_recording
from sfglab.lab.experiments.visualisation.scene import camera_info
from sfglab.messages import default_message, message_type, stamp_from_ns
from sfglab.spatial import Pose
from sfglab.spatial.poses import header_msg
from sfglab.view.arrivals import Arrival
from sfglab.view.rerunning import open_canvas
from sfglab.view.session import BUILT_IN, Session, find
from sfglab.view.stage import replay
from sfglab.view.sync import PATIENCE
from sfglab.view.visualizer import NotShownError
from sfglab.view.visualizers.images import image_plane

rr = pytest.importorskip("rerun", reason="the extra 'view' is not installed")
S = 1_000_000_000


def made(kind, topics=None, **settings):
    cls = find(kind)
    return cls(
        topics or {given.role: f"/{given.role}" for given in cls.inputs if not given.optional},
        settings,
    )


def values(drawn, component):
    """The values of one component of what was drawn, as plain lists."""
    for what in drawn.what:
        for batch in what.as_component_batches():
            if str(batch.component_descriptor()).split(":")[-1].split("#")[0] == component:
                return batch.as_arrow_array().to_pylist()
    raise AssertionError(component)


def coded(fields, type_name="sensor_msgs/msg/CompressedImage"):
    return default_message(
        type_name, format=fields.format, data=np.frombuffer(fields.data, np.uint8)
    )


def moved(parent, child, stamp_ns=0, x=0.0):
    header = header_msg(parent, stamp_ns)
    transform = default_message(
        "geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child
    )
    transform.transform.translation.x = x
    return transform  # its quaternion of all zeros is no rotation


def test_names_are_unique():
    assert len({kind.name for kind in BUILT_IN}) == len(BUILT_IN)


@pytest.mark.parametrize(
    ("encoding", "pixel", "kind", "color_model"),
    [
        ("rgb8", np.zeros(3, np.uint8), "Image", rr.ColorModel.RGB.value),
        ("bgr8", np.zeros(3, np.uint8), "Image", rr.ColorModel.BGR.value),
        ("mono8", np.uint8(1), "Image", rr.ColorModel.L.value),
        ("16UC1", np.uint16(1), "DepthImage", None),
        ("32FC1", np.float32(1), "DepthImage", None),
    ],
)
def test_an_image_is_drawn_by_its_encoding_in_its_cameras_plane(
    paper, update, make_image, encoding, pixel, kind, color_model
):
    array = np.full((4, 6, *pixel.shape), pixel)
    made("image").show(update(image=make_image(array, encoding, frame="go2/camera")), paper)
    assert paper.kinds("/image") == [kind]
    assert paper.frames == {"/image": "go2/camera/image_plane"}
    (image_format,) = values(paper.drawn[0], "format")
    assert image_format["color_model"] == color_model


@pytest.mark.parametrize("codec", ["jpeg", "png"])
def test_a_still_picture_goes_to_the_viewer_as_it_is(paper, update, codec):
    fields = compressed_image_fields(np.full((4, 6, 3), 90, np.uint8), codec)
    made("compressed_image").show(update(image=coded(fields)), paper)
    assert values(paper.drawn[0], "media_type") == [f"image/{codec}"]
    assert bytes(values(paper.drawn[0], "blob")[0]) == fields.data


@pytest.mark.parametrize("codec", ["rvl", "png"])
@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_compressed_depth_is_decoded_to_metres(paper, update, codec, dtype):
    depth = np.full((8, 8), 2000 if dtype == np.uint16 else 2.0, dtype)
    made("compressed_image").show(update(image=coded(compressed_depth_fields(depth, codec))), paper)
    assert paper.kinds("/image") == ["DepthImage"]
    per_metre = values(paper.drawn[0], "meter")[0]
    stored = np.frombuffer(bytes(values(paper.drawn[0], "buffer")[0]), dtype)
    assert np.allclose(stored / per_metre, 2.0, atol=0.01)


def test_an_unknown_picture_format_is_said(paper, update):
    message = default_message("sensor_msgs/msg/CompressedImage", format="tiff")
    with pytest.raises(InvalidValueError, match="compressed image format: given 'tiff'"):
        made("compressed_image").show(update(image=message), paper)


def packets(count=8):
    settings = replace(TABLE_2, encoder="libx264", width=128, height=64, gop=4)
    encoder = H264Encoder(settings)
    return settings, [
        f for i in range(count) for f in encoder.encode(np.full((64, 128, 3), 20 * i, np.uint8))
    ]


def ffmpeg_message(frame, settings):
    fields = asdict(ffmpeg_packet_fields(frame, settings))
    fields["data"] = np.frombuffer(fields["data"], np.uint8)
    header = header_msg("camera", frame.pts * S)
    return message_type("ffmpeg_image_transport_msgs/msg/FFMPEGPacket")(header=header, **fields)


def complaints(visualizer, shown, paper) -> list[str]:
    """Show one update, and return why it cannot be shown, if it cannot."""
    try:
        visualizer.show(shown, paper)
    except CodecError as error:
        return [str(error)]
    return []


@pytest.mark.parametrize("clock", CLOCKS)
def test_packets_with_a_time_instead_of_a_number_are_all_shown(paper, update, clock):
    visualizer = made("ffmpeg_video")
    for message in clocked(clock):
        visualizer.show(update(video=message), paper)
    assert len([d for d in paper.drawn if not d.static]) == COUNT


def test_video_that_cannot_be_shown_is_refused_with_its_cause(paper, update):
    b_frames = [ffmpeg_packet(packet) for packet in foreign_packets(12, b_frames=2)]
    no_key = [ffmpeg_packet(packet) for packet in foreign_packets()[1:5]]
    lengths = [avcc(packet) for packet in foreign_packets()]
    cases = (
        ("ffmpeg_video", b_frames, "B frames, which are not supported", 1),
        ("ffmpeg_video", no_key, "no key frame since the start", 0),
        ("compressed_video", lengths, "AVCC is not supported", 0),
    )
    for kind, messages, reason, shown in cases:
        visualizer, paper.drawn = made(kind), []
        refused = []
        for message in messages:
            refused += complaints(visualizer, update(video=message), paper)
        assert len(refused) == len(messages) - shown
        assert reason in refused[-1]
        assert len([d for d in paper.drawn if not d.static]) == shown


def test_after_a_lost_packet_nothing_is_shown_until_the_next_key_frame(paper, update):
    settings, frames = packets()
    visualizer = made("ffmpeg_video")
    refused = []
    for frame in frames:
        if frame.pts != 1:
            refused += complaints(visualizer, update(video=ffmpeg_message(frame, settings)), paper)
    assert ["no key frame since" in reason for reason in refused] == [True] * 2
    shown = [d for d in paper.drawn if not d.static]
    assert [frame.is_key for frame in frames] == [True, False, False, False] * 2
    assert len(shown) == 1 + 4


def test_foxglove_video_starts_with_a_key_frame_and_waits_for_one_after_a_drop(paper, update):
    _, frames = packets()
    visualizer, refused = made("compressed_video"), []
    for frame in frames[1:]:  # begins in the middle of a group
        message = coded(
            SimpleNamespace(format="h264", data=frame.data), "foxglove_msgs/msg/CompressedVideo"
        )
        lost = 1 if frame.pts == 6 else 0
        refused += complaints(visualizer, update(video=message, lost=lost), paper)
    assert len(refused) == 3 + 2
    assert len([d for d in paper.drawn if not d.static]) == 2  # frames 4 and 5
    assert [has_key_frame(f.data, "h264") for f in frames] == [f.is_key for f in frames]


def test_h264_in_a_compressed_image_is_video_and_nothing_else_is(paper, update):
    _, (frame,) = packets(count=1)
    message = coded(SimpleNamespace(format="h264", data=frame.data))
    with pytest.raises(NotShownError, match="shown by compressed_image_video"):
        made("compressed_image").show(update(image=message), paper)
    assert paper.drawn == []
    made("compressed_image_video").show(update(video=message), paper)
    assert paper.kinds("/video") == ["VideoStream", "VideoStream"]
    message.format = "jpeg"
    with pytest.raises(NotShownError, match=r"shown by compressed_image$"):
        made("compressed_image_video").show(update(video=message), paper)
    assert len(paper.drawn) == 2


CAMERA_INFO = camera_info(header_msg("camera", 0), (6, 4))


def test_a_camera_hangs_its_image_plane_below_its_frame(paper, update):
    made("camera_info").show(update(info=CAMERA_INFO), paper)
    (drawn,) = paper.drawn
    assert values(drawn, "parent_frame") == ["camera"]
    assert values(drawn, "child_frame") == ["camera/image_plane"]
    assert values(drawn, "resolution") == [[6.0, 4.0]]


@pytest.mark.parametrize(
    ("name", "picture"),
    [
        ("/global/go2/camera_front/color", "/global/go2/camera_front/color/ffmpeg"),
        ("/local/go2/camera_front/color", "/local/go2/camera_front/color/image_raw"),
        ("/camera", "/camera/image_raw"),
        ("/camera", "/camera/image_raw/compressed"),
    ],
)
def test_a_picture_lies_in_the_plane_of_its_own_camera_info(name, picture):
    plane = image_plane("go2/camera", picture)
    assert plane == image_plane("go2/camera", f"{name}/camera_info")
    assert plane != image_plane("go2/camera", "/global/go2/camera_front/aligned_depth/camera_info")


def test_points_take_the_colours_of_a_registered_picture(paper, update, make_image):
    picture = np.zeros((4, 6, 3), np.uint8)
    picture[..., 0] = 200  # blue, in bgr8
    topics = {"depth": "/depth", "info": "/info", "color": "/color"}
    depth, color = (
        make_image(np.full((4, 6), 1.0, np.float32), "32FC1"),
        make_image(picture, "bgr8"),
    )
    shown = update(depth=depth, info=CAMERA_INFO, color=color)
    made("depth_cloud", topics, decimation=1).show(shown, paper)
    assert set(values(paper.at_entity("/depth/cloud")[0], "colors")) == {0x0000C8FF}
    assert paper.frames["/depth/cloud"] == "camera"


def test_transforms_stand_at_their_frames_with_their_own_times(tmp_path, update):
    path, message = tmp_path / "tf.rrd", default_message("tf2_msgs/msg/TFMessage")
    for number, (parent, child) in enumerate(
        [("map", "go2/base"), ("go2/base", "go2/camera")], start=1
    ):
        message.transforms.append(moved(parent, child, number * S, float(number)))
    with closing(open_canvas([str(path)])) as canvas:
        canvas.at(stamp_ns=9, received_ns=9)
        made("tf").show(update(tf=message, received_ns=77), canvas)
    shown = read_recording(path)
    wanted = {"translation": [2, 0, 0], "quaternion": [0, 0, 0, 1]}
    wanted |= {"parent_frame": ["go2/base"], "child_frame": ["go2/camera"]}
    for component, content in wanted.items():
        (one,) = shown["/tf/go2/camera", f"Transform3D:{component}"]
        assert (list(one.content), one.capture_ns, one.received_ns) == (content, 2 * S, 77)


def test_a_frame_that_is_sent_often_does_not_silence_another(paper, update):
    visualizer = made("tf", frame_hz=10, axis_length_m=0.0)
    for step in range(100):
        message = default_message("tf2_msgs/msg/TFMessage")
        for child in ["often"] + ["seldom"] * (step == 50):
            message.transforms.append(moved("map", child, S + step * S // 100))
        visualizer.show(update(tf=message), paper)
    assert len(paper.at_entity("/tf/often")) in (10, 11)  # in one second, begun at once
    assert len(paper.at_entity("/tf/seldom")) == 1


def test_a_static_transform_holds_for_all_times(paper, update):
    message = default_message("tf2_msgs/msg/TFMessage", transforms=[moved("", "imu")])
    made("tf_static").show(update(tf=message), paper)
    assert [d.static for d in paper.at_entity("/tf/imu")] == [True, True]
    assert paper.kinds("/tf/imu") == ["Transform3D", "TransformAxes3D"]


def test_a_pose_is_its_three_axes(paper, update):
    message = default_message("geometry_msgs/msg/PoseStamped")
    message.pose = Pose.at((1, 2, 3), (0, 0, 1, 1)).to_pose_msg()  # 90 degrees about z
    made("pose", axis_length_m=2.0).show(update(pose=message), paper)
    assert np.allclose(
        values(paper.drawn[0], "vectors"), [[0, 2, 0], [-2, 0, 0], [0, 0, 2]], atol=1e-6
    )
    assert np.allclose(values(paper.drawn[0], "origins"), [[1, 2, 3]] * 3)
    message.pose.position.x = float("nan")
    with pytest.raises(InvalidValueError, match="pose: given"):
        made("pose").show(update(pose=message), paper)


def test_a_path_is_a_line_and_an_empty_one_none(paper, update):
    message = default_message("nav_msgs/msg/Path")
    made("path").show(update(path=message), paper)
    for x in range(3):
        stamped = default_message("geometry_msgs/msg/PoseStamped")
        stamped.pose.position.x = float(x)
        message.poses.append(stamped)
    made("path").show(update(path=message), paper)
    lines = [values(d, "strips") for d in paper.drawn]
    assert lines == [[], [[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [2.0, 0.0, 0.0]]]]


def test_odometry_is_the_axes_of_its_pose(paper, update):
    message = default_message("nav_msgs/msg/Odometry", header=header_msg("odom", 0))
    message.pose.pose = Pose.at((1.0, 2.0, 0.0)).to_pose_msg()
    made("odometry", axis_length_m=2.0).show(update(odometry=message), paper)
    (drawn,) = paper.at_entity("/odometry")
    assert values(drawn, "origins") == [[1.0, 2.0, 0.0]] * 3
    assert np.allclose(values(drawn, "vectors"), 2.0 * np.eye(3))
    assert paper.frames["/odometry"] == "odom"


def marker(type_, id_=0, *, points=(), scale=(1.0, 1.0, 1.0), lifetime_ns=0, action=0):
    message = default_message(
        "visualization_msgs/msg/Marker", header=header_msg("map", 0), ns="walls", id=id_
    )
    message.type, message.action, message.text = type_, action, "hello"
    message.scale.x, message.scale.y, message.scale.z = scale
    message.color.a = 1.0
    message.lifetime = stamp_from_ns(lifetime_ns)
    message.pose = Pose.at((1, 0, 0), (0, 0, 1, 1)).to_pose_msg()
    message.points = [message_type("geometry_msgs/msg/Point")(x=x, y=y, z=z) for x, y, z in points]
    return message


TRIANGLE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]


@pytest.mark.parametrize(
    ("type_", "points", "kind"),
    [
        *((0, (), "Arrows3D"), (0, TRIANGLE[:2], "Arrows3D")),
        *((1, (), "Boxes3D"), (2, (), "Ellipsoids3D"), (3, (), "Cylinders3D")),
        *(
            (4, (), "LineStrips3D"),
            (4, TRIANGLE, "LineStrips3D"),
            (5, TRIANGLE[:2] * 2, "LineStrips3D"),
        ),
        *((6, (), "Boxes3D"), (6, TRIANGLE, "Boxes3D"), (7, TRIANGLE, "Ellipsoids3D")),
        *(
            (8, (), "Points3D"),
            (8, TRIANGLE, "Points3D"),
            (9, (), "Points3D"),
            (11, TRIANGLE, "Mesh3D"),
        ),
    ],
)
def test_every_common_marker_is_drawn(paper, update, type_, points, kind):
    made("marker").show(update(marker=marker(type_, points=points)), paper)
    assert paper.kinds("/marker/walls/0") == [kind]
    assert paper.frames["/marker/walls/0"] == "map"


def test_a_markers_points_are_moved_by_its_pose_and_a_triangles_scaled_before(paper, update):
    made("marker").show(update(marker=marker(8, points=TRIANGLE)), paper)
    made("marker").show(update(marker=marker(11, 1, points=TRIANGLE, scale=(2.0, 1.0, 1.0))), paper)
    assert np.allclose(
        values(paper.drawn[0], "positions"), [[1, 0, 0], [1, 1, 0], [0, 0, 0]], atol=1e-6
    )
    assert np.allclose(
        values(paper.drawn[1], "vertex_positions"), [[1, 0, 0], [1, 2, 0], [0, 0, 0]], atol=1e-6
    )


def test_markers_go_when_they_are_told_to_and_when_their_time_is_over(paper, update):
    visualizer = made("marker")
    visualizer.show(update(marker=marker(1, 1, lifetime_ns=S), received_ns=10 * S), paper)
    visualizer.show(update(marker=marker(1, 2), received_ns=10 * S), paper)
    visualizer.show(update(marker=marker(1, 3), received_ns=10 * S), paper)
    visualizer.tick(10 * S + S - 1, paper)
    assert "Clear" not in paper.kinds("/marker/walls/1")
    visualizer.tick(11 * S, paper)
    assert paper.kinds("/marker/walls/1") == ["Boxes3D", "Clear"]
    visualizer.show(update(marker=marker(1, 2, action=2)), paper)
    assert paper.kinds("/marker/walls/2") == ["Boxes3D", "Clear"]
    visualizer.show(update(marker=marker(1, 9, action=3)), paper)
    assert paper.kinds("/marker/walls/3") == ["Boxes3D", "Clear"]
    visualizer.show(update(marker=marker(2, 2)), paper)
    visualizer.show(update(marker=marker(1, 2)), paper)
    assert paper.kinds("/marker/walls/2")[2:] == ["Ellipsoids3D", "Clear", "Boxes3D"]


def test_a_flood_of_markers_pushes_the_oldest_out(paper, update):
    visualizer = made("marker", most=3)
    for number in range(10):
        visualizer.show(update(marker=marker(1, number)), paper)
    cleared = [d.entity for d in paper.drawn if type(d.what[0]).__name__ == "Clear"]
    assert cleared == [f"/marker/walls/{n}" for n in range(7)]


def test_one_bad_marker_does_not_keep_the_others_of_its_array_back(paper, update):
    markers = [marker(1, 1), marker(10, 2), marker(1, 3)]
    array = default_message("visualization_msgs/msg/MarkerArray", markers=markers)
    with pytest.raises(
        InvalidValueError, match=r"marker type: given 10, .*; meshes are not loaded"
    ):
        made("marker_array").show(update(markers=array), paper)
    assert set(paper.frames) == {"/markers/walls/1", "/markers/walls/3"}


def ages(paper, agent):
    drawn = paper.at_entity(f"/agents/{agent}/heartbeat/age_s")
    return [values(one, "scalars")[0] for one in drawn]


def lives(paper, agent):
    drawn = paper.at_entity(f"/agents/{agent}/heartbeat/life")
    return [values(one, "state")[0] for one in drawn if not one.static]


def test_an_agent_lives_by_the_age_of_its_last_heartbeat_and_only_changes_are_drawn(paper, update):
    visualizer = made("agent_heartbeats")
    first = heartbeat("go2", period_s=2.0, phase=Phase.STARTUP)
    visualizer.show(update(heartbeats=first, received_ns=0), paper)
    moments_s = [0.0, 2.9, 3.1, 5.9, 6.1]
    for now_s in moments_s:
        visualizer.tick(round(now_s * S), paper)
    assert ages(paper, "go2") == moments_s
    assert lives(paper, "go2") == ["starting", "late", "lost"]
    visualizer.show(update(heartbeats=heartbeat("go2"), received_ns=7 * S), paper)
    visualizer.tick(7 * S, paper)
    assert lives(paper, "go2") == ["starting", "late", "lost", "alive"]


@pytest.mark.parametrize(
    ("given", "told"),
    [
        ({"agent": "../../etc"}, "agent"),
        ({"agent": ""}, "agent"),
        ({"agent": "go2", "period_s": 0.0}, "period_s: given 0"),
    ],
)
def test_a_heartbeat_of_no_agent_or_without_a_period_is_refused(paper, update, given, told):
    visualizer = made("agent_heartbeats")
    with pytest.raises(SfglabError, match=told):
        visualizer.show(update(heartbeats=heartbeat(**given)), paper)
    visualizer.tick(S, paper)
    assert paper.drawn == []


def test_a_flood_of_agents_is_refused(paper, update):
    visualizer = made("agent_heartbeats")
    for number in range(256):
        visualizer.show(update(heartbeats=heartbeat(f"agent{number}")), paper)
    with pytest.raises(InvalidValueError, match="256 agents at most"):
        visualizer.show(update(heartbeats=heartbeat("another")), paper)


def test_an_agents_status_is_told_with_its_description(paper, update):
    sensor = default_message("sfglab_interfaces/msg/SensorInfo", name="camera_front")
    metadata = default_message("sfglab_interfaces/msg/AgentMetadata", agent="go2", sensors=[sensor])
    event = default_message(
        "sfglab_interfaces/msg/AgentDiscoveryEvent", agent="go2", metadata=metadata
    )
    visualizer = made("agent_status")
    visualizer.show(update(events=event), paper)
    event.event = event.LOST
    visualizer.show(update(events=event), paper)
    told = [values(d, "text") for d in paper.at_entity("/agents/go2/status/log")]
    assert told == [["go2 discovered"], ["go2 lost"]]
    assert [values(d, "state") for d in paper.at_entity("/agents/go2/status")] == [
        ["there"],
        ["lost"],
    ]
    assert "camera_front" in values(paper.at_entity("/agents/go2/status/description")[0], "text")[0]
    event.event = 77
    with pytest.raises(InvalidValueError, match="discovery event: given 77"):
        visualizer.show(update(events=event), paper)


def test_clouds_and_scans_are_coloured_points_in_their_frame(paper, update):
    scan = default_message("sensor_msgs/msg/LaserScan")
    scan.ranges, scan.range_max, scan.header.frame_id = (
        np.array([1.0, 2.0], np.float32),
        5.0,
        "laser",
    )
    made("laser_scan").show(update(scan=scan), paper)
    records = np.zeros(10, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
    records["x"] = range(10)
    made("point_cloud", decimation=3).show(update(cloud=cloud(records)), paper)
    assert paper.frames == {"/scan": "laser"}
    assert [p[0] for p in values(paper.at_entity("/cloud")[0], "positions")] == [0.0, 3.0, 6.0, 9.0]
    with pytest.raises(
        InvalidValueError, match=r"color_by: given 'ring', .* fields x, y, z, intensity"
    ):
        made("point_cloud", color_by="ring").show(update(cloud=cloud(records)), paper)


def test_the_calibration_of_another_camera_or_size_is_refused(paper, update, make_image):
    depth = make_image(np.full((4, 6), 1.0, np.float32), "32FC1")
    with pytest.raises(
        InvalidValueError, match="camera info, size: given '12 x 8', allowed: 6 x 4"
    ):
        made("depth_cloud").show(
            update(depth=depth, info=camera_info(CAMERA_INFO.header, (12, 8))), paper
        )
    other = make_image(np.full((4, 6), 1.0, np.float32), "32FC1", frame="rear")
    with pytest.raises(
        InvalidValueError, match="camera info, frame: given 'camera', allowed: 'rear'"
    ):
        made("depth_cloud").show(update(depth=other, info=CAMERA_INFO), paper)
    assert paper.drawn == []


def test_depth_whose_camera_was_described_once_before_the_view_began_becomes_points(
    paper, make_image
):
    """Live, the late joiner is sent it again: the camera info is asked for with the past."""
    session = Session()
    display = session.add("depth_cloud", {"depth": "/depth", "info": "/info"})
    assert all(
        q.durability.value == "transient_local" for i, _, q in display.inputs if i.role == "info"
    )
    info = Arrival("/info", "sensor_msgs/msg/CameraInfo", 0, b"", CAMERA_INFO)
    flat = np.full((4, 6), 1.0, np.float32)
    depths = [make_image(flat, "32FC1", stamp_ns=number * S) for number in range(1, 21)]
    arrivals = [
        Arrival("/depth", "sensor_msgs/msg/Image", n * S, b"", d) for n, d in enumerate(depths)
    ]
    replay([info, *arrivals], session, paper)
    assert display.slot.counts.shown == 20 - PATIENCE
    assert display.errors == 0


def test_what_cannot_be_drawn_is_not_counted_as_shown(paper):
    session = Session()
    display = session.add("ffmpeg_video", "/video")
    type_ = display.inputs[0][0].type
    messages = [ffmpeg_packet(packet) for packet in foreign_packets()]
    arrivals = [Arrival("/video", type_, n * S, b"", one) for n, one in enumerate(messages[1:])]
    replay(arrivals, session, paper)
    counts = display.slot.counts
    assert display.errors > 0
    assert counts.received == counts.shown + counts.dropped + display.errors
    assert counts.shown == len([d for d in paper.drawn if not d.static])

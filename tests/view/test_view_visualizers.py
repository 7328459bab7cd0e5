"""What each visualizer draws, on paper and in a real recording that is read back."""

from contextlib import closing
from dataclasses import asdict, replace
from types import SimpleNamespace

import numpy as np
import pytest
from foreign_video import CLOCKS, COUNT, avcc, clocked, ffmpeg_packet
from foreign_video import packets as foreign_packets
from seen import BEAT, cloud, heartbeat, read_recording

from sfglab.codecs import (
    TABLE_2,
    CodecError,
    compressed_depth_fields,
    compressed_image_fields,
    ffmpeg_packet_fields,
)
from sfglab.codecs.h264 import H264Encoder
from sfglab.errors import SfglabError
from sfglab.fleet.status.heartbeat import Phase
from sfglab.lab.experiments.visualisation.points import camera_info
from sfglab.messages import default_message, message_type, stamp_from_ns
from sfglab.spatial import Pose
from sfglab.spatial.poses import header_msg
from sfglab.view.arrivals import Arrival
from sfglab.view.rerunning import open_canvas
from sfglab.view.session import BUILT_IN, Session
from sfglab.view.stage import replay
from sfglab.view.sync import PATIENCE
from sfglab.view.visualizer import NotShownError, Update
from sfglab.view.visualizers.images import image_plane

rr = pytest.importorskip("rerun", reason="the extra 'view' is not installed")
S = 1_000_000_000
KINDS = {kind.name: kind for kind in BUILT_IN}
CAMERA_INFO = camera_info(header_msg("camera", 0), (6, 4))
MARKER = "visualization_msgs/msg/Marker"
TF = "tf2_msgs/msg/TFMessage"


def made(kind, topics=None, **settings):
    needed = [given.role for given in KINDS[kind].inputs if not given.optional]
    return KINDS[kind](topics or {role: f"/{role}" for role in needed}, settings)


def update(received_ns=2_000, lost=0, **messages):
    return Update(messages=messages, stamp_ns=1_000, received_ns=received_ns, lost=lost)


def coded(fields, type_name="sensor_msgs/msg/CompressedImage"):
    data = np.frombuffer(fields.data, np.uint8)
    return default_message(type_name, format=fields.format, data=data)


def transforms(*moved):
    """A message of transforms, each from parent, child, stamp and x; a quaternion of all zeros is no rotation."""
    message = default_message(TF)
    for parent, child, stamp_ns, x in moved:
        one = default_message("geometry_msgs/msg/TransformStamped", child_frame_id=child)
        one.header = header_msg(parent, stamp_ns)
        one.transform.translation.x = x
        message.transforms.append(one)
    return message


def test_names_are_unique():
    assert len(KINDS) == len(BUILT_IN)


# --- Pictures -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("encoding", "pixel", "kind", "model"),
    [
        ("rgb8", "3u1", "Image", rr.ColorModel.RGB.value),
        ("bgr8", "3u1", "Image", rr.ColorModel.BGR.value),
        ("mono8", "u1", "Image", rr.ColorModel.L.value),
        ("16UC1", "u2", "DepthImage", None),
        ("32FC1", "f4", "DepthImage", None),
    ],
)
def test_an_image_is_drawn_by_its_encoding_in_its_cameras_plane(
    paper, make_image, encoding, pixel, kind, model
):
    message = make_image(np.zeros((4, 6), pixel), encoding, frame="go2/camera")
    made("image").show(update(image=message), paper)
    assert paper.kinds("/image") == [kind]
    assert paper.frames == {"/image": "go2/camera/image_plane"}
    assert paper.values("/image", "format")[0][0]["color_model"] == model


@pytest.mark.parametrize("codec", ["jpeg", "png"])
def test_a_still_picture_goes_to_the_viewer_as_it_is(paper, codec):
    fields = compressed_image_fields(np.full((4, 6, 3), 90, np.uint8), codec)
    made("compressed_image").show(update(image=coded(fields)), paper)
    assert paper.values("/image", "media_type") == [[f"image/{codec}"]]
    assert bytes(paper.values("/image", "blob")[0][0]) == fields.data


@pytest.mark.parametrize("codec", ["rvl", "png"])
@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_compressed_depth_is_decoded_to_metres(paper, codec, dtype):
    depth = np.full((8, 8), 2000 if dtype == np.uint16 else 2.0, dtype)
    made("compressed_image").show(update(image=coded(compressed_depth_fields(depth, codec))), paper)
    [[per_metre]] = paper.values("/image", "meter")
    stored = np.frombuffer(bytes(paper.values("/image", "buffer")[0][0]), dtype)
    assert np.allclose(stored / per_metre, 2.0, atol=0.01)


def packets(count=8):
    settings = replace(TABLE_2, encoder="libx264", width=128, height=64, gop=4)
    encoder = H264Encoder(settings)
    pictures = [np.full((64, 128, 3), 20 * i, np.uint8) for i in range(count)]
    return settings, [frame for picture in pictures for frame in encoder.encode(picture)]


def ffmpeg_message(frame, settings):
    fields = asdict(ffmpeg_packet_fields(frame, settings))
    fields["data"] = np.frombuffer(fields["data"], np.uint8)
    header = header_msg("camera", frame.pts * S)
    return message_type("ffmpeg_image_transport_msgs/msg/FFMPEGPacket")(header=header, **fields)


def refused(visualizer, updates, paper) -> list[str]:
    """Show updates, and return why each that cannot be shown cannot."""
    reasons = []
    for shown in updates:
        try:
            visualizer.show(shown, paper)
        except CodecError as error:
            reasons.append(str(error))
    return reasons


@pytest.mark.parametrize("clock", CLOCKS)
def test_packets_with_a_time_instead_of_a_number_are_all_shown(paper, clock):
    updates = [update(video=message) for message in clocked(clock)]
    assert refused(made("ffmpeg_video"), updates, paper) == []
    assert len(paper.values("/video", "sample")) == COUNT


@pytest.mark.parametrize(
    ("kind", "messages", "reason", "shown"),
    [
        (
            "ffmpeg_video",
            lambda: [ffmpeg_packet(packet) for packet in foreign_packets(12, b_frames=2)],
            "B frames, which are not supported",
            1,
        ),
        (
            "ffmpeg_video",
            lambda: [ffmpeg_packet(packet) for packet in foreign_packets()[1:5]],
            "no key frame since the start",
            0,
        ),
        (
            "compressed_video",
            lambda: [avcc(packet) for packet in foreign_packets()],
            "AVCC is not supported",
            0,
        ),
    ],
)
def test_video_that_cannot_be_shown_is_refused_with_its_cause(paper, kind, messages, reason, shown):
    updates = [update(video=message) for message in messages()]
    reasons = refused(made(kind), updates, paper)
    assert (
        len(reasons) == len(updates) - shown == len(updates) - len(paper.values("/video", "sample"))
    )
    assert reason in reasons[-1]


def test_after_a_lost_packet_nothing_is_shown_until_the_next_key_frame(paper):
    """In two groups of four pictures the second is lost: the third and fourth refer to it."""
    settings, frames = packets()
    messages = [ffmpeg_message(frame, settings) for frame in frames if frame.pts != 1]
    reasons = refused(made("ffmpeg_video"), [update(video=one) for one in messages], paper)
    assert ["no key frame since" in reason for reason in reasons] == [True] * 2
    assert paper.values("/video", "is_keyframe") == [[True]] * 2 + [[False]] * 3


def test_foxglove_video_starts_with_a_key_frame_and_waits_for_one_after_a_drop(paper):
    _, frames = packets()
    updates = []
    for frame in frames[1:]:  # begins in the middle of a group
        fields = SimpleNamespace(format="h264", data=frame.data)
        message = coded(fields, "foxglove_msgs/msg/CompressedVideo")
        updates.append(update(video=message, lost=int(frame.pts == 6)))
    assert len(refused(made("compressed_video"), updates, paper)) == 3 + 2
    assert paper.values("/video", "is_keyframe") == [[True], [False]]  # frames 4 and 5


def test_h264_in_a_compressed_image_is_video_and_nothing_else_is(paper):
    _, (frame,) = packets(count=1)
    message = coded(SimpleNamespace(format="h264", data=frame.data))
    with pytest.raises(NotShownError, match="shown by compressed_image_video"):
        made("compressed_image").show(update(image=message), paper)
    made("compressed_image_video").show(update(video=message), paper)
    assert paper.kinds("/video") == ["VideoStream", "VideoStream"]
    message.format = "jpeg"
    with pytest.raises(NotShownError, match=r"shown by compressed_image$"):
        made("compressed_image_video").show(update(video=message), paper)
    assert len(paper.drawn) == 2


def test_what_cannot_be_drawn_is_not_counted_as_shown(paper):
    session = Session()
    display = session.add("ffmpeg_video", "/video")
    type_ = display.inputs[0][0].type
    messages = [ffmpeg_packet(packet) for packet in foreign_packets()]
    arrivals = [Arrival("/video", type_, n * S, b"", one) for n, one in enumerate(messages[1:])]
    replay(arrivals, session, paper)
    slot = display.slot
    assert display.errors > 0
    assert slot.received == slot.shown + slot.dropped + display.errors
    assert slot.shown == len(paper.values("/video", "sample"))


# --- Cameras and points -----------------------------------------------------------------------------


def test_a_camera_hangs_its_image_plane_below_its_frame(paper):
    made("camera_info").show(update(info=CAMERA_INFO), paper)
    assert paper.values("/info", "parent_frame") == [["camera"]]
    assert paper.values("/info", "child_frame") == [["camera/image_plane"]]
    assert paper.values("/info", "resolution") == [[[6.0, 4.0]]]


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


def test_points_take_the_colours_of_a_registered_picture(paper, make_image):
    picture = np.zeros((4, 6, 3), np.uint8)
    picture[..., 0] = 200  # blue, in bgr8
    depth = make_image(np.full((4, 6), 1.0, np.float32), "32FC1")
    topics = {"depth": "/depth", "info": "/info", "color": "/color"}
    shown = update(depth=depth, info=CAMERA_INFO, color=make_image(picture, "bgr8"))
    made("depth_cloud", topics, decimation=1).show(shown, paper)
    assert set(paper.values("/depth/cloud", "colors")[0]) == {0x0000C8FF}
    assert paper.frames["/depth/cloud"] == "camera"


def test_depth_whose_camera_was_described_once_before_the_view_began_becomes_points(
    paper, make_image
):
    """Live, the late joiner is sent it again: the camera info is asked for with the past."""
    session = Session()
    display = session.add("depth_cloud", {"depth": "/depth", "info": "/info"})
    assert display.inputs[1][2].durability.value == "transient_local"
    arrivals = [Arrival("/info", "sensor_msgs/msg/CameraInfo", 0, b"", CAMERA_INFO)]
    for number in range(1, 21):
        depth = make_image(np.full((4, 6), 1.0, np.float32), "32FC1", stamp_ns=number * S)
        arrivals.append(Arrival("/depth", "sensor_msgs/msg/Image", number * S, b"", depth))
    replay(arrivals, session, paper)
    assert (display.slot.shown, display.errors) == (20 - PATIENCE, 0)


def test_clouds_and_scans_are_coloured_points_in_their_frame(paper):
    scan = default_message("sensor_msgs/msg/LaserScan", header=header_msg("laser", 0))
    scan.ranges, scan.range_max = np.array([1.0, 2.0], np.float32), 5.0
    made("laser_scan").show(update(scan=scan), paper)
    assert paper.frames == {"/scan": "laser"}
    records = np.zeros(10, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
    records["x"] = range(10)
    made("point_cloud", decimation=3).show(update(cloud=cloud(records)), paper)
    (positions,) = paper.values("/cloud", "positions")
    assert [x for x, _, _ in positions] == [0.0, 3.0, 6.0, 9.0]


# --- Places ---------------------------------------------------------------------------------------


def test_transforms_stand_at_their_frames_with_their_own_times(tmp_path):
    message = transforms(("map", "go2/base", S, 1.0), ("go2/base", "go2/camera", 2 * S, 2.0))
    with closing(open_canvas([str(tmp_path / "tf.rrd")])) as canvas:
        canvas.at(stamp_ns=9, received_ns=9)
        made("tf").show(update(tf=message, received_ns=77), canvas)
    shown = read_recording(tmp_path / "tf.rrd")
    wanted = {"translation": [[2, 0, 0]], "quaternion": [[0, 0, 0, 1]]}
    wanted |= {"parent_frame": ["go2/base"], "child_frame": ["go2/camera"]}
    for component, content in wanted.items():
        assert shown["/tf/go2/camera", f"Transform3D:{component}"] == [(2 * S, 77, content)]


def test_a_frame_that_is_sent_often_does_not_silence_another(paper):
    visualizer = made("tf", frame_hz=10, axis_length_m=0.0)
    for step in range(100):
        children = ["often", "seldom"] if step == 50 else ["often"]
        moved = [("map", child, S + step * S // 100, 0.0) for child in children]
        visualizer.show(update(tf=transforms(*moved)), paper)
    assert len(paper.kinds("/tf/often")) in (10, 11)  # in one second, begun at once
    assert len(paper.kinds("/tf/seldom")) == 1


def test_a_static_transform_holds_for_all_times(paper):
    made("tf_static").show(update(tf=transforms(("", "imu", 0, 0.0))), paper)
    assert [drawn.static for drawn in paper.drawn] == [True, True]
    assert paper.kinds("/tf/imu") == ["Transform3D", "TransformAxes3D"]


@pytest.mark.parametrize("kind", ["pose", "odometry"])
def test_a_pose_is_its_three_axes(paper, kind):
    message = default_message(KINDS[kind].inputs[0].type, header=header_msg("odom", 0))
    pose = Pose.at((1, 2, 3), (0, 0, 1, 1)).to_pose_msg()  # 90 degrees about z
    if kind == "pose":
        message.pose = pose
    else:
        message.pose.pose = pose
    made(kind, axis_length_m=2.0).show(update(only=message), paper)
    axes = [[0, 2, 0], [-2, 0, 0], [0, 0, 2]]
    assert np.allclose(paper.values(f"/{kind}", "vectors"), [axes], atol=1e-6)
    assert np.allclose(paper.values(f"/{kind}", "origins"), [[[1, 2, 3]] * 3])
    assert paper.frames[f"/{kind}"] == "odom"


def test_a_path_is_a_line_and_an_empty_one_none(paper):
    message = default_message("nav_msgs/msg/Path")
    made("path").show(update(path=message), paper)
    for x in (0.0, 1.0):
        stamped = default_message("geometry_msgs/msg/PoseStamped")
        stamped.pose.position.x = x
        message.poses.append(stamped)
    made("path").show(update(path=message), paper)
    assert paper.values("/path", "strips") == [[], [[[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]]]


# --- Markers --------------------------------------------------------------------------------------

TRIANGLE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]


def marker(type_, id_=0, *, points=(), scale=(1.0, 1.0, 1.0), lifetime_ns=0, action=0):
    point = message_type("geometry_msgs/msg/Point")
    message = default_message(
        MARKER,
        header=header_msg("map", 0),
        ns="walls",
        id=id_,
        type=type_,
        action=action,
        text="hello",
        scale=message_type("geometry_msgs/msg/Vector3")(*scale),
        lifetime=stamp_from_ns(lifetime_ns),
        pose=Pose.at((1, 0, 0), (0, 0, 1, 1)).to_pose_msg(),
        points=[point(*each) for each in points],
    )
    message.color.a = 1.0
    return message


@pytest.mark.parametrize(
    ("type_", "points", "kind"),
    [
        (0, (), "Arrows3D"),
        (0, TRIANGLE[:2], "Arrows3D"),
        (1, (), "Boxes3D"),
        (2, (), "Ellipsoids3D"),
        (3, (), "Cylinders3D"),
        (4, (), "LineStrips3D"),
        (4, TRIANGLE, "LineStrips3D"),
        (5, TRIANGLE[:2] * 2, "LineStrips3D"),
        (6, (), "Boxes3D"),
        (6, TRIANGLE, "Boxes3D"),
        (7, TRIANGLE, "Ellipsoids3D"),
        (8, (), "Points3D"),
        (8, TRIANGLE, "Points3D"),
        (9, (), "Points3D"),
        (11, (), "Mesh3D"),
        (11, TRIANGLE, "Mesh3D"),
    ],
)
def test_every_common_marker_is_drawn(paper, type_, points, kind):
    made("marker").show(update(marker=marker(type_, points=points)), paper)
    assert paper.kinds("/marker/walls/0") == [kind]
    assert paper.frames["/marker/walls/0"] == "map"


@pytest.mark.parametrize(
    ("shape", "component", "values"),
    [
        (marker(8, points=TRIANGLE), "positions", [[1, 0, 0], [1, 1, 0], [0, 0, 0]]),
        (
            marker(11, points=TRIANGLE, scale=(2.0, 1.0, 1.0)),
            "vertex_positions",
            [[1, 0, 0], [1, 2, 0], [0, 0, 0]],
        ),
        (marker(0, scale=(2.0, 1.0, 1.0)), "vectors", [[0, 2, 0]]),
        (marker(0, points=TRIANGLE[:2]), "vectors", [[0, 1, 0]]),
        (marker(6, points=TRIANGLE), "centers", [[1, 0, 0], [1, 1, 0], [0, 0, 0]]),
        (marker(2, scale=(2.0, 4.0, 6.0)), "half_sizes", [[1, 2, 3]]),
    ],
)
def test_a_markers_geometry_is_moved_by_its_pose(paper, shape, component, values):
    """By 1 m along x and 90 degrees about z; a triangle is scaled before."""
    made("marker").show(update(marker=shape), paper)
    (found,) = paper.values("/marker/walls/0", component)
    assert np.allclose(found, values, atol=1e-6)


def test_markers_go_when_they_are_told_to_and_when_their_time_is_over(paper):
    visualizer = made("marker")

    def show(*arguments, **more):
        visualizer.show(update(marker=marker(*arguments, **more), received_ns=10 * S), paper)

    show(1, 1, lifetime_ns=S)
    show(1, 2)
    show(1, 3)
    visualizer.tick(11 * S - 1, paper)
    assert paper.kinds("/marker/walls/1") == ["Boxes3D"]
    visualizer.tick(11 * S, paper)
    assert paper.kinds("/marker/walls/1") == ["Boxes3D", "Clear"]
    show(1, 2, action=2)
    assert paper.kinds("/marker/walls/2") == ["Boxes3D", "Clear"]
    show(1, 9, action=3)
    assert paper.kinds("/marker/walls/3") == ["Boxes3D", "Clear"]
    show(2, 2)
    show(1, 2)
    assert paper.kinds("/marker/walls/2")[2:] == ["Ellipsoids3D", "Clear", "Boxes3D"]


def test_a_flood_of_markers_pushes_the_oldest_out(paper):
    visualizer = made("marker", most=3)
    for number in range(10):
        visualizer.show(update(marker=marker(1, number)), paper)
    cleared = [drawn.entity for drawn in paper.drawn if isinstance(drawn.what[0], rr.Clear)]
    assert cleared == [f"/marker/walls/{number}" for number in range(7)]


def test_one_bad_marker_does_not_keep_the_others_of_its_array_back(paper):
    markers = [marker(1, 1), marker(10, 2), marker(1, 3)]
    array = default_message("visualization_msgs/msg/MarkerArray", markers=markers)
    with pytest.raises(SfglabError, match=r"marker type: given 10, .*; meshes are not loaded"):
        made("marker_array").show(update(markers=array), paper)
    assert set(paper.frames) == {"/markers/walls/1", "/markers/walls/3"}


# --- Agents ---------------------------------------------------------------------------------------


def test_an_agent_lives_by_the_age_of_its_last_heartbeat_and_only_changes_are_drawn(paper):
    visualizer, root = made("agent_heartbeats"), "/agents/go2/heartbeat"
    first = heartbeat("go2", period_s=2.0, phase=Phase.STARTUP)
    visualizer.show(update(heartbeats=first, received_ns=0), paper)
    for now_s in (0.0, 2.9, 3.1, 5.9, 6.1):
        visualizer.tick(round(now_s * S), paper)
    visualizer.show(update(heartbeats=heartbeat("go2"), received_ns=7 * S), paper)
    visualizer.tick(7 * S, paper)
    ages = [[age] for age in (0.0, 2.9, 3.1, 5.9, 6.1, 0.0)]
    assert paper.values(f"{root}/age_s", "scalars") == ages
    lives = [["starting"], ["late"], ["lost"], ["alive"]]
    assert paper.values(f"{root}/life", "state") == lives


def test_a_flood_of_agents_is_refused(paper):
    visualizer = made("agent_heartbeats")
    for number in range(256):
        visualizer.show(update(heartbeats=heartbeat(f"agent{number}")), paper)
    with pytest.raises(SfglabError, match="256 agents at most"):
        visualizer.show(update(heartbeats=heartbeat("another")), paper)


def test_an_agents_status_is_told_with_its_description(paper):
    sensor = default_message("sfglab_interfaces/msg/SensorInfo", name="camera_front")
    metadata = default_message("sfglab_interfaces/msg/AgentMetadata", agent="go2", sensors=[sensor])
    type_ = "sfglab_interfaces/msg/AgentDiscoveryEvent"
    event = default_message(type_, agent="go2", metadata=metadata)
    visualizer, root = made("agent_status"), "/agents/go2/status"
    visualizer.show(update(events=event), paper)
    event.event = event.LOST
    visualizer.show(update(events=event), paper)
    assert paper.values(f"{root}/log", "text") == [["go2 discovered"], ["go2 lost"]]
    assert paper.values(root, "state") == [["there"], ["lost"]]
    assert "camera_front" in paper.values(f"{root}/description", "text")[0][0]


# --- Refusals -------------------------------------------------------------------------------------

FAR = float("nan")
DEPTH = {"encoding": "32FC1", "width": 6, "height": 4, "data": np.zeros(96, np.uint8)}


def depth_of(frame):
    return default_message("sensor_msgs/msg/Image", header=header_msg(frame, 0), **DEPTH)


def nowhere():
    message = default_message("geometry_msgs/msg/PoseStamped")
    message.pose.position.x = FAR
    return message


@pytest.mark.parametrize(
    ("kind", "messages", "told"),
    [
        (
            "compressed_image",
            {"image": default_message("sensor_msgs/msg/CompressedImage", format="tiff")},
            "compressed image format: given 'tiff'",
        ),
        ("pose", {"pose": nowhere()}, "pose, position: given"),
        ("agent_heartbeats", {"heartbeats": heartbeat("../../etc")}, "agent"),
        ("agent_heartbeats", {"heartbeats": heartbeat("")}, "agent"),
        ("agent_heartbeats", {"heartbeats": default_message(BEAT, agent="go2")}, "period_s"),
        (
            "agent_status",
            {"events": default_message("sfglab_interfaces/msg/AgentDiscoveryEvent", event=77)},
            "discovery event: given 77",
        ),
        (
            "depth_cloud",
            {"depth": depth_of("camera"), "info": camera_info(CAMERA_INFO.header, (12, 8))},
            "camera info, size: given '12 x 8', allowed: 6 x 4",
        ),
        (
            "depth_cloud",
            {"depth": depth_of("rear"), "info": CAMERA_INFO},
            "camera info, frame: given 'camera', allowed: 'rear'",
        ),
        (
            "point_cloud",
            {"cloud": cloud(np.zeros(2, [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]))},
            "color_by: given 'ring', allowed: the fields x, y, z",
        ),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_sentence_and_draws_nothing(
    paper, kind, messages, told
):
    settings = {"color_by": "ring"} if kind == "point_cloud" else {}
    visualizer = made(kind, **settings)
    with pytest.raises(SfglabError, match=told):
        visualizer.show(update(**messages), paper)
    visualizer.tick(S, paper)
    assert paper.drawn == []

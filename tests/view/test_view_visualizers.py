"""What each visualizer draws, on paper and in a real recording that is read back."""

import struct
from contextlib import closing

import numpy as np
import pytest
from foreign_video import CLOCKS, avcc, clocked, ffmpeg_packet
from foreign_video import packets as video_packets
from seen import BEAT, cloud, heartbeat, read_recording

from sfglab.codecs import CodecError, compressed_depth_fields, compressed_image_fields
from sfglab.errors import SfglabError
from sfglab.fleet.status.heartbeat import Phase
from sfglab.lab.experiments.visualisation.points import camera_info, image_message
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
HEADER = header_msg("camera", 0)
CAMERA_INFO = camera_info(HEADER, (6, 4))
COMPRESSED = "sensor_msgs/msg/CompressedImage"
EVENT = "sfglab_interfaces/msg/AgentDiscoveryEvent"
METRES = np.full((4, 6), 2.0, np.float32)


def made(kind, **settings):
    topics = {given.role: f"/{given.role}" for given in KINDS[kind].inputs}
    return KINDS[kind](topics, settings)


def update(received_ns=2_000, lost=0, **messages):
    return Update(messages=messages, stamp_ns=1_000, received_ns=received_ns, lost=lost)


def coded(data, format_, type_name=COMPRESSED, **more):
    array = np.frombuffer(data, np.uint8)
    return default_message(type_name, format=format_, data=array, **more)


def image(array, encoding):
    return image_message(array, encoding, HEADER)


def transforms(*moved):
    """A message of transforms, each from parent, child, stamp and x; a quaternion of all zeros is no rotation."""
    message = default_message("tf2_msgs/msg/TFMessage")
    for parent, child, stamp_ns, x in moved:
        header = header_msg(parent, stamp_ns)
        one = default_message(
            "geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child
        )
        one.transform.translation.x = x
        message.transforms.append(one)
    return message


POSE = Pose.at((1, 2, 3), (0, 0, 1, 1)).to_pose_msg()  # 90 degrees about z
STAMPED = default_message("geometry_msgs/msg/PoseStamped", header=HEADER, pose=POSE)
ODOMETRY = default_message("nav_msgs/msg/Odometry", header=HEADER)
ODOMETRY.pose.pose = POSE
AXES = {"vectors": [[0, 2, 0], [-2, 0, 0], [0, 0, 2]], "origins": [[1, 2, 3]] * 3}
SCAN = default_message("sensor_msgs/msg/LaserScan", header=HEADER, range_max=5.0)
SCAN.ranges = np.array([1.0, 2.0], np.float32)
RECORDS = np.zeros(10, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
RECORDS["x"] = range(10)
BLUE = np.full((4, 6, 3), (200, 0, 0), np.uint8)  # in bgr8
JPEG = compressed_image_fields(BLUE)
CLOUD = {"depth": image(METRES, "32FC1"), "info": CAMERA_INFO, "color": image(BLUE, "bgr8")}
PLANE = "camera/image_plane"


@pytest.mark.parametrize(
    ("kind", "messages", "entity", "drawn", "frame"),
    [
        ("image", {"image": image(BLUE, "bgr8")}, "/image", {"buffer": [BLUE.tobytes()]}, PLANE),
        (
            "compressed_image",
            {"image": coded(JPEG.data, JPEG.format, header=HEADER)},
            "/image",
            {"blob": [JPEG.data], "media_type": ["image/jpeg"]},
            PLANE,
        ),
        (
            "camera_info",
            {"info": CAMERA_INFO},
            "/info",
            {"parent_frame": ["camera"], "child_frame": [PLANE], "resolution": [[6, 4]]},
            None,
        ),
        ("depth_cloud", CLOUD, "/depth/cloud", {"colors": [0x0000C8FF] * 24}, "camera"),
        ("laser_scan", {"scan": SCAN}, "/scan", {"positions": [[1, 0, 0], [2, 0, 0]]}, "camera"),
        (
            "point_cloud",
            {"cloud": cloud(RECORDS)},
            "/cloud",
            {"positions": [[x, 0, 0] for x in (0, 3, 6, 9)]},
            None,
        ),
        ("pose", {"pose": STAMPED}, "/pose", AXES, "camera"),
        ("odometry", {"odometry": ODOMETRY}, "/odometry", AXES, "camera"),
        (
            "path",
            {"path": default_message("nav_msgs/msg/Path", poses=[STAMPED, STAMPED])},
            "/path",
            {"strips": [[[1, 2, 3], [1, 2, 3]]]},
            None,
        ),
        ("path", {"path": default_message("nav_msgs/msg/Path")}, "/path", {"strips": []}, None),
    ],
)
def test_a_message_is_drawn_in_its_frame(paper, kind, messages, entity, drawn, frame):
    settings = {"axis_length_m": 2.0, "decimation": 3 if kind == "point_cloud" else 1}
    known = {parameter.name for parameter in KINDS[kind].parameters}
    given = {name: value for name, value in settings.items() if name in known}
    made(kind, **given).show(update(**messages), paper)
    for component, values in drawn.items():
        (found,) = paper.values(entity, component)
        if isinstance(values[0] if values else 0, bytes | str):
            found = [bytes(one) if isinstance(one, list) else one for one in found]
            assert found == values
        else:
            assert np.allclose(found, values, atol=1e-6)
    assert paper.frames.get(entity) == frame


@pytest.mark.parametrize(
    ("encoding", "pixel", "kind"),
    [
        ("rgb8", "3u1", rr.ColorModel.RGB),
        ("bgr8", "3u1", rr.ColorModel.BGR),
        ("mono8", "u1", rr.ColorModel.L),
        ("16UC1", "u2", None),
        ("32FC1", "f4", None),
    ],
)
def test_an_image_is_drawn_by_its_encoding(paper, encoding, pixel, kind):
    made("image").show(update(image=image(np.zeros((4, 6), pixel), encoding)), paper)
    assert paper.kinds("/image") == ["Image" if kind else "DepthImage"]
    assert paper.values("/image", "format")[0][0]["color_model"] == (kind and kind.value)


# A and B of 32-bit depth, and 2 m by them, as compressed_depth_image_transport writes them.
QUANTISER, TWO_METRES = struct.pack("<iff", 0, 10100, -1009), 4041


@pytest.mark.parametrize("codec", ["rvl", "png"])
@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_compressed_depth_is_decoded_to_metres(paper, codec, dtype):
    depth = np.full((4, 6), 2000 if dtype == np.uint16 else TWO_METRES, np.uint16)
    fields = compressed_depth_fields(depth, codec)
    given = coded(fields.data, fields.format)
    if dtype == np.float32:
        given = coded(QUANTISER + fields.data[12:], fields.format.replace("16UC1", "32FC1"))
    made("compressed_image").show(update(image=given), paper)
    [[per_metre]] = paper.values("/image", "meter")
    stored = np.frombuffer(bytes(paper.values("/image", "buffer")[0][0]), dtype)
    assert np.allclose(stored / per_metre, 2.0, atol=0.01)


def foxglove(packet):
    return coded(packet.data, "h264", "foxglove_msgs/msg/CompressedVideo")


NO_KEY = "no key frame since the start or a lost packet"


@pytest.mark.parametrize(
    ("kind", "messages", "lost_at", "shown", "reason"),
    [
        *(("ffmpeg_video", lambda clock=clock: clocked(clock), None, 10, "") for clock in CLOCKS),
        ("ffmpeg_video", lambda: map(ffmpeg_packet, video_packets()[1:5]), None, 0, NO_KEY),
        (
            "ffmpeg_video",
            lambda: [ffmpeg_packet(packet) for packet in video_packets() if packet.pts != 1],
            None,
            1 + 5,
            NO_KEY,
        ),
        ("compressed_video", lambda: map(foxglove, video_packets()[1:]), 6, 2, NO_KEY),
        (
            "ffmpeg_video",
            lambda: map(ffmpeg_packet, video_packets(12, b_frames=2)),
            None,
            1,
            "B frames, which are not supported",
        ),
        ("compressed_video", lambda: map(avcc, video_packets()), None, 0, "AVCC is not supported"),
        (
            "compressed_image_video",
            lambda: [coded(video_packets(1)[0].data, "h264")],
            None,
            1,
            "",
        ),
    ],
)
def test_video_is_shown_from_a_key_frame_to_a_loss_and_else_refused_with_its_cause(
    paper, kind, messages, lost_at, shown, reason
):
    """A group has five pictures; the last row but three begins in the middle of one and loses one later."""
    visualizer, reasons, count = made(kind), [], 0
    for number, message in enumerate(messages()):
        count += 1
        try:
            visualizer.show(update(video=message, lost=int(number == lost_at)), paper)
        except CodecError as error:
            reasons.append(str(error))
    samples = paper.values("/video", "sample")
    assert (len(samples), len(reasons)) == (shown, count - shown)
    assert all(reason in one for one in reasons[-1:])


def test_what_cannot_be_drawn_is_not_counted_as_shown(paper):
    session = Session()
    display = session.add("ffmpeg_video", "/video")
    type_ = display.inputs[0][0].type
    messages = [ffmpeg_packet(packet) for packet in video_packets()]
    arrivals = [Arrival("/video", type_, n * S, b"", one) for n, one in enumerate(messages[1:])]
    replay(arrivals, session, paper)
    slot = display.slot
    assert slot.shown == len(paper.values("/video", "sample")) == 5
    assert slot.received == slot.shown + slot.dropped + display.errors == 9


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


def test_depth_whose_camera_was_described_once_before_the_view_began_becomes_points(paper):
    """Live, the late joiner is sent it again: the camera info is asked for with the past."""
    session = Session()
    display = session.add("depth_cloud", {"depth": "/depth", "info": "/info"})
    assert display.inputs[1][2].durability.value == "transient_local"
    arrivals = [Arrival("/info", "sensor_msgs/msg/CameraInfo", 0, b"", CAMERA_INFO)]
    for number in range(1, 21):
        depth = image_message(METRES, "32FC1", header_msg("camera", number * S))
        arrivals.append(Arrival("/depth", "sensor_msgs/msg/Image", number * S, b"", depth))
    replay(arrivals, session, paper)
    assert (display.slot.shown, display.errors) == (20 - PATIENCE, 0)


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


TRIANGLE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]


def marker(type_, id_=0, *, points=(), scale=(1.0, 1.0, 1.0), lifetime_ns=0, action=0):
    point = message_type("geometry_msgs/msg/Point")
    message = default_message(
        "visualization_msgs/msg/Marker",
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
    ("shape", "component", "values"),
    [
        (marker(0, scale=(2.0, 1.0, 1.0)), "vectors", [[0, 2, 0]]),
        (marker(0, points=TRIANGLE[:2]), "vectors", [[0, 1, 0]]),
        (marker(1), "centers", [[1, 0, 0]]),
        (marker(2, scale=(2.0, 4.0, 6.0)), "half_sizes", [[1, 2, 3]]),
        (marker(3, scale=(2.0, 4.0, 6.0)), "radii", [1.5]),
        (marker(4), "strips", []),
        (marker(4, points=TRIANGLE), "strips", [[[1, 0, 0], [1, 1, 0], [0, 0, 0]]]),
        (marker(5, points=TRIANGLE), "strips", [[[1, 0, 0], [1, 1, 0]]]),
        (marker(6), "centers", []),
        (marker(6, points=TRIANGLE), "centers", [[1, 0, 0], [1, 1, 0], [0, 0, 0]]),
        (marker(7, points=TRIANGLE), "half_sizes", [[0.5] * 3] * 3),
        (marker(8), "positions", []),
        (marker(8, points=TRIANGLE), "positions", [[1, 0, 0], [1, 1, 0], [0, 0, 0]]),
        (marker(9), "positions", [[1, 0, 0]]),
        (
            marker(11, points=TRIANGLE, scale=(2.0, 1.0, 1.0)),
            "vertex_positions",
            [[1, 0, 0], [1, 2, 0], [0, 0, 0]],
        ),
    ],
)
def test_every_common_marker_is_drawn_and_moved_by_its_pose(paper, shape, component, values):
    """By 1 m along x and 90 degrees about z; a triangle is scaled before."""
    made("marker").show(update(marker=shape), paper)
    (found,) = paper.values("/marker/walls/0", component)
    assert np.allclose(found, values, atol=1e-6)
    assert paper.frames["/marker/walls/0"] == "map"


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


def test_a_flood_of_agents_is_refused():
    visualizer = made("agent_heartbeats")
    for number in range(256):
        visualizer.show(update(heartbeats=heartbeat(f"agent{number}")), None)
    with pytest.raises(SfglabError, match="256 agents at most"):
        visualizer.show(update(heartbeats=heartbeat("another")), None)


def test_an_agents_status_is_told_with_its_description(paper):
    sensor = default_message("sfglab_interfaces/msg/SensorInfo", name="camera_front")
    metadata = default_message("sfglab_interfaces/msg/AgentMetadata", agent="go2", sensors=[sensor])
    visualizer, root = made("agent_status"), "/agents/go2/status"
    for word in ("DISCOVERED", "LOST"):
        event = default_message(EVENT, agent="go2", metadata=metadata)
        event.event = getattr(event, word)
        visualizer.show(update(events=event), paper)
    assert paper.values(f"{root}/log", "text") == [["go2 discovered"], ["go2 lost"]]
    assert paper.values(root, "state") == [["there"], ["lost"]]
    assert "camera_front" in paper.values(f"{root}/description", "text")[0][0]


NOWHERE = default_message("geometry_msgs/msg/PoseStamped")
NOWHERE.pose.position.x = float("nan")


@pytest.mark.parametrize(
    ("kind", "messages", "error", "told"),
    [
        ("compressed_image", {"image": coded(b"", "tiff")}, SfglabError, "format: given 'tiff'"),
        ("compressed_image", {"image": coded(b"", "h264")}, NotShownError, "by compressed_image_v"),
        (
            "compressed_image_video",
            {"video": coded(b"", "jpeg")},
            NotShownError,
            "compressed_image$",
        ),
        ("pose", {"pose": NOWHERE}, SfglabError, "pose, position: given"),
        ("agent_heartbeats", {"heartbeats": heartbeat("../../etc")}, SfglabError, "agent"),
        ("agent_heartbeats", {"heartbeats": default_message(BEAT)}, SfglabError, "period_s"),
        ("agent_status", {"events": default_message(EVENT, event=77)}, SfglabError, "given 77"),
        (
            "depth_cloud",
            CLOUD | {"info": camera_info(HEADER, (12, 8))},
            SfglabError,
            "camera info, size: given '12 x 8', allowed: 6 x 4",
        ),
        (
            "depth_cloud",
            CLOUD | {"info": camera_info(header_msg("rear", 0), (6, 4))},
            SfglabError,
            "camera info, frame: given 'rear', allowed: 'camera'",
        ),
        (
            "point_cloud",
            {"cloud": cloud(RECORDS)},
            SfglabError,
            "color_by: given 'ring', allowed: the fields x, y, z, intensity",
        ),
    ],
)
def test_what_makes_no_sense_is_refused_in_one_sentence_and_draws_nothing(
    paper, kind, messages, error, told
):
    visualizer = made(kind)
    if kind == "point_cloud":
        visualizer.tune("color_by", "ring")
    with pytest.raises(error, match=told):
        visualizer.show(update(**messages), paper)
    visualizer.tick(S, paper)
    assert paper.drawn == []

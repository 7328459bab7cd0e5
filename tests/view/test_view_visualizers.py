"""Drawings of each visualizer, on paper and in a real recording that is read back."""

import struct
from contextlib import closing

import numpy as np
import pytest
from foreign_video import CLOCKS, avcc, clocked, ffmpeg_packet
from foreign_video import packets as video_packets
from seen import BEAT, cloud, heartbeat, read_recording

from sfglab.codecs import (
    compressed_depth_fields,
    compressed_image_fields,
)
from sfglab.errors import SfglabError
from sfglab.fleet.status.heartbeat import Phase
from sfglab.lab.experiments.visualisation.points import camera_info
from sfglab.lab.workers.picture_flow import image_message
from sfglab.messages import default_message, message_type, stamp_from_ns
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.listener import TRANSFORMS
from sfglab.spatial.poses import header_msg
from sfglab.view.arrivals import Arrival
from sfglab.view.rerunning import open_canvas
from sfglab.view.session import BUILT_IN, Session
from sfglab.view.stage import replay
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


def show(visualizer, canvas, *messages, received_ns=2_000):
    roles = dict(zip(visualizer.topics, messages, strict=True))
    visualizer.show(Update(messages=roles, stamp_ns=1_000, received_ns=received_ns), canvas)


def coded(data, format_, type_name=COMPRESSED, **more):
    array = np.frombuffer(data, np.uint8)
    return default_message(type_name, format=format_, data=array, **more)


def image(array, encoding):
    return image_message(array, encoding, HEADER)


def transforms(*moved):
    """A message of transforms, each from parent, child, stamp and x."""
    made = []
    for parent, child, stamp_ns, x_m in moved:
        pose = Pose.at((x_m, 0, 0))
        made.append(StampedTransform(parent=parent, child=child, stamp_ns=stamp_ns, pose=pose))
    return message_type(TRANSFORMS)(transforms=[one.to_msg() for one in made])


POSE = Pose.at((1, 2, 3), (0, 0, 1, 1)).to_pose_msg()  # 90 degrees about z
STAMPED = default_message("geometry_msgs/msg/PoseStamped", header=HEADER, pose=POSE)
ODOMETRY = default_message("nav_msgs/msg/Odometry", header=HEADER)
ODOMETRY.pose.pose = POSE
PATH = default_message("nav_msgs/msg/Path", poses=[STAMPED, STAMPED])
AXES = {"vectors": [[0, 0.3, 0], [-0.3, 0, 0], [0, 0, 0.3]], "origins": [[1, 2, 3]] * 3}
SCAN = default_message("sensor_msgs/msg/LaserScan", header=HEADER, angle_increment=np.pi / 2)
SCAN.range_min, SCAN.range_max = 0.1, 10.0
SCAN.ranges = np.array([1, 2, np.inf, 0.05, np.nan, 11, 3], np.float32)
RECORDS = np.zeros(10, [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("intensity", "<f4")])
RECORDS["x"] = range(10)
BLUE = np.full((4, 6, 3), (200, 0, 0), np.uint8)  # in bgr8
JPEG = compressed_image_fields(BLUE)
COMPRESSED_BLUE = coded(JPEG.data, JPEG.format, header=HEADER)
# A and B of 32-bit depth, and 2 m by them, as compressed_depth_image_transport writes them.
QUANTISER, TWO_METRES = struct.pack("<iff", 0, 10100, -1009), 4041
RVL = compressed_depth_fields(np.full((4, 6), TWO_METRES, np.uint16), "rvl")
FLOAT_DEPTH = coded(QUANTISER + RVL.data[12:], RVL.format.replace("16UC1", "32FC1"), header=HEADER)
PICTURE = np.zeros((8, 12, 3), np.uint8)  # of twice the size of the depth image
PICTURE[0, 8] = (200, 0, 0)
RECTIFIED = camera_info(HEADER, (6, 4))
RECTIFIED.p = np.insert(2 * CAMERA_INFO.k, (3, 6, 9), 0)
DEPTH, COLOR = image(METRES, "32FC1"), image(PICTURE, "bgr8")
PLANE = "camera/image_plane"


def form(color_model):
    size = {"width": 6, "height": 4, "channel_datatype": "U8"}
    made = rr.components.ImageFormat(color_model=color_model, **size)
    return rr.components.ImageFormatBatch(made).as_arrow_array().to_pylist()


PINHOLE = [4.32, 0.0, 0.0, 0.0, 4.32, 0.0, 2.5, 1.5, 1.0]  # column by column


@pytest.mark.parametrize(
    ("kind", "messages", "entity", "drawn", "frame"),
    [
        (
            "image",
            [image(BLUE, "bgr8")],
            "/image",
            {"buffer": [[*BLUE.tobytes()]], "format": form("BGR")},
            PLANE,
        ),
        ("image", [image(BLUE, "rgb8")], "/image", {"format": form("RGB")}, PLANE),
        ("image", [image(BLUE[..., 0], "mono8")], "/image", {"format": form("L")}, PLANE),
        ("image", [DEPTH], "/image", {"meter": [1.0]}, PLANE),
        ("compressed_image", [coded(RVL.data, RVL.format)], "/image", {"meter": [1000.0]}, None),
        ("compressed_image", [FLOAT_DEPTH], "/image", {"meter": [1.0]}, PLANE),
        (
            "compressed_image",
            [COMPRESSED_BLUE],
            "/image",
            {"blob": [[*JPEG.data]], "media_type": ["image/jpeg"]},
            PLANE,
        ),
        (
            "camera_info",
            [CAMERA_INFO],
            "/info",
            {
                "parent_frame": ["camera"],
                "child_frame": [PLANE],
                "resolution": [[6, 4]],
                "image_from_camera": [PINHOLE],
            },
            None,
        ),
        (
            "camera_info",
            [RECTIFIED],
            "/info",
            {"image_from_camera": [[2 * number for number in PINHOLE]]},
            None,
        ),
        (
            "depth_cloud",
            [DEPTH, CAMERA_INFO, COLOR],
            "/depth/cloud",
            {"colors": [0xFF, 0xC8FF]},
            "camera",
        ),
        (
            "laser_scan",
            [SCAN],
            "/scan",
            {"positions": [[1, 0, 0], [0, 2, 0], [-3, 0, 0]]},
            "camera",
        ),
        ("laser_scan", [default_message(SCAN.__msgtype__)], "/scan", {"positions": []}, None),
        (
            "point_cloud",
            [cloud(RECORDS)],
            "/cloud",
            {"positions": [[x, 0, 0] for x in (0, 3, 6, 9)]},
            None,
        ),
        ("pose", [STAMPED], "/pose", AXES, "camera"),
        ("odometry", [ODOMETRY], "/odometry", AXES, "camera"),
        ("path", [PATH], "/path", {"strips": [[[1, 2, 3], [1, 2, 3]]]}, None),
        ("path", [default_message("nav_msgs/msg/Path")], "/path", {"strips": []}, None),
    ],
)
def test_a_message_is_drawn_in_its_frame(paper, kind, messages, entity, drawn, frame):
    visualizer = made(kind)
    if kind == "point_cloud":
        visualizer.tune("decimation", 3)
    show(visualizer, paper, *messages)
    for component, values in drawn.items():
        (found,) = paper.values(entity, component)
        assert found == values or np.allclose(found, values, atol=1e-6)
    assert paper.frames.get(entity) == frame


def foxglove(packet):
    return coded(packet.data, "h264", "foxglove_msgs/msg/CompressedVideo")


NO_KEY = "no key frame since the start or a lost packet"
PACKETS = video_packets()
FFMPEG = list(map(ffmpeg_packet, PACKETS))
FOXGLOVE = list(map(foxglove, PACKETS))
B_FRAMES = list(map(ffmpeg_packet, video_packets(12, b_frames=2)))


@pytest.mark.parametrize(
    ("kind", "parts", "shown", "reason"),
    [
        *(("ffmpeg_video", [clocked(clock)], 10, "") for clock in CLOCKS),
        ("ffmpeg_video", [FFMPEG[1:]], 5, NO_KEY),
        ("ffmpeg_video", [FFMPEG[:1] + FFMPEG[2:]], 1 + 5, NO_KEY),
        ("compressed_video", [FOXGLOVE[1:7], FOXGLOVE[7:]], 2, NO_KEY),
        ("ffmpeg_video", [B_FRAMES], 1, "B frames, which are not supported"),
        ("compressed_video", [list(map(avcc, PACKETS))], 0, "AVCC is not supported"),
        ("compressed_image_video", [[coded(PACKETS[0].data, "h264")]], 1, ""),
    ],
)
def test_video_is_shown_from_a_key_frame_to_a_loss_and_what_is_not_shown_is_counted(
    paper, kind, parts, shown, reason
):
    """A group has five pictures. Between the parts some are lost: the display is off."""
    session = Session()
    display = session.add(kind, "/video")
    for part in parts:
        replay([Arrival("/video", "", 0, b"", message) for message in part], session, paper)
        for enabled in (False, True):
            session.enable(display.id, enabled=enabled)
    assert display.slot.shown == len(paper.values("/video", "sample")) == shown
    assert display.errors == sum(map(len, parts)) - shown
    assert reason in display.last_error


@pytest.mark.parametrize(
    ("name", "picture"),
    [
        ("/global/go2/camera_front/color", "ffmpeg"),
        ("/local/go2/camera_front/color", "image_raw"),
        ("/camera", "image_raw"),
        ("/camera", "image_raw/compressed"),
    ],
)
def test_a_picture_lies_in_the_plane_of_its_own_camera_info(name, picture):
    plane = image_plane("go2/camera", f"{name}/{picture}")
    assert plane == image_plane("go2/camera", f"{name}/camera_info")
    assert plane != image_plane("go2/camera", "/global/go2/camera_front/aligned_depth/camera_info")


@pytest.mark.parametrize(("kind", "times"), [("tf", (2 * S, 77)), ("tf_static", (None, None))])
def test_transforms_stand_at_their_frames_with_their_own_times_or_for_all(tmp_path, kind, times):
    message = transforms(("map", "go2/base", S, 1.0), ("go2/base", "go2/camera", 2 * S, 2.0))
    message.transforms[1].transform.rotation.w = 0.0  # all zeros are no rotation
    with closing(open_canvas([str(tmp_path / "tf.rrd")])) as canvas:
        canvas.at(stamp_ns=9, received_ns=9)
        show(made(kind), canvas, message, received_ns=77)
    shown = read_recording(tmp_path / "tf.rrd")
    for component, content in (
        ("translation", [[2, 0, 0]]),
        ("quaternion", [[0, 0, 0, 1]]),
        ("parent_frame", ["go2/base"]),
        ("child_frame", ["go2/camera"]),
    ):
        assert shown["/tf/go2/camera", f"Transform3D:{component}"] == [(*times, content)]
    assert ("/tf/go2/camera", "TransformAxes3D:axis_length") in shown


def test_a_frame_that_is_sent_often_does_not_silence_another(paper):
    visualizer = made("tf", frame_hz=10, axis_length_m=0.0)
    for step in range(100):
        moved = [("map", "often", S + step * S // 100, 0.0)]
        if step == 50:
            moved.append(("map", "seldom", S, 0.0))
        show(visualizer, paper, transforms(*moved))
    assert len(paper.values("/tf/often", "translation")) in (10, 11)  # in one second, begun at once
    assert len(paper.values("/tf/seldom", "translation")) == 1


TRIANGLE = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0)]
MOVED = [[1, 0, 0], [1, 1, 0], [0, 0, 0]]  # as `marker` is


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
        (marker(4, points=TRIANGLE), "strips", [MOVED]),
        (marker(5, points=TRIANGLE), "strips", [MOVED[:2]]),
        (marker(6, points=TRIANGLE), "centers", MOVED),
        (marker(7, points=TRIANGLE), "half_sizes", [[0.5] * 3] * 3),
        (marker(8, points=TRIANGLE), "positions", MOVED),
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
    show(made("marker"), paper, shape)
    (found,) = paper.values("/marker/walls/0", component)
    assert np.allclose(found, values, atol=1e-6)
    assert paper.frames["/marker/walls/0"] == "map"


def test_markers_go_when_told_when_their_time_is_over_and_when_there_are_too_many(paper):
    visualizer = made("marker", most=3)

    def drawn():
        found = [(type(one.what[0]).__name__, int(one.entity[-1])) for one in paper.drawn]
        paper.drawn.clear()
        return found

    def sent(*arguments, **more):
        show(visualizer, paper, marker(*arguments, **more), received_ns=10 * S)
        return drawn()

    for number in (0, 1, 2, 0):
        assert sent(1, number) == [("Boxes3D", number)]
    assert sent(1, 3) == [("Clear", 1), ("Boxes3D", 3)], "0 came again"
    assert sent(1, 4, lifetime_ns=S)[0] == ("Clear", 2)
    for now_ns, gone in ((11 * S - 1, []), (11 * S, [("Clear", 4)])):
        visualizer.tick(now_ns, paper)
        assert drawn() == gone
    assert sent(1, 3, action=2) == [("Clear", 3)]
    assert sent(2, 0) == [("Clear", 0), ("Ellipsoids3D", 0)], "another shape"
    assert sent(1, 9, action=3) == [("Clear", 0)]


def test_one_bad_marker_does_not_keep_the_others_of_its_array_back(paper):
    markers = [marker(1, 1), marker(10, 2), marker(1, 3)]
    array = default_message("visualization_msgs/msg/MarkerArray", markers=markers)
    with pytest.raises(SfglabError, match=r"marker type: given 10, .*; meshes are not loaded"):
        show(made("marker_array"), paper, array)
    assert set(paper.frames) == {"/markers/walls/1", "/markers/walls/3"}


def test_an_agent_lives_by_the_age_of_its_last_heartbeat_and_silence_is_seen_when_it_begins(paper):
    session = Session()
    session.add("agent_heartbeats", "/beats")
    starting = heartbeat("go2", phase=Phase.STARTUP)
    beats = [(0, starting), (1, heartbeat("go2")), (20, heartbeat("pi1"))]
    replay([Arrival("/beats", BEAT, at_s * S, b"", beat) for at_s, beat in beats], session, paper)
    root = "/agents/go2/heartbeat"
    lives = [[life] for life in ("starting", "alive", "late", "lost")]
    assert paper.values(f"{root}/life", "state") == lives
    changes = [d.time[1] / S for d in paper.drawn if d.entity == f"{root}/life" and not d.static]
    assert changes == pytest.approx([0.0, 1.0, 2.5, 4.0], abs=0.3)
    assert paper.values(f"{root}/age_s", "scalars")[-1] == [pytest.approx(19.0)]


def test_a_flood_of_agents_is_refused():
    visualizer = made("agent_heartbeats")
    for number in range(256):
        show(visualizer, None, heartbeat(f"agent{number}"))
    with pytest.raises(SfglabError, match="256 agents at most"):
        show(visualizer, None, heartbeat("another"))


def test_an_agents_status_is_told_with_its_description(paper):
    visualizer, root = made("agent_status"), "/agents/go2/status"
    event = default_message(EVENT, agent="go2")
    event.metadata.agent = "go2"
    for number in (event.DISCOVERED, event.LOST):
        event.event = number
        show(visualizer, paper, event)
    assert paper.values(f"{root}/log", "text") == [["go2 discovered"], ["go2 lost"]]
    assert paper.values(root, "state") == [["there"], ["lost"]]
    assert "agent: go2" in paper.values(f"{root}/description", "text")[0][0]


TOO_HIGH = image(BLUE, "bgr8")
TOO_HIGH.height = 400
UNKNOWN = image(BLUE, "yuv9")
FLAT, CUT = cloud(RECORDS[["x", "y"]].copy()), cloud(RECORDS)
CUT.data = CUT.data[:-1]
NOWHERE = default_message("geometry_msgs/msg/PoseStamped")
NOWHERE.pose.position.x = float("nan")


@pytest.mark.parametrize(
    ("kind", "messages", "error", "told"),
    [
        ("compressed_image", [coded(b"", "tiff")], SfglabError, "format: given 'tiff'"),
        ("compressed_image", [coded(b"", "h264")], NotShownError, "by compressed_image_v"),
        (
            "compressed_image_video",
            [coded(b"", "jpeg")],
            NotShownError,
            "compressed_image$",
        ),
        ("pose", [NOWHERE], SfglabError, "pose, position: given"),
        ("agent_heartbeats", [heartbeat("../../etc")], SfglabError, "agent"),
        ("agent_heartbeats", [default_message(BEAT)], SfglabError, "period_s"),
        ("agent_status", [default_message(EVENT, event=77)], SfglabError, "given 77"),
        (
            "depth_cloud",
            [DEPTH, camera_info(HEADER, (12, 8)), COLOR],
            SfglabError,
            "camera info, size: given '12 x 8', allowed: 6 x 4",
        ),
        (
            "depth_cloud",
            [DEPTH, camera_info(header_msg("rear", 0), (6, 4)), COLOR],
            SfglabError,
            "camera info, frame: given 'rear', allowed: 'camera'",
        ),
        ("image", [TOO_HIGH], SfglabError, "data: given '72 bytes with step 18'"),
        ("image", [UNKNOWN], SfglabError, "encoding: given 'yuv9', allowed: mono8"),
        ("camera_info", [default_message(CAMERA_INFO.__msgtype__)], SfglabError, "focal"),
        ("point_cloud", [FLAT], SfglabError, "given 'x, y', allowed: x, y, z"),
        ("point_cloud", [CUT], SfglabError, "point cloud data"),
        (
            "point_cloud",
            [cloud(RECORDS)],
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
        show(visualizer, paper, *messages)
    visualizer.tick(S, paper)
    assert paper.drawn == []

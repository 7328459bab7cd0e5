"""Make the screenshots of the documentation from what is in the repository: ``make screenshots``.

    python tools/screenshots.py figures                   # all
    python tools/screenshots.py figures planner_editor    # or viewer

The first shows the scene editor of paper A, section 4.5 (Fig. 7), with a conflict. The second shows a
fleet in `sfglab view`. Both programs run without a window. The viewer needs a Vulkan driver. A driver
that draws in software is enough, such as Mesa's lavapipe (the package ``mesa-vulkan-drivers``).
"""

from __future__ import annotations

import io
import math
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import closing, contextmanager, suppress
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np
from browser import Browser

from sfglab.codecs import COMPRESSED_IMAGE, compressed_depth_fields, compressed_image_fields
from sfglab.errors import InvalidValueError, SfglabError
from sfglab.fleet.fleet_file import load_fleet
from sfglab.lab.experiments.visualisation.points import (
    CAMERA,
    PERIOD_NS,
    SIZE,
    START_NS,
    Moment,
    camera_info,
    image_message,
    scene_moments,
)
from sfglab.lab.paths import find_project
from sfglab.lab.testbed import free_port
from sfglab.messages import default_message, message_type, serialize
from sfglab.spatial.poses import Pose, StampedTransform
from sfglab.spatial.scene.editor import Editor
from sfglab.spatial.scene.model import SceneError
from sfglab.view.arrivals import Arrival
from sfglab.view.planner.server import Planner
from sfglab.view.rerunning import blueprint, layout_of_fleet, open_canvas
from sfglab.view.session import Session
from sfglab.view.stage import replay

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from sfglab.spatial.scene.tree import Scene


def main(folder: Path, names: Sequence[str] = ()) -> None:
    """Make some of the screenshots, all without names."""
    makers = {"planner_editor": planner_editor, "viewer": viewer}
    for name in names:
        if name not in makers:
            raise InvalidValueError("screenshot", name, ", ".join(makers))
    folder.mkdir(parents=True, exist_ok=True)
    for name in names or makers:
        makers[name](folder / f"{name}.png")


# --- The editor -----------------------------------------------------------------------------------------------

_SIZE = (1400, 800)
_TIME_S = 3.2
_SETTLED_S = 3.0
_FADED_IN = "getComputedStyle(document.querySelector('canvas')).opacity === '1'"
_CLOSE_NOTE = "document.querySelector('.mantine-Notification-closeButton')?.click()"
_DRONE_PATH, _DRONE_ACROSS, _DRONE_LAST, _LOW_M = 14, 17, 18, 0.6
_SLOWER = 2.1


def planner_editor(file: Path) -> None:
    """Write what the editor shows of the hall, its conflict included, into a PNG file."""
    scene = find_project().data / "scenes/hall.yaml"
    if not scene.exists():
        raise SceneError(
            "scene", str(scene), "a scene file; run this in the repository's own folder"
        )
    with Planner(Editor.open(scene)) as planner, closing(Browser(*_SIZE)) as browser:
        planner.call(with_conflict)
        browser.open(planner.url)
        browser.find("Save *")
        browser.evaluate(_CLOSE_NOTE)
        browser.wait_for("document.body.innerText.includes('conflict')")
        browser.wait_for(_FADED_IN)
        time.sleep(_SETTLED_S)  # panels slide in, and the first frame is drawn in software
        browser.screenshot(file)
    image = cv2.imread(str(file))
    assert image is not None  # it was written a moment ago
    cv2.imwrite(
        str(file), image, [cv2.IMWRITE_PNG_COMPRESSION, 9]
    )  # as small as it gets without loss


def with_conflict(editor: Editor) -> Scene:
    """Let the drone cross later and lower, where the dog then is; select its last waypoint."""
    place = editor.scene.get(_DRONE_ACROSS).pose
    x, y, _ = place.position_m
    low = Pose(position_m=(x, y, _LOW_M), quat_xyzw=place.quat_xyzw)
    editor.begin_drag()
    for waypoint in reversed(editor.scene.waypoints(_DRONE_PATH)):
        editor.set_waypoint_time(waypoint.id, round(_SLOWER * waypoint.time_ns))
    editor.set_pose(_DRONE_ACROSS, low)
    editor.end_drag()
    editor.select(_DRONE_LAST)
    editor.set_time(_TIME_S)
    return editor.scene


# --- The viewer -----------------------------------------------------------------------------------------------

_MOMENTS = 40
_WINDOW = "1600x900"
_READY_S, _PAINT_S = 30.0, 8.0
_HIDDEN = (
    "ui.toggle_top_panel",
    "ui.toggle_blueprint_panel",
    "ui.toggle_selection_panel",
    "recording.toggle_time_panel",
)
_DRIVERS = ("/usr/share/vulkan/icd.d", "/etc/vulkan/icd.d", "/usr/local/share/vulkan/icd.d")
_NAMED_DRIVERS = ("VK_DRIVER_FILES", "VK_ICD_FILENAMES", "VK_ADD_DRIVER_FILES")

_FRONT = "/global/go2/camera_front"
_PICTURE = "/local/go2/camera_front/color/image_raw"
_LOST = "pi3"
_PLACES = {
    "pi1": (1.0, 2.6),
    "pi2": (3.2, 3.4),
    "pi3": (-1.6, 1.6),
    "steamdeck": (-1.2, -1.2),
    "workstation": (1.2, -2.4),
}
#: A camera that looks ahead: z forward, x right, y down (REP 103), as xyzw.
_OPTICAL = (-0.5, 0.5, -0.5, 0.5)


def viewer(to: Path) -> None:
    """Write what the viewer shows of a fleet into a PNG file."""
    with TemporaryDirectory(prefix="sfglab-viewer-") as folder:
        recording = Path(folder) / "fleet.rrd"
        _check_driver()
        record_fleet(recording)
        take_picture(recording, to)


def record_fleet(path: Path) -> None:
    """Write a recording (``.rrd``) of a robot with its camera among a fleet's agents, one of them lost."""
    file = find_project().data / "fleets/lab.yaml"
    layout = layout_of_fleet(load_fleet(file))
    entity = "/agents/go2/global/camera_front"
    cameras = {
        "go2 camera_front": f"{entity}/color/compressed",
        "go2 camera_front, depth": f"{entity}/aligned_depth/compressed_depth",
    }
    with closing(open_canvas([str(path)], title="a fleet")) as canvas:
        canvas.recording.send_blueprint(blueprint(replace(layout, cameras=cameras)))
        replay(_arrivals(), _session(), canvas)


def _session() -> Session:
    session = Session()
    depth, info = f"{_FRONT}/aligned_depth/compressed_depth", f"{_FRONT}/aligned_depth/camera_info"
    topics = {"depth": depth, "info": info, "color": _PICTURE}
    session.add("compressed_depth_cloud", topics, {"radius_m": 0.02, "decimation": 3})
    for kind, topic in (
        ("compressed_image", f"{_FRONT}/color/compressed"),
        ("compressed_image", depth),
        ("camera_info", info),
        ("camera_info", f"{_FRONT}/color/camera_info"),
        ("tf", "/tf"),
        ("tf_static", "/tf_static"),
        ("odometry", "/global/go2/localization/odometry"),
    ):
        session.add(kind, topic)
    session.add("agent_heartbeats", "/global/agent_heartbeat")
    for display in session.displays:
        session.limit(display.id, None)
    return session


def _arrivals() -> Iterator[Arrival]:
    for moment in scene_moments(_MOMENTS, seed=0):
        for topic, message in _messages(moment):
            yield Arrival(topic, message.__msgtype__, moment.stamp_ns, serialize(message))


def _messages(moment: Moment) -> Iterator[tuple[str, Any]]:
    header = moment.header(CAMERA)
    if moment.number == 0:
        eye = ("go2/base", CAMERA, Pose.at((0.3, 0.0, 0.4), _OPTICAL))
        yield "/tf_static", _transforms(moment, [eye])
    angle = 0.3 * math.sin(moment.number / 10) - 0.15
    base = ("map", "go2/base", Pose.from_yaw(_way(moment), angle))
    others = [("map", f"{name}/base", Pose.at((*place, 0.0))) for name, place in _PLACES.items()]
    yield "/tf", _transforms(moment, [base, *others])
    odometry = default_message("nav_msgs/msg/Odometry", header=moment.header("map"))
    odometry.pose.pose = Pose.at(_way(moment)).to_pose_msg()
    yield "/global/go2/localization/odometry", odometry
    yield from _heartbeats(moment)
    yield _PICTURE, image_message(moment.rgb, "rgb8", header)
    jpeg = compressed_image_fields(np.ascontiguousarray(moment.rgb[..., ::-1]))
    yield f"{_FRONT}/color/compressed", _compressed(jpeg, header)
    for stream in ("color", "aligned_depth"):
        yield f"{_FRONT}/{stream}/camera_info", camera_info(header, SIZE)
    depth = compressed_depth_fields(moment.depth_mm)
    yield f"{_FRONT}/aligned_depth/compressed_depth", _compressed(depth, header)


def _transforms(moment: Moment, edges: Sequence[tuple[str, str, Pose]]) -> Any:
    """Return a ``TFMessage`` of a moment; an edge is parent, child, and the child's pose in it."""
    found = []
    for parent, child, pose in edges:
        placed = StampedTransform(parent=parent, child=child, stamp_ns=moment.stamp_ns, pose=pose)
        found.append(placed.to_msg())
    return message_type("tf2_msgs/msg/TFMessage")(transforms=found)


def _compressed(fields: Any, header: Any) -> Any:
    """Return a ``CompressedImage`` of an encoder's fields."""
    data = np.frombuffer(fields.data, np.uint8)
    return message_type(COMPRESSED_IMAGE)(header=header, format=fields.format, data=data)


def _way(moment: Moment) -> tuple[float, float, float]:
    return (-1.0 + moment.number / 40, 0.3 * math.sin(moment.number / 8), 0.0)


def _heartbeats(moment: Moment) -> Iterator[tuple[str, Any]]:
    """Yield the heartbeat of each agent, five times a second; one agent stops after the first second."""
    lost = (moment.stamp_ns - START_NS) * 1e-9 > 1.0
    for name in ("go2", *_PLACES) if moment.number % 2 == 0 else ():
        if name == _LOST and lost:
            continue
        beat = default_message("sfglab_interfaces/msg/AgentHeartbeat")
        beat.agent, beat.period_s, beat.incarnation, beat.phase = (
            name,
            2 * PERIOD_NS * 1e-9,
            1,
            beat.STEADY,
        )
        yield "/global/agent_heartbeat", beat


def _check_driver() -> None:
    named = [name for name in _NAMED_DRIVERS if os.environ.get(name)]
    if not named and not any(found for folder in _DRIVERS for found in Path(folder).glob("*.json")):
        raise SfglabError(
            "the viewer needs a Vulkan driver, such as the package mesa-vulkan-drivers: there is none in "
            + ", ".join(_DRIVERS)
        )


def take_picture(recording: Path, to: Path) -> None:
    """Open a ``.rrd`` recording in a viewer without a window, go to its end, and save what it shows as PNG.

    Raises:
        SfglabError: The viewer does not start.
    """
    from PIL import Image
    from rerun.experimental import ViewerClient

    port = free_port()
    with _viewer(recording, port) as process:
        client = _connected(ViewerClient, process, port)
        end_ns = START_NS + (_MOMENTS - 1) * PERIOD_NS
        client.set_time("received", timestamp=np.datetime64(end_ns, "ns"), play_state="paused")
        for part in _HIDDEN:
            client.run_command(part)
        time.sleep(_PAINT_S)  # pictures are decoded and views settle; nothing tells when they have
        picture = Image.open(io.BytesIO(client.take_screenshot())).convert("RGB")
        # With a palette: dark areas and few colours need no more, and it is a third of the size.
        picture.quantize(256, kmeans=4).save(to, optimize=True)


@contextmanager
def _viewer(recording: Path, port: int) -> Iterator[subprocess.Popen[bytes]]:
    path = os.pathsep.join((str(Path(sys.executable).parent), os.environ.get("PATH", "")))
    program = shutil.which("rerun", path=path)
    if program is None:
        raise SfglabError("the viewer needs the program 'rerun': pip install '.[view]'")
    options = (
        "--headless",
        "--renderer",
        "vulkan",
        "--hide-welcome-screen",
        "--window-size",
        _WINDOW,
    )
    command = [program, *options, "--bind", "127.0.0.1", "--port", str(port), str(recording)]
    quiet: dict[str, Any] = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    with subprocess.Popen(command, **quiet, start_new_session=True) as process:
        try:
            yield process
        finally:
            with suppress(ProcessLookupError):  # the program starts another one and waits for it
                os.killpg(process.pid, signal.SIGTERM)


def _connected(client: Any, process: subprocess.Popen[bytes], port: int) -> Any:
    """Return a connection to the viewer once it has the recording."""
    end_s = time.monotonic() + _READY_S
    while time.monotonic() < end_s and process.poll() is None:
        try:
            found = client.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            if found.get_state().recordings:
                return found
        except (RuntimeError, ConnectionError, TimeoutError):
            pass
        time.sleep(0.5)
    raise SfglabError(
        "the viewer does not start without a window: it needs a Vulkan driver that works, such as the package "
        "mesa-vulkan-drivers"
    )


if __name__ == "__main__":
    try:
        main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path("figures"), sys.argv[2:])
    except SfglabError as error:
        sys.exit(f"sfglab: {error}")

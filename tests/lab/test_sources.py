"""Sources: the same frames for the same seed, metric depth, one's own material."""

from contextlib import closing
from pathlib import Path

import cv2
import numpy as np
import pytest
from skimage import data

from sfglab.lab import sources
from sfglab.messages import default_message
from sfglab.record import LogWriter


def frames(spec: str, count: int, **options) -> list:
    with closing(sources.open_source(spec, **options)) as source:
        return [source.frame() for _ in range(count)]


def test_photographs_move_and_are_the_same_for_the_same_seed():
    first, again, other = frames("photos", 5), frames("photos", 5), frames("photos", 5, seed=1)
    assert all(np.array_equal(a.bgr, b.bgr) for a, b in zip(first, again, strict=True))
    assert not np.array_equal(first[0].bgr, other[0].bgr)
    assert not np.array_equal(first[0].bgr, first[4].bgr)


def test_the_stereo_pair_gives_depth_from_its_measured_disparity():
    depth = frames("stereo", 1)[0].depth_mm
    assert depth.shape == (360, 640)
    assert depth.dtype == np.uint16
    _, _, disparity = data.stereo_motorcycle()
    known = disparity[np.isfinite(disparity)]
    optics = sources.MOTORCYCLE_FOCAL_PX * sources.MOTORCYCLE_BASELINE_MM
    far, near = (optics / (d + sources.MOTORCYCLE_OFFSET_PX) for d in (known.min(), known.max()))
    assert near - 1 <= depth[depth > 0].min() <= depth.max() <= far + 1
    assert 0.01 < (depth == 0).mean() < 0.3, "places without disparity stay unknown"


def video(folder, width: int, fps: int) -> str:
    """A file of three grey pictures."""
    path = str(folder / "clip.avi")
    writer = cv2.VideoWriter(path, cv2.VideoWriter_fourcc(*"MJPG"), fps, (width, 180))
    for level in (40, 120, 200):
        writer.write(np.full((180, width, 3), level, dtype=np.uint8))
    writer.release()
    return path


def test_a_video_keeps_its_speed_and_its_shape_and_it_is_said(tmp_path):
    path = video(tmp_path, 90, 15)
    seen = [f.bgr for f in frames(path, 8)]
    middle = [picture[180, 320].mean() for picture in seen]
    assert np.allclose(middle, [40, 40, 120, 120, 200, 200, 40, 40], atol=6)
    assert not seen[0][:, [*range(230), *range(410, 640)]].any(), "black bars"
    middle = [f.bgr[180, 320].mean() for f in frames(path, 3, fps=7.5)]
    assert np.allclose(middle, [40, 200, 120], atol=6)
    assert sources.is_there(path) == (
        f"{path}: 90 x 180 at 15 Hz, shown as 640 x 360 between black bars at 30 Hz: "
        "pictures are repeated, its speed is kept"
    )


def test_a_bag_with_raw_images_is_read(tmp_path):
    path = tmp_path / "bag.mcap"
    with LogWriter(path) as log:
        for i, encoding in enumerate(("bgr8", "rgb8", "mono8")):
            channels = 1 if encoding == "mono8" else 3
            image = default_message("sensor_msgs/msg/Image", height=90, width=160)
            image.encoding, image.step = encoding, 160 * channels
            image.data = np.tile(np.arange(10, 10 + channels, dtype=np.uint8), 90 * 160)
            log.write("/camera/image_raw", image, log_time_ns=i)
    for spec in (f"bag:{path}#/camera/image_raw", str(path)):
        colours = [tuple(f.bgr[5, 5]) for f in frames(spec, 4)]
        assert colours == [(10, 11, 12), (12, 11, 10), (10, 10, 10), (10, 11, 12)]


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("nothing.mp4", "no such file; allowed: photos"),
        ("camera:99", "cannot be opened"),
        ("bag:run.mcap", "no such file"),
        ("text.mp4", "cannot be opened as video|holds no image"),
        ("bag:bag.mcap#/camera", "allowed: none, because no topic has images"),
        ("bag:bag.mcap#/hello", "no images"),
    ],
)
def test_what_cannot_be_opened_is_refused_with_what_is_allowed(
    spec, message, tmp_path, monkeypatch, capfd
):
    monkeypatch.chdir(tmp_path)
    Path("text.mp4").write_text("no video")
    with LogWriter(Path("bag.mcap")) as log:
        log.write("/hello", default_message("std_msgs/msg/String"), log_time_ns=0)
    with pytest.raises(sources.SourceError, match=message):
        frames(spec, 1)

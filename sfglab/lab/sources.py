"""Sources of an experiment's video: photographs, a stereo pair, or the user's own material.

A source is a stream of frames of one size: colour (BGR) and, if the material has it, depth in millimetres.
The default moves and zooms over photographs that scikit-image contains; equal seeds give equal frames. A
video file and a bag keep their speed and aspect ratio. For that, frames are repeated or skipped, and get
black bars if the experiment's aspect ratio differs. A camera always gives its next frame.
"""

from __future__ import annotations

import itertools
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.codecs import FFMPEG_PACKET, CodecUnavailableError, image_decoder
from sfglab.errors import SfglabError
from sfglab.record import LogError, LogReader
from sfglab.record.bags import is_log
from sfglab.record.reader import rate_and_size

if TYPE_CHECKING:
    from collections.abc import Callable, Generator

    from numpy.typing import NDArray

    Image = NDArray[np.uint8]
    Images = Generator[Image, None, None]

PHOTOGRAPHS = ("coffee", "astronaut", "chelsea", "rocket")

# Calibration of the pair from scikit-image's documentation (`skimage.data.stereo_motorcycle`), from D.
# Scharstein et al., GCPR 2014.
MOTORCYCLE_FOCAL_PX = 994.978
MOTORCYCLE_BASELINE_MM = 193.001
MOTORCYCLE_OFFSET_PX = 31.086

SECONDS_A_VIEW = 4.0
_SAME_RATE = 1e-3  #: Relative difference up to which two rates are equal, such as 30 and 29.97 Hz.
#: Highest rate of a video, Hz; containers without a rate give that of their clock.
_MOST_HZ = 1000.0
_PICTURES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage", FFMPEG_PACKET)


class SourceError(SfglabError, ValueError):
    """Error of a source that does not exist, cannot be read or has no frames."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Frame:
    """One frame of a source: a colour image, and a depth image if there is one."""

    bgr: NDArray[Any]  #: Colour image, shape (H, W, 3), uint8.
    #: Depth in millimetres, shape (H, W), uint16, 0 where unknown; None if the material has no depth.
    depth_mm: NDArray[Any] | None = None


class Source:
    """A stream of frames of one size that starts again at its end."""

    def __init__(self, frames: Generator[Frame, None, None], *, said: str = "") -> None:
        #: Sentence about the conversion of the user's own material; empty for the default.
        self.said = said
        self._frames = frames

    def frame(self) -> Frame:
        """Return the next frame; after the last one, the first frame again."""
        return next(self._frames)

    def close(self) -> None:
        """Close the source's file or device."""
        self._frames.close()


def open_source(
    spec: str, *, width: int = 640, height: int = 360, fps: float = 30.0, seed: int = 0
) -> Source:
    """Open a source of frames by its name.

    Names are ``photos`` (default material), ``stereo`` (with depth), ``camera:0``, ``bag:PATH#/topic``, or
    the path of a video file, or of a log or a bag with exactly one topic of images.

    Args:
        spec: Name of the source.
        width: Pixels per row of each frame.
        height: Rows of each frame.
        fps: Frames per second; for the included material it determines the speed of the motion.
        seed: Seed of the motion's path over the included material.

    Raises:
        SourceError: The source cannot be read.
    """
    size = (width, height)
    if spec in ("photos", "stereo"):
        stills = _stereo_stills() if spec == "stereo" else _photograph_stills()
        return Source(_panned(stills, size, view_frames=round(SECONDS_A_VIEW * fps), seed=seed))
    is_bag = spec.startswith("bag:") or (not spec.startswith("camera:") and is_log(Path(spec)))
    images_of = _bag_images if is_bag else _video_images
    rate_hz, images = images_of(spec)
    if abs(rate_hz - fps) <= _SAME_RATE * fps:
        rate_hz = fps
    elif rate_hz >= _MOST_HZ:
        rate_hz = 0.0  # unknown
    step = rate_hz / fps if rate_hz else 1.0
    first = next(images, None)
    if first is None:
        raise SourceError(f"source {spec!r}: it holds no image; give another source")
    looped = _looped(lambda: images_of(spec)[1], first, images, size, step)
    return Source(looped, said=_said(spec, first.shape, size, rate_hz, fps))


def is_there(spec: str) -> str:
    """Return the sentence about a source's conversion, as in `Source.said`, after reading its first frame.

    Raises:
        SourceError: The source is unknown, missing or unreadable.
    """
    if spec in ("", "photos", "stereo"):
        return ""
    source = open_source(spec)
    source.close()
    return source.said


def absolute(spec: str) -> str:
    """Return a source's name with an absolute path, for processes in another working folder."""
    kind, colon, path = spec.rpartition("bag:")
    if spec in ("", "photos", "stereo") or spec.startswith("camera:"):
        return spec
    return f"{kind}{colon}{Path(path).absolute()}"


def _said(
    spec: str, shape: tuple[int, ...], size: tuple[int, int], rate_hz: float, fps: float
) -> str:
    height, width = shape[:2]
    rate = f" at {rate_hz:.4g} Hz" if rate_hz else ""
    has_bars = abs(width * size[1] - height * size[0]) >= max(size)
    shown = f"{size[0]} x {size[1]}{' between black bars' if has_bars else ''} at {fps:g} Hz"
    said = f"{spec}: {width} x {height}{rate}, shown as {shown}"
    if rate_hz in (0, fps):
        return said
    return (
        f"{said}: pictures are {'repeated' if rate_hz < fps else 'passed over'}, its speed is kept"
    )


def _panned(
    stills: list[Frame], size: tuple[int, int], *, view_frames: int, seed: int
) -> Generator[Frame, None, None]:
    """Yield frames of a window that moves and zooms over still images; frame n is a function of n and the seed."""
    import cv2

    for number in itertools.count():
        view, step = divmod(number, view_frames)
        still = stills[view % len(stills)]
        warp = _view_transform(still.bgr.shape[:2], size, step / view_frames, (seed, view))
        bgr = cv2.warpAffine(still.bgr, warp, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
        depth: NDArray[Any] | None = None
        if still.depth_mm is not None:
            # Depths are not interpolated, because nothing is at the mean of two depths.
            flags = cv2.INTER_NEAREST | cv2.WARP_INVERSE_MAP
            depth = cv2.warpAffine(still.depth_mm, warp, size, flags=flags)
        yield Frame(bgr=bgr, depth_mm=depth)


def _view_transform(
    still: tuple[int, ...], size: tuple[int, int], progress: float, seed: tuple[int, int]
) -> NDArray[np.float64]:
    """Return the affine map from output pixels to still pixels at a point of a pan-and-zoom move."""
    rng = np.random.default_rng(seed)
    height, width = still[:2]
    largest = min(width / size[0], height / size[1])
    zooms = largest * rng.uniform(0.6, 1.0, 2)
    places = rng.uniform(0.0, 1.0, (2, 2))
    zoom = zooms[0] + (zooms[1] - zooms[0]) * progress
    place = places[0] + (places[1] - places[0]) * progress
    left = place[0] * (width - zoom * size[0])
    top = place[1] * (height - zoom * size[1])
    return np.array([[zoom, 0.0, left], [0.0, zoom, top]])


def _photograph_stills() -> list[Frame]:
    from skimage import data

    photographs = [getattr(data, name)() for name in PHOTOGRAPHS]
    return [Frame(bgr=np.ascontiguousarray(rgb[..., 2::-1])) for rgb in photographs]


def _stereo_stills() -> list[Frame]:
    from skimage import data

    left, _, disparity = data.stereo_motorcycle()
    known = np.isfinite(disparity)
    depth = np.zeros(disparity.shape)
    depth[known] = (
        MOTORCYCLE_FOCAL_PX * MOTORCYCLE_BASELINE_MM / (disparity[known] + MOTORCYCLE_OFFSET_PX)
    )
    bgr = np.ascontiguousarray(left[..., ::-1])
    return [Frame(bgr=bgr, depth_mm=np.round(depth).astype(np.uint16))]


def _looped(
    again: Callable[[], Images], image: Image, images: Images, size: tuple[int, int], step: float
) -> Generator[Frame, None, None]:
    """Yield frames of a size, each `step` images after the last one; the source starts again at its end."""
    at, fitted = 0, _fitted(image, size)
    try:
        for number in itertools.count():
            wanted = int(number * step + _SAME_RATE)
            while at < wanted:
                following = next(images, None)
                if following is None:
                    images = again()
                    following = next(images, image)
                image, at = following, at + 1
                fitted = _fitted(image, size) if at == wanted else fitted
            yield Frame(bgr=fitted)
    finally:
        images.close()


def _fitted(image: Image, size: tuple[int, int]) -> Image:
    """Scale an image into a size, centred, with its aspect ratio."""
    import cv2

    height, width = image.shape[:2]
    scale = min(size[0] / width, size[1] / height)
    inner = min(size[0], round(width * scale)), min(size[1], round(height * scale))
    left, top = (size[0] - inner[0]) // 2, (size[1] - inner[1]) // 2
    fitted = np.zeros((size[1], size[0], 3), np.uint8)
    place = np.s_[top : top + inner[1], left : left + inner[0]]
    fitted[place] = cv2.resize(image, inner, interpolation=cv2.INTER_AREA)
    return fitted


def _video_images(spec: str) -> tuple[float, Images]:
    """Open a video file or a camera: its rate in Hz, 0 for a camera, and its images (BGR)."""
    is_camera = spec.startswith("camera:")
    index = spec.removeprefix("camera:")
    if is_camera and not index.isdigit():
        raise SourceError(f"source {spec!r}: allowed for a camera: camera:0, camera:1, ...")
    if not is_camera and not Path(spec).is_file():
        raise SourceError(
            f"source {spec!r}: no such file; allowed: photos, stereo, camera:N, bag:PATH#/topic "
            "or the path of a video file"
        )
    import cv2

    # Errors of OpenCV are silenced, because this module reports them.
    cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_SILENT)
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")
    capture = cv2.VideoCapture(int(index) if is_camera else spec)
    if not capture.isOpened():
        capture.release()
        raise SourceError(
            f"source {spec!r}: it cannot be opened as video; give a connected camera or a video file"
        )

    def images() -> Images:
        try:
            while (read := capture.read())[0]:
                yield np.asarray(read[1], dtype=np.uint8)
        finally:
            capture.release()

    rate_hz = 0.0 if is_camera else capture.get(cv2.CAP_PROP_FPS)
    return max(rate_hz, 0.0), images()


def _bag_images(spec: str) -> tuple[float, Images]:
    """Open one topic of an MCAP log or bag: its mean rate in Hz, 0 if it has none, and its images (BGR)."""
    path, _, topic = spec.removeprefix("bag:").partition("#")
    try:
        opened = LogReader(Path(path))
    except LogError as error:
        raise SourceError(f"source {spec!r}: {error}") from error
    with opened as log:
        seen = [name for name, info in log.topics.items() if info.type_name in _PICTURES]
        if not topic and len(seen) != 1:
            there = (
                ", ".join(f"bag:{path}#{name}" for name in seen)
                or "none, because no topic has images"
            )
            raise SourceError(f"source {spec!r}: name one topic with images; allowed: {there}")
        topic = topic or seen[0]
        if topic not in log.topics:
            known = ", ".join(sorted(seen)) or "none, because no topic has images"
            raise SourceError(f"source {spec!r}: there is no topic {topic!r}; allowed: {known}")
        type_name = log.topics[topic].type_name
        rate_hz, _ = rate_and_size(log.first(topic))

    def images() -> Images:
        with LogReader(Path(path)) as log:
            bgr_images = _bgr_reader(type_name, spec)
            for entry in log.decoded(topic):
                yield from bgr_images(entry.message)

    return rate_hz, images()


def _bgr_reader(type_name: str, spec: str) -> Callable[[Any], list[Image]]:
    """Return a function from one message to its colour images (BGR)."""
    if type_name == "sensor_msgs/msg/Image":
        return lambda message: [_bgr_of_image(message, spec)]
    try:
        decoder = image_decoder(type_name)
    except CodecUnavailableError as error:
        raise SourceError(f"source {spec!r}: {error}") from error
    return lambda message: [i.array for i in decoder.feed(message) if i.encoding == "bgr8"]


#: Positions of blue, green and red in a pixel, by encoding.
_ORDERS = {
    "bgr8": [0, 1, 2],
    "rgb8": [2, 1, 0],
    "bgra8": [0, 1, 2],
    "rgba8": [2, 1, 0],
    "mono8": [0, 0, 0],
}


def _bgr_of_image(message: Any, spec: str) -> Image:
    from sfglab.view.geometry import pixels

    if message.encoding not in _ORDERS:
        known = ", ".join(_ORDERS)
        raise SourceError(f"source {spec!r}: given encoding {message.encoding!r}, allowed: {known}")
    channels = pixels(message).reshape(message.height, message.width, -1)
    return np.ascontiguousarray(channels[..., _ORDERS[message.encoding]])

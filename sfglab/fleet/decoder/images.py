"""A decoded picture as the bytes of a ``sensor_msgs/msg/Image``, written once, where it is read.

``data`` is the last member of the message, so everything before the pixels can be serialised on its own
and the pixels copied behind it: into shared memory, or into one bytes object for DDS.
"""

from __future__ import annotations

import functools
import struct
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.messages import default_message, serialize

if TYPE_CHECKING:
    from numpy.typing import NDArray


def image_prefix(header: Any, pixels: NDArray[np.generic], encoding: str) -> bytes:
    """Return the CDR of an Image up to its first pixel.

    Args:
        header: A ``std_msgs/msg/Header``.
        pixels: Shape (H, W) or (H, W, channels), C order.
        encoding: The ROS name of the pixel format, such as ``bgr8`` or ``16UC1``.
    """
    prefix = _prefix(header.frame_id, encoding, pixels.shape[:2], pixels.strides[0], pixels.nbytes)
    # From picture to picture only the stamp changes, which stands behind the 4 bytes of the CDR header; to
    # serialise all of it anew takes ten times as long as to write it into its place.
    stamp = struct.pack("<iI", header.stamp.sec, header.stamp.nanosec)
    return prefix[:4] + stamp + prefix[4 + len(stamp) :]


@functools.lru_cache(maxsize=64)
def _prefix(frame_id: str, encoding: str, shape: tuple[int, ...], step: int, size_bytes: int) -> bytes:
    image = default_message("sensor_msgs/msg/Image")
    image.header.frame_id = frame_id
    image.height, image.width = shape
    image.encoding = encoding
    image.is_bigendian = 0
    image.step = step
    # An empty sequence ends in its length, a 4-byte aligned uint32: put the real one there.
    return serialize(image)[:-4] + struct.pack("<I", size_bytes)


def write_image(buffer: Any, prefix: bytes, pixels: NDArray[np.generic]) -> None:
    """Write an Image into a buffer of exactly ``len(prefix) + pixels.nbytes`` bytes."""
    view = np.frombuffer(buffer, dtype=np.uint8)
    view[: len(prefix)] = np.frombuffer(prefix, dtype=np.uint8)
    view[len(prefix) : len(prefix) + pixels.nbytes] = pixels.reshape(-1).view(np.uint8)


def image_bytes(prefix: bytes, pixels: NDArray[np.generic]) -> bytes:
    """Return a whole Image, padded to four bytes as the middleware needs it."""
    body = prefix + pixels.tobytes()
    return body + bytes(-len(body) % 4)

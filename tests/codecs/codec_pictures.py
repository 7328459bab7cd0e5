"""Pictures for the codecs, made here."""

import numpy as np


def moving_picture(index: int, *, width: int = 640, height: int = 360) -> np.ndarray:
    """A textured plane that slides by three pixels a frame, and a bright square that runs across it."""
    rows, columns = np.mgrid[0:height, 0:width]
    columns = columns + 3 * index
    picture = np.stack(
        [
            128 + 80 * np.sin(columns / 17) * np.cos(rows / 23),
            128 + 60 * np.sin(columns / 7 + rows / 11),
            (columns ^ rows) & 127,
        ],
        axis=-1,
    ).astype(np.uint8)
    left = 8 * index % (width - 32)
    picture[32:64, left : left + 32] = 255
    return picture

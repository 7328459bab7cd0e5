"""A budget of latency to turn: coding timed here and now, what follows from rates computed.

Apart from the analysis, which knows nothing but a run.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sfglab.codecs import TABLE_2, H264Decoder, H264Encoder
from sfglab.lab.experiment import Look
from sfglab.lab.experiments.latency.analysis import BAR_COLORS
from sfglab.lab.experiments.latency.experiment import Config, exp
from sfglab.lab.figures import COLORS
from sfglab.lab.sources import open_source
from sfglab.units import NS_PER_MS

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sfglab.lab.runs import Run

_CODED = 30
_STAGES = {"encoding": "third", "network": "network", "decoding": "standard"}


@exp.look(
    "budget",
    Look(
        turn=("gop", "bitrate_mbit_s", "link_mbit_s"),
        needs=(),
        size=(10, 3.6),
        start={"encoder": "libx264"},  # finding the best one takes seconds
        reference="latency",
    ),
)
def draw_budget(figure: Figure, run: Run[Config]) -> None:
    """Draw where the milliseconds go: coding is timed here and now, the rest follows from rates.

    Until the first picture, *standard* waits for the next key frame; with the sender's replay the pictures
    since the last one are sent and decoded at once.
    """
    config = run.config
    size_bytes, encoding_ms, decoding_ms = _coded(config)
    sending_ms = 8e-3 * size_bytes / config.link_mbit_s
    glass, first = figure.subplots(1, 2)
    left = 0.0
    for (stage, color), taken in zip(_STAGES.items(), (encoding_ms, sending_ms, decoding_ms), strict=True):
        glass.barh("a picture", taken, left=left, color=COLORS[color], label=f"{stage} {taken:.1f} ms")
        left += taken
    glass.set(xlabel="time (ms)", ylim=(-0.6, 1.2), title=f"capture to pixels: {left:.1f} ms")
    glass.legend(fontsize=8)
    since = np.arange(config.gop)
    ways = {
        "standard": (config.gop - since) * 1e3 / TABLE_2.fps + sending_ms + decoding_ms,
        "agent": (since + 1) * (sending_ms + decoding_ms),
    }
    for path, label in (("standard", "waits for a key frame"), ("agent", "with replay")):
        named = f"{label}: {ways[path].mean():.0f} ms on average"
        first.plot(since, ways[path], ".-", color=BAR_COLORS[path], label=named)
    first.set(xlabel="frames since the last key frame", ylabel="first picture after (ms)", ylim=(0, None))
    first.legend(fontsize=8)
    figure.suptitle("A budget: coding timed on this machine, the rest computed; without waits for processes")


def _coded(config: Config) -> tuple[float, float, float]:
    """Return the mean size of a picture, bytes, and the median times to encode and to decode it, ms."""
    bitrate_bps = round(config.bitrate_mbit_s * 1e6)
    encoder = H264Encoder(replace(TABLE_2, bitrate_bps=bitrate_bps, gop=config.gop, encoder=config.encoder))
    decoder, source = H264Decoder(), open_source(config.source, seed=config.seed)
    rows = []
    for _ in range(_CODED):
        picture = source.frame().bgr
        started = time.perf_counter_ns()
        packets = encoder.encode(picture)
        encoded = time.perf_counter_ns()
        for packet in packets:
            decoder.decode_bgr(packet.data)
        size = sum(len(packet.data) for packet in packets)
        rows.append((size, (encoded - started) / NS_PER_MS, (time.perf_counter_ns() - encoded) / NS_PER_MS))
    source.close()
    sizes, encoding, decoding = np.array(rows).T
    return float(sizes.mean()), float(np.median(encoding)), float(np.median(decoding))

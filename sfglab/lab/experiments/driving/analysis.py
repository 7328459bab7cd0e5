"""From the log to numbers: the chain's time by reading and mapping, the drawn lap's pictures and stops.

Everything here is computed from the log alone.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.experiments.driving.config import MAPPINGS, PAPER_MS, READINGS
from sfglab.lab.experiments.driving.replay import IMAGE_TOPIC, MASK_TOPIC
from sfglab.lab.stats import bootstrap
from sfglab.record import LogReader
from sfglab.soc.driving import CHAIN, SHARED_TOPIC

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path

    import pandas as pd
    from numpy.typing import NDArray

    from sfglab.lab.stats import Estimate

    Floats = NDArray[np.float64]


_STORED = "stored"
_STANDING_MPS = 0.02
_MS = 1e3


@dataclass(frozen=True, slots=True, kw_only=True)
class Results:
    """The tables of one run."""

    laps: pd.DataFrame  #: One line a lap.
    chain: pd.DataFrame  #: One line a frame of the drive that the chain was timed in.
    nodes: pd.DataFrame  #: What the graph assumes of the chain's nodes.
    transfers: pd.DataFrame  #: The memory model's transfers.
    tracks: pd.DataFrame  #: The drawn lap's moments.
    town: dict[str, Any]  #: The drawn lap's town, see `town_metadata`.
    config: dict[str, Any]  #: The run's configuration.


@dataclass(frozen=True, slots=True, kw_only=True)
class Picture:
    """What the camera and the lane planner said at a moment of the drawn lap."""

    t_s: float  #: When.
    bgr: NDArray[np.uint8]  #: The camera's image, as small as the log has it.
    mask: NDArray[np.uint8]  #: The bird's view.


@dataclass(frozen=True, slots=True, kw_only=True)
class Stop:
    """A stop of the drawn lap: when it began, how long it was, where."""

    t_s: float
    lasted_s: float
    x_m: float
    y_m: float


def load_results(log: Path) -> Results:
    """Read a run's tables.

    Args:
        log: The log.
    """
    with LogReader(log) as reader:
        names = {"laps": "lap", "chain": "chain", "nodes": "node", "transfers": "transfer", "tracks": "track"}
        tables = {name: reader.table(table).drop(columns="log_time_ns") for name, table in names.items()}
        return Results(**tables, town=reader.metadata("town"), config=reader.metadata("config"))


def lines_of(table: pd.DataFrame) -> list[Any]:
    """Return a table's lines, each with its columns as attributes."""
    return list(table.itertuples())


def load_pictures(log: Path) -> list[Picture]:
    """Read the drawn lap's pictures.

    Args:
        log: The log.
    """
    import cv2

    with LogReader(log) as reader:
        pairs = zip(reader.decoded(IMAGE_TOPIC), reader.decoded(MASK_TOPIC), strict=True)
        return [
            Picture(
                t_s=image.log_time_ns / 1e9,
                bgr=np.asarray(cv2.imdecode(np.asarray(image.message.data), cv2.IMREAD_COLOR), np.uint8),
                mask=np.asarray(cv2.imdecode(np.asarray(mask.message.data), cv2.IMREAD_GRAYSCALE), np.uint8),
            )
            for image, mask in pairs
        ]


def parts_ms(results: Results, reading: str, mapping: str, *, forwarding: str = _STORED) -> dict[str, Floats]:
    """Return what the chain is made of, in its order: each node's and topic's milliseconds, frame by frame.

    Args:
        results: The run.
        reading: A name in `READINGS`: whose node times.
        mapping: One of `MAPPINGS`: what topic A is mapped to.
        forwarding: Whose constants; only those of the first set were drawn frame by frame, the other has means.
    """
    nodes, topics = _nodes_ms(results, reading), _topics_ms(results, mapping, forwarding)
    parts = {CHAIN[0]: nodes[CHAIN[0]]}
    for node, topic in zip(CHAIN[1:], topics, strict=True):
        parts |= {topic: topics[topic], node: nodes[node]}
    return parts


def _nodes_ms(results: Results, reading: str) -> dict[str, Floats]:
    """Return node times; where the graph assumes none in hardware, a node is as it was measured."""
    chosen = {}
    for row in lines_of(results.nodes):
        measured = results.chain[f"{row.node}_ns"].to_numpy(dtype=np.float64) / 1e6
        assumed = np.full(len(measured), row.hardware_s * _MS)
        chosen[row.node] = assumed if reading == "hardware" and row.in_hardware else measured
    return chosen


def _topics_ms(results: Results, mapping: str, forwarding: str) -> dict[str, Floats]:
    table = results.transfers[results.transfers["forwarding"] == forwarding]
    frames = len(results.chain)
    topics = {}
    for row in lines_of(table[table["mapping"].isin((mapping, "as placed"))]):
        topics[row.topic] = np.full(frames, row.mean_s * _MS)
    if forwarding == _STORED:
        column = "smt_s" if mapping == MAPPINGS[0] else "gateway_s"
        topics[SHARED_TOPIC] = results.chain[column].to_numpy(dtype=np.float64) * _MS
    return topics


def chain_ms(results: Results, reading: str = "hardware", **more: str) -> dict[str, Floats]:
    """Return the chain's time of every frame, in milliseconds, by what topic A is mapped to.

    Args:
        results: The run.
        reading: A name in `READINGS`.
        more: As for `parts_ms`.
    """
    return {
        mapping: np.sum(list(parts_ms(results, reading, mapping, **more).values()), axis=0)
        for mapping in MAPPINGS
    }


def ratio(results: Results, reading: str = "hardware") -> Estimate:
    """Return how many times as fast the chain is with a gateway: the ratio of means over the frames."""
    both = np.column_stack([chain_ms(results, reading)[mapping] for mapping in MAPPINGS])

    def of_means(drawn: Sequence[Floats]) -> float:
        software, gateway = drawn[0].mean(axis=0)
        return float(software / gateway)

    return bootstrap([both], of_means, unit="times as fast")


def saved_ms(results: Results) -> float:
    """Return by how many milliseconds topic A travels shorter through a gateway, in the mean over frames."""
    return float((results.chain["smt_s"] - results.chain["gateway_s"]).mean() * _MS)


def chain_table(results: Results) -> pd.DataFrame:
    """Return mean and standard deviation of the chain by reading and mapping, the paper's below, in ms."""
    import pandas as pd

    lines = []
    for reading, said in READINGS.items():
        times = chain_ms(results, reading)
        stats = {name: (ms.mean(), ms.std(ddof=1)) for name, ms in times.items()}
        lines.append(_line(said, stats))
    return pd.DataFrame([*lines, _line("paper C, section 6", PAPER_MS)]).set_index("node times")


def _line(said: str, stats: dict[str, tuple[float, float]]) -> dict[str, Any]:
    (smt, smt_sd), (gateway, gateway_sd) = stats["software"], stats["gateway"]
    return {
        "node times": said,
        "A in software (ms)": smt,
        "its deviation": smt_sd,
        "A with a gateway (ms)": gateway,
        "that's deviation": gateway_sd,
        "saved (ms)": smt - gateway,
        "times as fast": smt / gateway,
    }


def node_table(results: Results) -> pd.DataFrame:
    """Return the chain's node times: as the graph assumes them in hardware, and as measured here, in ms."""
    import pandas as pd

    measured = pd.DataFrame(
        {row.node: results.chain[f"{row.node}_ns"] / 1e6 for row in lines_of(results.nodes)}
    )
    return pd.DataFrame(
        {
            "in hardware, assumed": results.nodes.set_index("node")["hardware_s"] * _MS,
            "here, mean": measured.mean(),
            "here, deviation": measured.std(),
        }
    )


def stops(results: Results) -> list[Stop]:
    """Return where the drawn lap's car stood for a second and more, its start aside."""
    tracks = results.tracks
    standing = (tracks["speed_mps"] < _STANDING_MPS).to_numpy()
    group = np.cumsum(np.diff(standing, prepend=standing[:1]) != 0)
    found = []
    for _, part in tracks[standing].groupby(group[standing]):
        first, lasted = part.iloc[0], float(part["t_s"].iloc[-1] - part["t_s"].iloc[0])
        if lasted >= 1.0 and first["t_s"] > 1.0:
            found.append(Stop(t_s=first["t_s"], lasted_s=lasted, x_m=first["x_m"], y_m=first["y_m"]))
    return found

"""The chain's time by reading and mapping, the drawn lap's pictures and stops, and the claims on the chain."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.driving.experiment import (
    MAPPINGS,
    PAPER_MS,
    READINGS,
    Config,
    chain_of,
    exp,
)
from sfglab.lab.experiments.driving.lap import IMAGE_TOPIC, MASK_TOPIC
from sfglab.lab.runs import Run, derived, lines_of
from sfglab.lab.stats import Estimate, Floats, bootstrap, exactly, ratio_of
from sfglab.soc.driving import CHAIN, SHARED_TOPIC, Chain
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Sequence

    from numpy.typing import NDArray

_STORED = "stored"
_CUT_THROUGH = "cut-through"
_STANDING_MPS = 0.02
_FEWEST = 30  # pictures for a deviation
LIVE = "live across processes, all nodes in software"
_MS = 1e3


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


@derived
def pictures(run: Run[Config]) -> list[Picture]:
    """Read the drawn lap's pictures."""
    import cv2

    return [
        Picture(
            t_s=image.log_time_ns / NS_PER_S,
            bgr=np.asarray(
                cv2.imdecode(np.asarray(image.message.data), cv2.IMREAD_COLOR), np.uint8
            ),
            mask=np.asarray(
                cv2.imdecode(np.asarray(mask.message.data), cv2.IMREAD_GRAYSCALE), np.uint8
            ),
        )
        for image, mask in zip(run.messages(IMAGE_TOPIC), run.messages(MASK_TOPIC), strict=True)
    ]


@derived
def parts_ms(
    run: Run[Config], reading: str, mapping: str, *, forwarding: str = _STORED
) -> dict[str, Floats]:
    """Return what the chain is made of, in its order: each node's and topic's milliseconds, frame by frame.

    Node times are those of one of `READINGS`, topic A is mapped to one of `MAPPINGS`. Only the first set of the
    memory model's constants was drawn frame by frame, the other has means.
    """
    nodes, topics = _nodes_ms(run, reading), _topics_ms(run, mapping, forwarding)
    parts = {CHAIN[0]: nodes[CHAIN[0]]}
    for node, topic in zip(CHAIN[1:], topics, strict=True):
        parts |= {topic: topics[topic], node: nodes[node]}
    return parts


def _nodes_ms(run: Run[Config], reading: str) -> dict[str, Floats]:
    """Return node times; where the graph assumes none in hardware, a node is as it was measured."""
    chosen = {}
    for row in lines_of(run["node"]):
        measured = run["chain"][f"{row.node}_ns"].to_numpy(dtype=np.float64) / 1e6
        assumed = np.full(len(measured), row.hardware_s * _MS)
        chosen[row.node] = assumed if reading == "hardware" and row.in_hardware else measured
    return chosen


def _topics_ms(run: Run[Config], mapping: str, forwarding: str) -> dict[str, Floats]:
    table = run["transfer"][run["transfer"]["forwarding"] == forwarding]
    frames = len(run["chain"])
    topics = {}
    for row in lines_of(table[table["mapping"].isin((mapping, "as placed"))]):
        topics[row.topic] = np.full(frames, row.mean_s * _MS)
    if forwarding == _STORED:
        column = "smt_s" if mapping == MAPPINGS[0] else "gateway_s"
        topics[SHARED_TOPIC] = run["chain"][column].to_numpy(dtype=np.float64) * _MS
    return topics


def chain_ms(run: Run[Config], reading: str = "hardware", **more: str) -> dict[str, Floats]:
    """Return the chain's time of every frame, in milliseconds, by what topic A is mapped to; as `parts_ms`."""
    return {
        name: np.sum([*parts_ms(run, reading, name, **more).values()], axis=0) for name in MAPPINGS
    }


def live_ms(run: Run[Config]) -> dict[str, Floats]:
    """Return the chain's time across processes of pictures that arrived, ms; empty where too few did."""
    rows = run["live"].dropna()
    found = {
        m: rows.loc[rows["mapping"] == m, "chain_s"].to_numpy(np.float64) * _MS for m in MAPPINGS
    }
    return found if min(map(len, found.values())) >= _FEWEST else {}


def ratio(run: Run[Config], reading: str = "hardware") -> Estimate:
    """Return how many times as fast the chain is with a gateway: the ratio of means over the frames."""
    both = np.column_stack([chain_ms(run, reading)[mapping] for mapping in MAPPINGS])
    return ratio_of(both, np.mean, unit="times as fast")


def saved_ms(run: Run[Config]) -> float:
    """Return by how many milliseconds topic A travels shorter through a gateway, in the mean over frames."""
    return float((run["chain"]["smt_s"] - run["chain"]["gateway_s"]).mean() * _MS)


def chain_table(run: Run[Config]) -> pd.DataFrame:
    """Return mean and standard deviation of the chain by reading and mapping, the paper's below, in ms."""
    lines = []
    for reading, said in READINGS.items():
        times = chain_ms(run, reading)
        lines.append(_line(said, {name: (ms.mean(), ms.std(ddof=1)) for name, ms in times.items()}))
    if live := live_ms(run):
        lines.append(_line(LIVE, {name: (ms.mean(), ms.std(ddof=1)) for name, ms in live.items()}))
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


def node_table(run: Run[Config]) -> pd.DataFrame:
    """Return the chain's node times: as the graph assumes them in hardware, and as measured here, in ms."""
    measured = pd.DataFrame(
        {row.node: run["chain"][f"{row.node}_ns"] / 1e6 for row in lines_of(run["node"])}
    )
    return pd.DataFrame(
        {
            "in hardware, assumed": run["node"].set_index("node")["hardware_s"] * _MS,
            "here, mean": measured.mean(),
            "here, deviation": measured.std(),
        }
    )


@derived
def stops(run: Run[Config]) -> list[Stop]:
    """Return where the drawn lap's car stood for a second and more, its start aside."""
    tracks = run["track"]
    standing = (tracks["speed_mps"] < _STANDING_MPS).to_numpy()
    group = np.cumsum(np.diff(standing, prepend=standing[:1]) != 0)
    found = []
    for _, part in tracks[standing].groupby(group[standing]):
        first, lasted = part.iloc[0], float(part["t_s"].iloc[-1] - part["t_s"].iloc[0])
        if lasted >= 1.0 and first["t_s"] > 1.0:
            found.append(
                Stop(t_s=first["t_s"], lasted_s=lasted, x_m=first["x_m"], y_m=first["y_m"])
            )
    return found


@exp.claim("C-DRIVE", how=How.SIMULATED)
def shorter_chain(run: Run[Config]) -> Finding:
    """Return what a gateway saves, at the graph's image size and at others: the paper states none."""
    saved = (run["chain"]["smt_s"] - run["chain"]["gateway_s"]).to_numpy(dtype=np.float64) * _MS
    estimate = bootstrap([saved], lambda drawn: float(drawn[0].mean()), unit="ms saved")
    reason = "what is saved grows with the image, whose size the paper does not state; ours is the graph's, assumed"
    return Finding(estimate=estimate, details=_details(run), reason=reason, under=_at_sizes(run))


_SIZES = ((320, 240), (800, 600))


def _at_sizes(run: Run[Config]) -> dict[str, Estimate]:
    """Return what is saved at other sizes of rgb8 images, exactly, the mean over all orders of deliveries."""
    graph = chain_of(run.config.chain).graph
    found = {}
    for width, height in _SIZES:
        topic = replace(graph.topic(SHARED_TOPIC), size_bytes=3 * width * height)
        chain = Chain(
            replace(graph, topics=(topic, *(t for t in graph.topics if t.name != SHARED_TOPIC)))
        )
        saved_s = float(np.mean(list(chain.smt_s.values()))) - chain.gateway_s
        found[f"images of {width} x {height}"] = exactly(saved_s * _MS, "ms saved")
    return found


@exp.claim("C-DRIVE-DEV", how=How.SIMULATED)
def steadier_chain(run: Run[Config]) -> Finding:
    """Return by how many orders of magnitude the chain's deviation is less with a gateway, frame by frame."""
    both = [chain_ms(run)[mapping] for mapping in MAPPINGS]
    said = {f"chain, {READINGS[reading]}": _of(chain_ms(run, reading)) for reading in READINGS}
    details, ends, reason = {"deviation": _deviation(run), **said}, {}, ""
    if live := live_ms(run):
        across = bootstrap([*live.values()], orders_less, unit=_ORDERS)
        ends = {
            "orders of magnitude, live across processes": across.value,
            "share of pictures that arrive, live": 1 - float(run["live"]["chain_s"].isna().mean()),
        }
        details |= {"live across processes": f"{across}, {_of(live)}"}
        reason = _SCHEDULED
    elif why := run.skipped("live"):
        details |= {"live across processes": why}
    estimate = bootstrap(
        [np.column_stack(both)], lambda drawn: orders_less([*drawn[0].T]), unit=_ORDERS
    )
    return Finding(estimate=estimate, details=details, ends=ends, reason=reason)


_ORDERS = "orders of magnitude less deviation"
_SCHEDULED = (
    "across processes a gateway saves copies and not the scheduler, for which all nodes wait here: also those "
    "that are hardware in the paper"
)


def orders_less(drawn: Sequence[Floats]) -> float:
    """Return by how many orders of magnitude the second's deviation is less than the first's."""
    software, gateway = (ms.std(ddof=1) for ms in drawn)
    return float(np.log10(software / gateway))


def _details(run: Run[Config]) -> dict[str, str]:
    laps = run["lap"]
    saved, paper_saved = saved_ms(run), PAPER_MS["software"][0] - PAPER_MS["gateway"][0]
    fewest, most = laps["red_lights_obeyed"].min(), laps["red_lights_obeyed"].max()
    other = {name: ms.mean() for name, ms in chain_ms(run, forwarding=_CUT_THROUGH).items()}
    return {
        "laps passed": f"{int(laps['passed'].sum())} of {len(laps)}, {fewest} to {most} red lights each",
        **{f"chain, {READINGS[reading]}": _of(chain_ms(run, reading)) for reading in READINGS},
        "saved on topic A": (
            f"{saved:.2f} ms (paper: {paper_saved:.3f} ms), whatever the nodes take; the model's constants "
            "were fitted to other numbers, those of Fig. 6 and 7"
        ),
        "ratio, node times assumed in hardware": f"{ratio(run)} (paper: 1.4)",
        "ratio, node times measured in software": str(ratio(run, "software")),
        "ratio, the paper's own 20.270 ms and our saving": f"{1 + saved / PAPER_MS['gateway'][0]:.3f}",
        "ratio, hardware times halved and doubled": _scaled(run),
        "ratio, the memory model's other fit": f"{other['software'] / other['gateway']:.3f}, which saves more",
        "the chain's members": f"{' -> '.join(CHAIN)}: our reading, the text does not list them",
    }


def _of(times: dict[str, Floats]) -> str:
    said = [
        f"{ms.mean():.2f} +- {ms.std(ddof=1):.3f} ms" for ms in (times[name] for name in MAPPINGS)
    ]
    return f"{' -> '.join(said)} in {max(map(len, times.values()))} frames"


def _scaled(run: Run[Config]) -> str:
    """Return the ratios with the assumed times of the nodes in hardware halved and doubled."""
    nodes = float(run["node"]["hardware_s"].sum() * _MS)
    means = [chain_ms(run)[mapping].mean() for mapping in MAPPINGS]
    ratios = [(means[0] + more) / (means[1] + more) for more in (-nodes / 2, nodes)]
    return " and ".join(f"{value:.3f}" for value in ratios)


def _deviation(run: Run[Config]) -> str:
    smt = run["chain"]["smt_s"].std() * _MS
    return (
        f"topic A in software {smt:.2f} ms, by the order of deliveries alone (paper, whole chain: "
        f"{PAPER_MS['software'][1]} ms), through a gateway none (paper: {PAPER_MS['gateway'][1]} ms): missing "
        "are the board's Linux scheduler, DDS threads and the other software nodes on its processor"
    )

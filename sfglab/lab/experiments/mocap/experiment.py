"""Configuration, tables and parts of the experiment on motion capture and TF trees."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from sfglab.bus.address import BusAddress
from sfglab.fields import from_json
from sfglab.lab.bench import TableRow
from sfglab.lab.checks import CheckRow, trees
from sfglab.lab.experiment import Actor, Experiment, Link, Profiled
from sfglab.lab.workers.mocap import MocapWorkerConfig
from sfglab.messages import message_type
from sfglab.names import TF, TF_STATIC
from sfglab.processes import Member, ProcessGroup
from sfglab.spatial import Pose, StampedTransform
from sfglab.spatial.frames.buffer import Edge
from sfglab.spatial.frames.listener import TRANSFORMS
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Iterator

    from sfglab.component import Report
    from sfglab.lab.bench import Bench
    from sfglab.lab.testbed import Testbed

FIGURE_6 = "figure 6"  #: The paper's example in the table ``edge``.
LIVE = "live"  #: The live run in the table ``edge``.
HOSTS = {"robot": "agent_x", "bridge": "mocap", "listener": "viewer"}
_DOMAINS = {trees.PROXY: 51, trees.DIRECT: 52, trees.RENAMED: 53}
_LEAD_S = 6.0  # time from the order to the start of the live run
_SLACK_S = 90.0  # time that the processes may take longer


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """Number of robots, and length of the live run."""

    trees: int = 200  #: Random robots, besides the paper's example.
    live_s: float = 8.0  #: Length of the live run, s.
    seed: int = 0  #: Seed of robots, cameras and times of look-ups.


exp = Experiment(
    "mocap",
    Config,
    where="A 4.5, Eq. 4, Fig. 6",
    smoke={"trees": 3, "live_s": 2.0},
    paper={"trees": 2000, "live_s": 30.0},
    hosts=tuple(HOSTS.values()),
    actors=(
        Actor("robot", HOSTS["robot"], "publishes its TF tree, with odometry that drifts"),
        Actor(
            "bridge",
            HOSTS["bridge"],
            "simulates motion capture; runs the bridge or the direct receiver",
        ),
        Actor("listener", HOSTS["listener"], "builds the TF trees, looks up the robot's camera"),
    ),
    links=(
        Link("robot", "bridge", "the robot's transforms", boundary="network"),
        Link("robot", "listener", "the robot's transforms", boundary="network"),
        Link(
            "bridge",
            "listener",
            "pose of the robot's root, or of its markers (direct receiver)",
            boundary="network",
        ),
    ),
)
exp.table("check")(CheckRow)


@exp.table("edge")
@dataclass(slots=True, kw_only=True)
class MocapEdgeRow(Edge):
    """One edge of a TF tree."""

    where: str  #: ``figure 6`` or ``live``.
    way: str  #: ``direct``, ``renamed`` or ``proxy``.


@exp.table("look")
class LookUpRow(TableRow):
    """One live TF lookup of the robot's camera in the world, in the tree of the bridge."""

    at_s: float  #: Time of the lookup, and time stamp that is looked up, since the start, s.
    wait_ms: float  #: Wait until the transforms for that time were known, ms; NaN: they never were.
    error_mm: float  #: Distance between the found and the true position, mm.
    error_mrad: float  #: Angle between the found and the true orientation, mrad.
    latest_mm: float  #: Distance between the latest known and the true position, mm.


@exp.table("try")
class TryRow(TableRow):
    """Outcomes of live TF lookups of the robot's camera in the world."""

    way: str  #: ``direct``, ``renamed`` or ``proxy``.
    outcome: str  #: ``found``, or the name of the error.
    count: int  #: Number of lookups with this outcome.


@exp.part("trees")
def join_trees(bench: Bench[Config]) -> None:
    """Write the trees of Fig. 6, and check them and those of random robots."""
    seen = trees.captures_of((Pose(), Pose()))
    for way, tree in trees.join_trees(*trees.figure_6(), seen).items():
        for edge in tree.edges:
            bench.write(MocapEdgeRow(where=FIGURE_6, way=way, **asdict(edge)))
    for one in trees.joined(bench.config.trees, bench.config.seed):
        for check, holds in trees.checked(one).items():
            bench.cases[check].append((one.name, holds))


@exp.part("live run")
async def run_live(bench: Bench[Config]) -> None:
    """Run robot, bridge and listener on their hosts; the received tree of the bridge is sampled into the log."""
    config = bench.config
    async with ProcessGroup(
        members(bench.testbed, config.seed), wrap_command=bench.testbed.argv
    ) as group:
        start_ns = time.time_ns() + round(_LEAD_S * NS_PER_S)
        end_ns = start_ns + round(config.live_s * NS_PER_S)
        timeout_s = _LEAD_S + config.live_s + _SLACK_S
        reports = await group.ask("played", timeout_s=timeout_s, start_ns=start_ns, end_ns=end_ns)
    listener = reports["listener"]
    for row in live_rows(listener):
        bench.write(row)
    for is_static, values in listener["sampled"]:
        step = from_json(StampedTransform, values)
        message = message_type(TRANSFORMS)(transforms=[step.to_msg()])
        topic = TF_STATIC if is_static else TF
        bench.log.write(topic, message, log_time_ns=step.stamp_ns)


def members(testbed: Testbed, seed: int) -> Iterator[Member]:
    """Yield the processes of the live run."""
    for role, host in HOSTS.items():
        interface = testbed.interface(host)
        ways = {}
        for way, domain in _DOMAINS.items():
            ways[way] = BusAddress(domain_id=domain, interface=interface)
        config = MocapWorkerConfig(role=role, ways=ways, seed=seed)
        yield Member(name=role, module="sfglab.lab.workers.mocap", config=config, host=host)


def live_rows(listener: Report) -> Iterator[Any]:
    """Yield the rows of the listener's report."""
    for look in listener["looks"]:
        yield LookUpRow(**look)
    for way, outcomes in listener["tries"].items():
        for outcome, count in outcomes.items():
            yield TryRow(way=way, outcome=outcome, count=count)
    names: dict[str, str] = {}
    for edge in listener["edges"]:
        authority = names.setdefault(edge["authority"], f"publisher {len(names)}")
        yield MocapEdgeRow(**{**edge, "where": LIVE, "authority": authority})

"""Configuration and tables of the experiment with real ROS 2."""

from __future__ import annotations

from dataclasses import dataclass

from sfglab.lab.bench import TableRow
from sfglab.lab.experiment import Experiment, Profiled
from sfglab.lab.ros2 import TESTED

REAL, STAND_IN = "standard ROS 2", "stand-in"
"""Kinds of nodes in a baseline: nodes of rclpy, and the surrogate nodes of sfglab."""
TABLE = "ros2"
"""Table of the baselines."""
BASELINES = ("discovery", "decode_once", "latency")
"""Baselines, by the experiment that has the surrogate nodes."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Raw:
    """Numbers and durations of the measurements with subscribers of raw images."""

    counts: tuple[int, ...] = (1,)  #: Numbers of subscribers.
    repeats: int  #: Number of repetitions.
    look_s: float  #: Duration of one measurement, s.


@dataclass(frozen=True, slots=True, kw_only=True)
class Fleets:
    """Fleets of one size that are compared."""

    agents: int  #: Number of agents.
    nodes: int = 10  #: Number of publishing nodes of an agent, and of subscribing ones.
    repeats: int  #: Number of starts of each kind.


@dataclass(frozen=True, slots=True, kw_only=True)
class Config(Profiled):
    """Tests and measurements of the run."""

    distributions: tuple[str, ...] = TESTED  #: Distributions of ROS 2 that the tests are run with.
    #: Expression that selects tests by name, as pytest's option ``-k``; empty: all.
    only: str = ""
    decode_once: Raw = Raw(counts=(1, 3), repeats=3, look_s=1.4)  #: Baseline of decoding once.
    latency: Raw = Raw(repeats=6, look_s=0.5)  #: Baseline of latency.
    #: Baseline of discovery: at most 40 participants, which two cores suffice for.
    fleets: tuple[Fleets, ...] = (
        Fleets(agents=2, repeats=2),
        Fleets(agents=4, nodes=3, repeats=2),
    )
    #: Time after which a fleet is given up, s.
    timeout_s: float = 120.0
    #: Use of multicast by DDS between agents: ``default`` is that of ROS 2.
    multicast: str = "default"
    seed: int = 0  #: Seed of the order of measurements.


_FORMER_KINDS = [REAL, STAND_IN, "routed"]
"""Value of the removed field ``kinds`` of fleets in committed logs, except the last fleet."""

exp = Experiment(
    "ros2",
    Config,
    where="beside all papers",
    smoke={
        "distributions": ("jazzy",),
        "only": "bytes_behind",
        "decode_once": Raw(repeats=4, look_s=0.6),
        "latency": Raw(repeats=1, look_s=0.4),
        "fleets": (Fleets(agents=2, nodes=1, repeats=1),),
        "timeout_s": 60.0,
    },
    paper={
        "decode_once": Raw(counts=(1, 3), repeats=60, look_s=2.0),
        "latency": Raw(repeats=120, look_s=1.0),
        "fleets": (
            Fleets(agents=2, repeats=20),
            Fleets(agents=3, nodes=6, repeats=20),
            Fleets(agents=4, nodes=3, repeats=20),
            Fleets(agents=6, nodes=2, repeats=20),
        ),
        "timeout_s": 300.0,
    },
    removed={
        "fleets.0.kinds": {"quick": _FORMER_KINDS},
        "fleets.1.kinds": {"quick": _FORMER_KINDS},
        "fleets.2.kinds": {"quick": ["standard ROS 2, composed"]},
    },
)


@exp.table("test")
class FeatureRow(TableRow):
    """A test with one distribution, for one feature that it shows."""

    feature: str  #: Feature, in the words of a ROS 2 user.
    distribution: str  #: Distribution of ROS 2.
    test: str  #: Name of the test.
    outcome: str  #: ``passed``, ``failed`` or ``skipped``.
    condition: str = ""  #: Condition under which the feature works.
    cannot: str = ""  #: Reason why the feature cannot work; the test shows that it does not.
    duration_s: float = 0.0  #: Duration of the test, s.


@exp.table(TABLE)
class BesideRow(TableRow):
    """One value of rclpy or of its surrogate nodes; earlier logs have further kinds."""

    setting: str  #: Setting of the measurement, the same for all kinds of nodes.
    quantity: str  #: Quantity with its unit.
    kind: str  #: `REAL` or `STAND_IN`.
    repeat: int  #: Number of the repetition.
    value: float  #: The value.

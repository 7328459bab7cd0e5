"""Values that are read as typed fields: each mistake by its key, old logs, and processes without pydantic."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Annotated, Literal

import pytest

from sfglab.errors import InvalidValueError
from sfglab.fields import Bounds, between, to_json
from sfglab.lab.experiments import experiment
from sfglab.record import LogReader
from sfglab.validation import Source, lost_values, read, value_at

REFERENCE = Path(__file__).parents[1] / "data" / "reference"


class Colour(Enum):
    RED = "red"
    GREEN = "green"


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    size: float = between(1.0, without=(0,))


@dataclass(frozen=True, slots=True, kw_only=True)
class Whole:
    count: int = between(3, 1, 9)
    colour: Colour = Colour.RED
    live: bool = False
    name: str = "a"
    method: Literal["LC", "CC"] = "LC"
    depths: tuple[Annotated[int, Bounds(1, 50)], ...] = (1,)
    part: Part = field(default_factory=Part)
    maybe: float | None = None


def test_values_are_read_from_json_and_as_they_are():
    whole = Whole(colour=Colour.GREEN, depths=(2, 3), part=Part(size=2.0), maybe=1.0)
    plain = {"colour": "green", "depths": [2, 3], "part": {"size": 2}, "maybe": 1}
    assert read(Whole, plain) == whole
    typed = {"colour": Colour.GREEN, "depths": (2, 3), "part": Part(size=2.0), "maybe": 1.0}
    assert read(Whole, typed) == whole


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"count": "3"}, "x: count: given '3', allowed: a whole number from 1 to 9"),
        ({"count": 3.0}, "x: count: given 3.0"),
        ({"depths": [1, 51]}, "x: depths[1]: given 51, allowed: a whole number from 1 to 50"),
    ],
)
def test_a_mistake_is_named_by_key_what_is_given_and_what_is_allowed(given, says):
    """In JSON; tests/test_documents.py has the mistakes in files that people write."""
    with pytest.raises(InvalidValueError) as caught:
        read(Whole, given, "x: ")
    assert says in str(caught.value)


def test_a_log_of_another_version_is_read_and_what_is_lost_of_it_is_known():
    logged = to_json(Whole()) | {"count": 20, "gone": 1, "part": {"size": 1.0, "old": 2}}
    whole = read(Whole, logged, source=Source.LOG)
    assert whole == Whole(count=20)
    assert lost_values(logged, to_json(whole)) == {"part.old": 2, "gone": 1}
    assert lost_values([{"a": 1}, {"a": 1, "b": 2}], [{"a": 1}, {"a": 1}]) == {"1.b": 2}


@pytest.mark.parametrize("log", sorted(REFERENCE.glob("*.mcap")), ids=lambda log: log.stem)
def test_the_configuration_of_every_committed_log_is_read(log):
    with LogReader(log) as reader:
        logged = reader.metadata("config")
    exp = experiment(logged.pop("experiment"))
    run = exp.load(log)
    read_again = to_json(run.config)
    usual = to_json(exp.config(logged.get("profile", "quick")))
    for name in read_again.keys() - logged.keys():
        assert read_again.pop(name) == usual[name], "a newer field"
    for name in lost_values(logged, read_again):
        *outer, last = (int(key) if key.isdigit() else key for key in name.split("."))
        del value_at(logged, tuple(outer))[last]
    assert read_again == logged
    assert run.unread == (), "a removed field had another value than its profile"


PROCESSES = [
    "cli",
    "fleet.router.node",
    "fleet.status.node",
    "fleet.discovery.node",
    "fleet.decoder.node",
    "fleet.decoder.process",
    "fleet.gop_cache",
    "fleet.agent.app",
    "lab.hosts.hub",
    "lab.hosts.enter",
    "lab.sweep.run",
    "lab.workers.camera",
    "lab.workers.container",
    "lab.workers.crossing",
    "lab.workers.driving",
    "lab.workers.hallway",
    "lab.workers.idle",
    "lab.workers.mocap",
    "lab.workers.peer",
    "lab.workers.picture_flow",
    "lab.workers.ros_nodes",
    "lab.workers.scenario_player",
    "lab.workers.viewer",
]


@pytest.mark.parametrize("module", PROCESSES)
def test_processes_that_are_started_and_the_command_line_begin_without_pydantic(module):
    """Importing it takes 0.1 s, a third of what a router takes to start."""
    program = f"import sys\nimport sfglab.{module}\nassert 'pydantic' not in sys.modules"
    subprocess.run([sys.executable, "-c", program], check=True)


def test_an_agent_imports_the_configurations_of_its_components_and_not_their_nodes():
    """Imports of nodes took two thirds of its CPU time until its components were started."""
    nodes = {f"sfglab.fleet.{name}.node" for name in ("router", "status", "discovery", "decoder")}
    nodes |= {"sfglab.fleet.gop_cache", "sfglab.bus.node", "sfglab.messages", "av", "numpy"}
    program = f"import sys\nimport sfglab.fleet.agent.app\nassert not {nodes} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", program], check=True)

"""The naming schema checked name by name: paper A, section 4.1, Fig. 2.

Exact, not measured: every name that the standard values can make, and a seeded sample with suffixes and
custom values, is built, checked against ROS 2's rules and Fig. 2's constraint, parsed back and taken to DDS
and back. The log holds one row for each check.
"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from sfglab.lab.checks import CheckRow
from sfglab.lab.claims import How, Measured
from sfglab.lab.experiments.profiles import of_profile
from sfglab.lab.figures import COLORS, house_style
from sfglab.lab.stats import Estimate
from sfglab.names import (
    After,
    Component,
    Custom,
    FqnError,
    Resource,
    RosFqn,
    RosFqnBuilder,
    Scope,
    Stream,
    Suffixed,
    all_standard_fqns,
    parse,
    sanitize_agent,
    schema_table,
    validate_agent,
    validate_ros_name,
)
from sfglab.record import LogReader, LogWriter, run_context

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.names import SchemaNode


NAME = "naming"
AGENT = "go2"

PAPER_NAMES = (
    "/global/agent_heartbeat",
    "/global/go2/get_metadata",
    "/local/go2/agent_discovery_event",
)
"""The names that the paper prints (sections 4.2 and 4.3), for an agent go2."""


HOST_NAMES = ("Go2-Jetson.local", "steamdeck", "raspberry-pi-5", "Workstation_7970X")


@dataclass(frozen=True, slots=True, kw_only=True)
class Config:
    """How much is checked."""

    samples: int = 2000  #: Random names with suffixes and custom segments.
    seed: int = 0  #: Seed of the sample.

    @classmethod
    def of_profile(cls, profile: str, *, seed: int = 0) -> Config:
        """Return the configuration of a profile.

        Args:
            profile: ``smoke``, ``quick`` or ``paper``.
            seed: Seed of the sample.

        Raises:
            ConfigError: There is no such profile.
        """
        return of_profile(_PROFILES, profile, seed=seed)


_PROFILES = {
    "smoke": Config(samples=200),
    "quick": Config(samples=2000),
    "paper": Config(samples=20000),
}


def _random_word(rng: np.random.Generator) -> str:
    return "".join(rng.choice(list("abcdefgh"), size=rng.integers(3, 8)))


def random_fqns(count: int, *, rng: np.random.Generator) -> Iterator[RosFqn]:
    """Yield names with random segments; draws that the schema refuses are left out."""
    drawn = 0
    while drawn < count:
        builder = RosFqnBuilder().scope(list(Scope)[rng.integers(2)]).agent(_random_word(rng))
        try:
            yield _random_rest(builder, rng).build()
        except FqnError:
            continue
        drawn += 1


def _random_rest(builder: RosFqnBuilder, rng: np.random.Generator) -> RosFqnBuilder:
    depth = rng.integers(0, 3)
    if depth >= 1:
        builder = builder.component(*_random_segment(list(Component), rng))
    if depth == 2:
        builder = builder.stream(*_random_segment(list(Stream), rng))
    return builder.resource(*_random_segment(list(Resource), rng))


def _random_segment(values: list[Any], rng: np.random.Generator) -> tuple[Any, ...]:
    if rng.random() < 0.3:
        return (Custom(_random_word(rng)),)
    value = values[rng.integers(len(values))]
    return (value, _random_word(rng)) if rng.random() < 0.4 else (value,)


def _parses_back(fqn: RosFqn) -> bool:
    return parse(str(fqn), fqn.kind) == fqn


def _is_ros_name(fqn: RosFqn) -> bool:
    validate_ros_name(str(fqn), fqn.kind)
    return True


def _stands_where_it_may(fqn: RosFqn) -> bool:
    resource = fqn.resource.base if isinstance(fqn.resource, Suffixed) else fqn.resource
    return isinstance(resource, Custom) or fqn.preceding in resource.after


def _rebuilds(fqn: RosFqn) -> bool:
    return str(parse(str(fqn), fqn.kind)) == str(fqn)


CHECKS: dict[str, Callable[[RosFqn], bool]] = {
    "parses back to the tuple it was built from": _parses_back,
    "builds back to the string it was parsed from": _rebuilds,
    "is a valid ROS 2 name": _is_ros_name,
    "has a resource that Fig. 2 allows after its last segment": _stands_where_it_may,
}


def _check(name: str, holds: Callable[[RosFqn], bool], fqns: list[RosFqn]) -> CheckRow:
    failed = [fqn for fqn in fqns if not holds(fqn)]
    example = str((failed or fqns)[0])
    return CheckRow(check=name, checked=len(fqns), held=len(fqns) - len(failed), example=example)


def _refused_combinations() -> CheckRow:
    """Count the resources that are refused after each kind of segment after which they may not stand."""
    agent = RosFqnBuilder().scope(Scope.GLOBAL).agent(AGENT)
    component = agent.component(Component.CAMERA)
    prefixes = {
        After.SCOPE: RosFqnBuilder().scope(Scope.GLOBAL).without_agent(),
        After.AGENT: agent,
        After.COMPONENT: component,
        After.STREAM: component.stream(Stream.COLOR),
    }
    wrong = [(p.resource(r)) for flag, p in prefixes.items() for r in Resource if flag not in r.after]
    errors = [error for error in map(_refusal, wrong) if error]
    name = "resources where Fig. 2 does not allow them are refused"
    return CheckRow(check=name, checked=len(wrong), held=len(errors), example=errors[0])


def _refusal(builder: RosFqnBuilder) -> str:
    try:
        builder.build()
    except FqnError as error:
        return str(error)
    return ""


def _agent_defaults() -> CheckRow:
    names = [(host, sanitize_agent(host)) for host in HOST_NAMES]
    held = [host for host, agent in names if validate_agent(agent) == agent]
    example = ", ".join(f"{host} -> {agent}" for host, agent in names)
    return CheckRow(
        check="a host name becomes a valid agent", checked=len(names), held=len(held), example=example
    )


def _standard_names_differ(fqns: list[RosFqn]) -> CheckRow:
    distinct = len({str(fqn) for fqn in fqns})
    return CheckRow(
        check="standard names differ from each other",
        checked=len(fqns),
        held=distinct,
        example=str(fqns[-1]),
    )


def run(config: Config, path: Path) -> Path:
    """Check the schema and write one row a property.

    Args:
        config: How much.
        path: The log.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    rng = np.random.default_rng(config.seed)
    standard = list(all_standard_fqns(AGENT))
    every = standard + list(random_fqns(config.samples, rng=rng))
    printed = [parse(name) for name in PAPER_NAMES]
    rows = [_check(name, holds, every) for name, holds in CHECKS.items()]
    rows += [_refused_combinations(), _agent_defaults(), _standard_names_differ(standard)]
    rows.append(_check("is printed in the paper, and is in the schema", _rebuilds, printed))
    with LogWriter(path) as log:
        log.write_metadata("run", run_context())
        log.write_metadata("config", {"experiment": NAME, **asdict(config)})
        for row in rows:
            log.write_row("check", row, log_time_ns=time.time_ns())
    return path


def load_checks(log: Path) -> Any:
    """Return the checks of a run as a table."""
    with LogReader(log) as reader:
        return reader.table("check").drop(columns="log_time_ns")


def measure_claims(log: Path) -> dict[str, Measured]:
    """Return our figure for A-FQN: the share of names on which all properties hold."""
    checks = load_checks(log)
    share = float(checks["held"].sum() / checks["checked"].sum())
    estimate = Estimate(value=share, low=share, high=share, unit="share of names that hold")
    details = {"checks": str(int(checks["checked"].sum())), "properties": str(len(checks))}
    return {"A-FQN": Measured(estimate=estimate, how=How.EXACT, details=details)}


def draw_schema(axes: Axes) -> dict[str, Any]:
    """Draw Fig. 2 from the schema's own table: the chain of segments and the ways into the resource.

    Returns:
        How many standard resources each way permits.
    """
    table = schema_table()
    places = {node.name: 2.2 * i for i, node in enumerate(table.nodes)}
    ways = [edge for edge in table.edges if edge.after is not None]
    for node in table.nodes:
        _draw_segment(axes, node, places[node.name])
    for edge in table.edges:
        if edge.after is None:
            _arrow(axes, places[edge.source] + 0.75, places[edge.target] - 0.75, height=0.0)
    for lane, edge in enumerate(ways):
        label = f"after {edge.source}: {len(edge.resources)} resources"
        _arrow(axes, places[edge.source], places["resource"], height=1.1 + 0.45 * (len(ways) - lane))
        axes.text(places[edge.source] + 0.1, 1.16 + 0.45 * (len(ways) - lane), label, fontsize=8)
    axes.set(xlim=(-1, places["resource"] + 1), ylim=(-1.6, 3.3))
    axes.axis("off")
    return {edge.source: [resource.value for resource in edge.resources] for edge in ways}


def _draw_segment(axes: Axes, node: SchemaNode, x: float) -> None:
    style = "solid" if node.mandatory else "dashed"
    box = {"boxstyle": "round,pad=0.5", "facecolor": "white", "edgecolor": "black", "linestyle": style}
    axes.text(x, 0, f"<{node.name}>", ha="center", va="center", bbox=box)
    values = f"{len(node.values)} values" if node.values else "SFG_AGENT_NAME,\nelse host name"
    more = "\n+ suffix, Custom" if node.extensible else ""
    axes.text(x, -0.55, values + more, ha="center", va="top", fontsize=8)


def _arrow(axes: Axes, start: float, end: float, *, height: float) -> None:
    arrow = {"arrowstyle": "->", "color": COLORS["proxy"] if height else "black"}
    if not height:
        axes.annotate("", xy=(end, 0), xytext=(start, 0), arrowprops=arrow)
        return
    axes.plot([start, start, end], [0.4, height, height], color=COLORS["proxy"], linewidth=1)
    axes.annotate("", xy=(end, 0.4), xytext=(end, height), arrowprops=arrow)


def figures(log: Path) -> dict[str, tuple[Figure, dict[str, Any]]]:
    """Draw the schema; the log only says which run it belongs to."""
    from matplotlib.figure import Figure

    checks = load_checks(log)
    with house_style():
        figure = Figure(figsize=(10, 3.6))
        permitted = draw_schema(figure.subplots())
        held, checked = int(checks["held"].sum()), int(checks["checked"].sum())
        figure.suptitle(f"The naming schema (paper A, Fig. 2): {held} of {checked} checks hold")
    return {"naming_schema": (figure, {"permitted": permitted, "held": held, "checked": checked})}

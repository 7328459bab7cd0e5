"""Heartbeats over time beside the paper's periods, and Fig. 3 of paper A from the discoverer's own table."""

from __future__ import annotations

from collections import defaultdict
from itertools import accumulate
from textwrap import fill
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from sfglab.fleet.discovery.lifecycle import (
    ANNOUNCEMENTS,
    STATED,
    TRANSITIONS,
    Action,
    Announced,
    Input,
    QueryState,
    State,
)
from sfglab.lab.experiments.lifecycle.analysis import (
    heard,
    heartbeat_checks,
    intervals,
    joined_ns,
    transitions,
)
from sfglab.lab.experiments.lifecycle.experiment import Config, exp
from sfglab.lab.explore import Automaton, Parts
from sfglab.lab.figures import COLORS, MARKERS, PAPER_STYLE, note
from sfglab.units import NS_PER_S

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from matplotlib.artist import Artist
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.runs import Run

    Point = tuple[float, float]
    Taken = dict[tuple[State, Input], int]
    _Drawn = dict[Any, list[Artist]]

PAPER_PERIODS = {0: 1.0, 1: 5.0}  #: Seconds by phase (paper A, section 4.2).

PHASES = {0: "start-up", 1: "steady state"}
_STYLES = {0: "proxy", 1: "third"}
_OVER_AXES = ("data", "axes fraction")


@exp.figure("heartbeats", size=(10.5, 3.8))
def draw_heartbeats(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the time between heartbeats over the time since the start, and how far it is from its period."""
    table, checks = intervals(run), heartbeat_checks(run)
    held = sum(check.held for check in checks)
    over_time, errors = figure.subplots(1, 2, width_ratios=(1.7, 1))
    _draw_gaps(over_time, run)
    medians = _draw_errors(errors, run)
    where = "on another host" if run.metadata("hosts")["separate"] else "by another process"
    scaled = "" if run.config.at_paper_periods else " (faster than the paper's, for a short run)"
    heard_by = f"Heartbeats of {len(run['answer'])} agents, heard {where}{scaled}"
    figure.suptitle(f"{heard_by}: {held} of {len(checks)} checks hold")
    note(figure, f"{len(table)} intervals, a dot each; black: medians", run)
    return {"held": held, "checks": len(checks), "heartbeats": len(table), "median_gap_s": medians}


def _draw_gaps(axes: Axes, run: Run[Config]) -> None:
    table = intervals(run)
    for phase, style in _STYLES.items():
        chosen = table[table["phase"] == phase]
        dots: dict[str, Any] = {"marker": MARKERS[style], "color": COLORS[style], "alpha": 0.75}
        label = f"measured, {PHASES[phase]}"
        axes.plot(chosen["since_s"], chosen["gap_s"], linestyle="none", label=label, **dots)
        if run.config.at_paper_periods:
            label = f"paper: {PAPER_PERIODS[phase]:g} s, {PHASES[phase]}"
            axes.axhline(PAPER_PERIODS[phase], color=COLORS[style], label=label, **PAPER_STYLE)
    _mark_events(axes, run)
    axes.set(
        xlabel="time since an agent's first heartbeat (s)",
        ylabel="time until its next heartbeat (s)",
    )
    axes.set_ylim(0, 1.45 * table["gap_s"].max())
    axes.set_title("every interval", fontsize=9)
    axes.legend(fontsize=8, loc="upper left", ncols=2)


def _mark_events(axes: Axes, run: Run[Config]) -> None:
    """Mark where the start-up phase ends and where another listener joined."""
    first_ns = heard(run, "first").groupby("agent")["received_ns"].min()
    joined_s = float(np.median((joined_ns(run) - first_ns) / NS_PER_S))
    for at_s, text in (
        (run.config.schedule.startup_s, "start-up ends"),
        (joined_s, "a late listener joins"),
    ):
        axes.axvline(at_s, ymax=0.8, color="black", linewidth=0.8, linestyle=":")
        beside: dict[str, Any] = {"xytext": (3, 2), "textcoords": "offset points", "rotation": 90}
        axes.annotate(text, (at_s, 0.2), xycoords=_OVER_AXES, fontsize=7.5, va="bottom", **beside)


def _draw_errors(axes: Axes, run: Run[Config]) -> dict[str, float]:
    """Draw every interval's distance from its phase's period, and return the median intervals."""
    table, medians = intervals(run), {}
    schedule = run.config.schedule
    periods_s = {0: schedule.startup_period_s, 1: schedule.steady_period_s}
    rng = np.random.default_rng(0)
    for phase, style in _STYLES.items():
        gaps = table.loc[table["phase"] == phase, "gap_s"].to_numpy()
        errors_ms = 1e3 * (gaps - periods_s[phase])
        spread = phase + rng.uniform(-0.18, 0.18, len(gaps))
        axes.plot(
            spread,
            errors_ms,
            linestyle="none",
            marker=MARKERS[style],
            color=COLORS[style],
            alpha=0.6,
        )
        median = float(np.median(errors_ms))
        axes.hlines(median, phase - 0.3, phase + 0.3, color="black", linewidth=1.5)
        text = f"median {median:+.1f} ms"
        axes.annotate(text, (phase, 1), xycoords=_OVER_AXES, ha="center", va="top", fontsize=8)
        medians[PHASES[phase]] = float(np.median(gaps))
    axes.axhline(0, color="grey", linewidth=0.8)
    axes.set_xticks([0, 1], [f"{text}\n({periods_s[phase]:g} s)" for phase, text in PHASES.items()])
    axes.set(xlim=(-0.5, 1.5), ylabel="interval minus period (ms)")
    axes.margins(y=0.25)
    axes.set_title("how far from the period", fontsize=9)
    axes.grid(visible=False, axis="x")
    return medians


# --- The life cycle -------------------------------------------------------------------------------------------


class _Edge(NamedTuple):
    """One transition of the discoverer's table."""

    source: State
    given: Input
    target: State
    actions: tuple[Action, ...]

    @property
    def label(self) -> str:
        """The edge in UML's syntax, "event / action; action", with spaces for underscores."""
        done = "; ".join(action.name.lower() for action in self.actions)
        return (self.given.name.lower() + (f" / {done}" if done else "")).replace("_", " ")


def _edges() -> list[_Edge]:
    """Return the transitions of the table in its order."""
    return [_Edge(*key, *outcome) for key, outcome in TRANSITIONS.items()]


def _place(state: State) -> tuple[int, int]:
    """Return the column and the row of a state in the grid."""
    return list(QueryState).index(state.query), list(Announced).index(state.announced)


# Where things stand: presentation only. What there is to draw, and its words, come from the table.
_X = (0.0, 7.0, 14.0)
_Y = (9.6, 4.8, 0.0)
_HALF_WIDTH, _HALF_HEIGHT = 1.5, 0.78
_LANE = 0.3
_ROWS = (
    "local consumers\nknow nothing of it",
    "local consumers:\nit is there",
    "local consumers:\nit is lost",
)
_COLUMNS = ("nothing to ask", "one query outstanding", "waiting to ask again")
_BANDS = ("#999999", "#009E73", "#D55E00")
_LINE_HEIGHT, _LINE_IN_BOX = 0.36, 0.28
_BOTTOMS = tuple(y - _HALF_HEIGHT for y in _Y)
_TOPS = tuple(y + _HALF_HEIGHT for y in _Y)
_LEFT = -2.9
_BEHIND = {"boxstyle": "square,pad=0.1", "facecolor": "white", "edgecolor": "none", "alpha": 0.75}

# Transitions between rows: the corners of the arrow, and where the label starts.
_BETWEEN_ROWS: dict[tuple[str, str], tuple[tuple[Point, ...], Point]] = {
    ("QUERYING", "ACTIVE"): (
        ((6.0, _BOTTOMS[0]), (6.0, 7.3), (0.6, 7.3), (0.6, _TOPS[1])),
        (2.0, 7.52),
    ),
    ("ACTIVE", "LOST"): (((-0.6, _BOTTOMS[1]), (-0.6, _TOPS[2])), (-2.8, 2.4)),
    ("LOST", "ACTIVE"): (((-0.2, _TOPS[2]), (-0.2, _BOTTOMS[1])), (-0.1, 3.2)),
    ("LOST", "UNKNOWN"): (
        ((-_HALF_WIDTH, _Y[2]), (_LEFT, _Y[2]), (_LEFT, _Y[0]), (-_HALF_WIDTH, _Y[0])),
        (_LEFT + 0.1, 7.3),
    ),
    ("REFRESHING", "LOST"): (
        ((5.8, _BOTTOMS[1]), (5.8, 2.75), (0.3, 2.75), (0.3, _TOPS[2])),
        (2.7, 2.97),
    ),
    ("REJOINING", "ACTIVE"): (
        ((6.6, _TOPS[2]), (6.6, 3.45), (1.2, 3.45), (1.2, _BOTTOMS[1])),
        (6.7, 1.5),
    ),
    ("REFRESH_BACK_OFF", "LOST"): (
        ((12.8, _BOTTOMS[1]), (12.8, 2.1), (1, 2.1), (1, _TOPS[2])),
        (9.6, 2.32),
    ),
}


@exp.figure("discovery_states", size=(10, 8.6))
def draw_states(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw the life cycle of a remote agent and how often the run took each of its transitions."""
    found = transitions(run)
    reached = sum(count > 0 for count in found.taken.values())
    stated = sum(found.taken[key] > 0 for key in STATED)
    _draw_table(figure.subplots(), _KEY_OF_RUN, found.taken)
    figure.suptitle(
        f"Life cycle of a remote agent (after paper A, Fig. 3): {stated} of {len(STATED)} transitions that the "
        f"paper states taken live,\n{reached - stated} of {len(TRANSITIONS) - len(STATED)} of ours; "
        f"{found.doubled} queries while another was outstanding, {found.strange} moves against the rules",
        fontsize="medium",
    )
    shown = {f"{s.name} {i.name}": count for (s, i), count in found.taken.items()}
    return {"taken": shown, "reached": reached, "stated": stated, "doubled": found.doubled}


def press_states(run: Run[Config]) -> Automaton:
    """Return the life cycle to press: by hand, or as the run's discoverers walked it, the most varied first."""
    moves = (
        run["move"].sort_values("t_ns", kind="stable").groupby(["discoverer", "agent"], sort=False)
    )
    richest = sorted(moves, key=lambda item: -len(item[1][["before", "given"]].drop_duplicates()))
    runs = {
        f"{agent}, seen by {by}": [Input[i] for i in rows["given"]] for (by, agent), rows in richest
    }
    return press_lifecycle(runs)


def press_lifecycle(runs: Mapping[str, Sequence[Input]] | None = None) -> Automaton:
    """Return the life cycle of a remote agent to press: by hand, or through runs, given as their inputs."""
    return Automaton("agent", TRANSITIONS, State.UNKNOWN, _draw_to_press, size=(10, 8.4), runs=runs)


def _draw_to_press(figure: Figure) -> Parts:
    figure.set_layout_engine("none")  # which would draw everything twice
    return _draw_table(figure.add_axes((0, 0, 1, 1)), _KEY_OF_MOMENT)


_KEY = "\u21ba the state stays;  CAPITALS: a discovery event is published;  bold: the paper's words state it;\n"
_KEY_OF_RUN = (
    f"input / what is done \u00d7 how often in this run;  {_KEY}dashed: not taken in this run"
)
_KEY_OF_MOMENT = (
    f"input / what is done;  {_KEY}orange: here, and how it came here;  blue: possible now"
)


def _draw_table(axes: Axes, key: str, taken: Taken | None = None) -> Parts:
    """Draw the states as a grid, and the transitions between them; taken: how often each was, if known."""
    _draw_grid(axes, key)
    drawn: _Drawn = defaultdict(list)
    between: defaultdict[tuple[State, State], list[_Edge]] = defaultdict(list)
    for edge in _edges():
        between[edge.source, edge.target].append(edge)
    for state in State:
        _draw_state(axes, state, between.pop((state, state), []), taken, drawn)
    for edges in between.values():
        _draw_pair(axes, edges, taken, drawn)
    axes.set(xlim=(-5.9, 15.65), ylim=(-2.8, 12.4))
    axes.axis("off")
    return drawn


def _draw_grid(axes: Axes, key: str) -> None:
    for y, text, color in zip(_Y, _ROWS, _BANDS, strict=True):
        axes.axhspan(
            y - _HALF_HEIGHT - 0.25, y + _HALF_HEIGHT + 0.25, color=color, alpha=0.07, linewidth=0
        )
        axes.text(-5.8, y, text, ha="left", va="center", fontsize=8, style="italic")
    for x, text in zip(_X, _COLUMNS, strict=True):
        axes.text(x, 12.1, text, ha="center", va="center", fontsize=9, style="italic")
    axes.text(_X[1], -2.55, key, ha="center", va="center", fontsize=8)


def _draw_state(
    axes: Axes, state: State, loops: Sequence[_Edge], taken: Taken | None, drawn: _Drawn
) -> None:
    from matplotlib.patches import FancyBboxPatch

    column, row = _place(state)
    x, y = _X[column], _Y[row]
    corner, style = (x - _HALF_WIDTH, y - _HALF_HEIGHT), "round,pad=0,rounding_size=0.25"
    frame: dict[str, Any] = {
        "boxstyle": style,
        "facecolor": "white",
        "edgecolor": "black",
        "zorder": 3,
    }
    box = axes.add_patch(FancyBboxPatch(corner, 2 * _HALF_WIDTH, 2 * _HALF_HEIGHT, **frame))
    name = state.name.replace("_", " ").lower()
    said = [fill(f"\u21ba {_words(loop, taken)}", 26) for loop in loops]
    lines = [0, *accumulate(text.count("\n") + 1 for text in said)]
    top = y + 0.5 * _LINE_IN_BOX * lines[-1]
    title = axes.text(x, top, name, ha="center", va="center", fontsize=9, weight="bold", zorder=4)
    drawn[state] += [box, title]
    for loop, text, above, below in zip(loops, said, lines, lines[1:], strict=False):
        place = x, top - 0.5 * (above + below + 1) * _LINE_IN_BOX
        color = _line([loop], taken)["color"]
        look: dict[str, Any] = {
            "ha": "center",
            "va": "center",
            "fontsize": 7,
            "color": color,
            "zorder": 4,
        }
        look["weight"] = _weight(loop)
        drawn[_keys([loop])].append(axes.text(*place, text, **look))


def _draw_pair(axes: Axes, edges: Sequence[_Edge], taken: Taken | None, drawn: _Drawn) -> None:
    """Draw all transitions from one state to another as one arrow with a line of text each."""
    points, label, below = _route(edges[0].source, edges[0].target)
    line = _line(edges, taken)
    drawn[_keys(edges)] += axes.plot(*zip(*points[:-1], strict=True), **line)
    arrow = {"arrowstyle": "-|>", "shrinkA": 0, "shrinkB": 0, **line}
    head = axes.annotate("", points[-1], points[-2], arrowprops=arrow).arrow_patch
    assert head is not None, "it was asked for"
    drawn[_keys(edges)].append(head)
    if taken is None:  # somebody presses: broad, for the mouse
        drawn[_keys(edges)] += axes.plot(
            *zip(*points, strict=True), alpha=0, linewidth=9, zorder=3.5
        )
    step = -_LINE_HEIGHT if below else _LINE_HEIGHT
    for number, edge in enumerate(edges if below else reversed(edges)):
        place = (label[0], label[1] + number * step)
        color = _line([edge], taken)["color"]
        style: dict[str, Any] = {
            "va": "center",
            "fontsize": 7,
            "bbox": _BEHIND,
            "color": color,
            "zorder": 5,
        }
        drawn[_keys([edge])].append(
            axes.text(*place, _words(edge, taken), weight=_weight(edge), **style)
        )


def _keys(edges: Sequence[_Edge]) -> tuple[tuple[State, Input], ...]:
    return tuple((edge.source, edge.given) for edge in edges)


def _weight(edge: _Edge) -> str:
    return "bold" if (edge.source, edge.given) in STATED else "normal"


def _words(edge: _Edge, taken: Taken | None) -> str:
    # A transition's label, discovery events in capitals.
    label = edge.label
    for action in ANNOUNCEMENTS.intersection(edge.actions):
        given, done = label.split(" / ")
        label = f"{given} / {done.replace(action.name.lower(), action.name)}"
    return label + (f"  \u00d7{taken[edge.source, edge.given]}" if taken is not None else "")


def _line(edges: Sequence[_Edge], taken: Taken | None) -> dict[str, Any]:
    """Return how an arrow of some transitions looks: dashed where none was taken."""
    counts = [1 if taken is None else taken[key] for key in _keys(edges)]
    color = COLORS["proxy" if all(counts) else "standard"]
    return {"color": color, "linewidth": 1.2, "linestyle": "solid" if any(counts) else "dashed"}


def _route(source: State, target: State) -> tuple[Sequence[Point], Point, bool]:
    """Return an arrow's corners, where its label starts, and whether further lines go below the first."""
    if source.announced is target.announced:
        return _route_in_row(source, target)
    points, label = _BETWEEN_ROWS[source.name, target.name]
    return points, label, True


def _route_in_row(source: State, target: State) -> tuple[list[Point], Point, bool]:
    column, row = _place(source)
    to_column, _ = _place(target)
    y = _Y[row]
    steps = to_column - column
    if abs(steps) == 1:
        way = 1 if steps > 0 else -1
        lane = y + way * _LANE
        start, end = _X[column] + way * _HALF_WIDTH, _X[to_column] - way * _HALF_WIDTH
        return [(start, lane), (end, lane)], (min(start, end) + 0.25, lane + way * 0.22), way < 0
    way = 1 if row == 0 else -1  # around the state between them, on the outer side of the grid
    outer = y + way * 1.5
    edge = y + way * _HALF_HEIGHT
    x, to_x = _X[column], _X[to_column]
    return (
        [(x, edge), (x, outer), (to_x, outer), (to_x, edge)],
        (_X[1] + 1.9, outer + way * 0.22),
        way < 0,
    )

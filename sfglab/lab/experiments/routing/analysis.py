"""Checks, latencies, the claim A-NET-RULES, and what crosses at a glance.

A check is one thing that Table 1 or Eq. 1 of paper A demands of one name and two parties, measured black-box.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import pandas as pd

from sfglab.fleet.policy import TABLE_1
from sfglab.lab.checks import CheckRow, check_row, lowest_share
from sfglab.lab.checks.routing import in_table_1
from sfglab.lab.claims import Finding, How
from sfglab.lab.experiments.routing.experiment import Config, exp, halves, may_cross
from sfglab.lab.figures import COLORS, note
from sfglab.lab.runs import Run, derived
from sfglab.lab.stats import Estimate, bootstrap, median_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    # Name, domain, how much arrived and was sent, and whether the domain is another.
    Reached = tuple[str, Any, Any, Any, Any]

GLOBAL = 0


@derived
def heard(run: Run[Config]) -> pd.DataFrame:
    """Return one line a topic, source and hearer.

    ``allowed`` says whether Table 1 names the topic, ``across`` whether the two are in different domains.
    """
    table = run["heard"]
    return table.assign(
        allowed=[in_table_1(name) for name in table["dds_topic"]],
        across=table["source_domain"] != table["hearer_domain"],
    )


@derived
def calls(run: Run[Config]) -> pd.DataFrame:
    """Return one line a service and caller, with ``allowed`` and ``across``."""
    table = run["call"]
    return table.assign(
        allowed=[may_cross(name) for name in table["name"]],
        across=table["caller_domain"] != table["server_domain"],
    )


@derived
def checks(run: Run[Config]) -> pd.DataFrame:
    """Return every kind of check: how it was made, and what `CheckRow` says of it."""
    live = pd.DataFrame([{"how": How.LIVE.value, **asdict(row)} for row in _live(run)])
    exact = run["policy"].assign(how=How.EXACT.value)
    return pd.concat([live, exact], ignore_index=True)[
        ["check", "how", "checked", "held", "example"]
    ]


def _live(run: Run[Config]) -> Iterator[CheckRow]:
    every, called, seen = heard(run), calls(run), run["endpoint"]
    across, arrived = every[every["across"]], every[every["received"] > 0]
    yield _check(
        "an endpoint seen in the global domain is of Table 1",
        seen,
        lambda r: in_table_1(r.dds_topic),
    )
    yield _check(
        "an endpoint seen in the global domain is a router's", seen, lambda r: bool(r.router)
    )
    named, others = across[across["allowed"]], across[~across["allowed"]]
    yield _check(
        "a topic of Table 1 is heard in every other domain", named, lambda r: r.received > 0
    )
    yield _check("any other topic is not heard in another domain", others, lambda r: not r.received)
    yield _check(
        "every topic is heard in its own domain", every[~every["across"]], lambda r: r.received > 0
    )
    yield _rules(run)
    yield _check("no sample arrives twice or comes back", arrived, lambda r: not r.repeated)
    yield _check("samples of one source keep their order", arrived, lambda r: not r.disordered)
    yield _check("samples keep their source time stamps", arrived, lambda r: not r.restamped)
    transforms = arrived[arrived["dds_topic"].isin(["rt/tf", "rt/tf_static"])]
    yield _check(
        "transforms bear their agent's prefix, outside it only",
        transforms,
        lambda r: not r.misnamed,
    )
    yield _check(
        "a late joiner hears each static transform once", run["latched"], lambda r: r.received == 1
    )
    named, others = (called[called["across"] & (called["allowed"] == may)] for may in (True, False))
    yield _check(
        "a service of Table 1 answers calls from other domains", named, lambda r: r.answered
    )
    yield _check("any other service does not", others, lambda r: not r.answered)


def _check(name: str, rows: pd.DataFrame, holds: Callable[[Any], Any]) -> CheckRow:
    return check_row(name, ((_text(row), bool(holds(row))) for row in rows.itertuples()))


def _text(row: Any) -> str:
    def first_of(*names: str) -> Any:
        return next((getattr(row, name) for name in names if hasattr(row, name)), "rt/tf_static")

    first, last = first_of("source", "caller", "seen_by"), first_of("hearer", "server", "kind")
    return f"{first_of('dds_topic', 'name')}: {first}, {last}"


def _rules(run: Run[Config]) -> CheckRow:
    """Check that every row of Table 1 was seen to be open at every agent, both ways."""
    agents = [str(p.party) for p in run["party"].itertuples() if p.domain != GLOBAL]
    seen = set(_crossings(run))
    wanted = [
        (rule.pattern, agent, way) for rule in TABLE_1 for agent in agents for way in ("out", "in")
    ]
    cases = ((", ".join(w), w in seen) for w in wanted)
    return check_row("every rule is seen open at every agent, both ways", cases)


def _crossings(run: Run[Config]) -> Iterator[tuple[str, str, str]]:
    """Yield rule, agent and way of everything that was seen to cross."""
    every = heard(run)
    for row in every[every["across"] & (every["received"] > 0)].itertuples():
        yield from _crossing(str(row.dds_topic), str(row.source), str(row.hearer))
    called = calls(run)
    for row in called[called["across"] & called["answered"]].itertuples():
        request, reply = halves(str(row.name))
        yield from _crossing(request, str(row.caller), str(row.server))
        yield from _crossing(reply, str(row.server), str(row.caller))


def _crossing(dds: str, source: str, hearer: str) -> Iterator[tuple[str, str, str]]:
    for rule in TABLE_1:
        if rule.matches(dds):
            yield rule.pattern, source, "out"
            yield rule.pattern, hearer, "in"


@derived
def latencies(run: Run[Config]) -> dict[str, Estimate]:
    """Return the time from publishing to receiving on topics of Table 1, by what lies between.

    A sample is the median of one topic, source and hearer. ``per router`` is what one router and the hop behind
    it add: half of the way between agents, less the way between two hosts of the global domain. All names are
    sent at once, so messages wait for others. Groups without samples are left out.
    """
    every = heard(run)
    chosen = every[
        every["allowed"] & (every["source"] != every["hearer"]) & (every["received"] > 0)
    ]
    routers = sum(
        (chosen[side] != GLOBAL).astype(int) for side in ("source_domain", "hearer_domain")
    )
    renamed = chosen["dds_topic"] == "rt/tf"
    plain = ~renamed & (chosen["dds_topic"] != "rt/tf_static")
    groups = {
        "direct": plain & (routers == 0),
        "one router": plain & (routers == 1),
        "two routers": plain & (routers == 2),
        "one router, /tf": renamed & (routers == 1),
    }
    samples = {
        name: chosen[rows]["age_ms"].to_numpy(dtype=np.float64) for name, rows in groups.items()
    }
    found = {name: median_of(ages, unit="ms") for name, ages in samples.items() if len(ages)}
    if {"direct", "two routers"} <= set(found):
        ways = [samples["direct"], samples["two routers"]]
        found["per router"] = bootstrap(
            ways, lambda g: float(np.median(g[1]) - np.median(g[0])) / 2, unit="ms"
        )
    return found


@exp.claim("A-NET-RULES", how=How.LIVE)
def share_that_holds(run: Run[Config]) -> Finding:
    """Return the share of checks that hold, of live and exact ones whichever is lower."""
    table, times = checks(run), latencies(run)
    share = lowest_share(table, "how")
    details = {
        "hosts": str(run.metadata("hosts")["description"]),
        "agents": str(run.config.agents),
        **{f"{group} checks": held for group, held in share.groups.items()},
        **{f"latency, {name}": str(estimate) for name, estimate in times.items()},
        "messages lost once a path was open": str(int(heard(run)["missing"].sum())),
    }
    return Finding(estimate=share.estimate, details=details, reason=share.reason)


AGENT, GROUND = "agent_1", "ground_1"
HEARD, FORBIDDEN, SILENT, MISSING = COLORS["proxy"], COLORS["standard"], "#ececec", COLORS["fourth"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Cell:
    """One name and one domain."""

    name: str  #: The topic on the wire, with ``<agent>`` for its publisher.
    domain: int  #: Where it was listened for.
    heard: float  #: Share of the messages that arrived, of calls that were answered.
    allowed: bool  #: Whether it may be heard there.

    @property
    def color(self) -> str:
        """What it is filled with."""
        if self.heard > 0:
            return HEARD if self.allowed else FORBIDDEN
        return MISSING if self.allowed else SILENT


def cells_of(run: Run[Config], source: str) -> list[Cell]:
    """Return what one party's messages, requests and replies reached, one cell a name and domain."""
    columns = ["name", "domain", "received", "sent", "across"]
    reached = pd.DataFrame([*_topics_of(run, source), *_calls_of(run, source)], columns=columns)
    found = reached.groupby(["name", "domain"], sort=False).agg(
        received=("received", "sum"), sent=("sent", "sum"), across=("across", "first")
    )
    return [
        Cell(
            name=name, domain=domain, heard=received / sent, allowed=in_table_1(name) or not across
        )
        for (name, domain), received, sent, across in found.itertuples()
    ]


def _topics_of(run: Run[Config], source: str) -> Iterator[Reached]:
    """Yield what a party's messages reached."""
    every = heard(run)[heard(run)["source"] == source]
    for row in every[~every["dds_topic"].str.contains(r"status\d+$")].itertuples():
        yield _shown(row.dds_topic, source), row.hearer_domain, row.received, row.sent, row.across


def _calls_of(run: Run[Config], source: str) -> Iterator[Reached]:
    """Yield requests of a caller and replies of a server: a call that was answered crossed with both."""
    called = calls(run)
    for row in called[(called["caller"] == source) | (called["server"] == source)].itertuples():
        request, reply = halves(str(row.name))
        asks = row.caller == source
        name = _shown(request if asks else reply, row.server)
        yield name, row.server_domain if asks else row.caller_domain, row.answered, 1, row.across


def _shown(dds_name: Any, party: Any) -> str:
    return str(dds_name).replace(str(party), "<agent>")


@exp.figure("routing_border", size=(10, 8))
def draw_border(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw who hears what: one panel for an agent's messages, one for those of the global domain."""
    table, times = checks(run), latencies(run)
    panels = {source: cells_of(run, source) for source in (AGENT, GROUND)}
    domains = sorted({int(str(p.domain)) for p in run["party"].itertuples()})
    names = sorted({c.name for cells in panels.values() for c in cells}, key=_order)
    figure.set_size_inches(10, 1.9 + 0.235 * len(names))
    mosaic: Any = [["agent", "ground", "time"], ["agent", "ground", "key"]]
    axes = figure.subplot_mosaic(mosaic, width_ratios=(1, 1, 0.75), height_ratios=(1, 1.2))
    _draw_matrix(axes["agent"], panels[AGENT], names, [1, GLOBAL, *(d for d in domains if d > 1)])
    _draw_matrix(axes["ground"], panels[GROUND], names, domains)
    axes["agent"].set_title("published in\nan agent's domain, $D_1$", fontsize=9.5)
    axes["ground"].set_title("published in\nthe global domain, $D_0$", fontsize=9.5)
    axes["ground"].set_yticklabels([])
    of_table = sum(in_table_1(name) for name in names)
    for text, first, last in (
        ("Table 1: crosses", 0, of_table),
        ("all else: stays", of_table, len(names)),
    ):
        beside: dict[str, Any] = {"rotation": 270, "ha": "left", "va": "center", "fontsize": 9}
        axes["ground"].text(len(domains) - 0.4, (first + last - 1) / 2, text, **beside)
    _draw_latencies(axes["time"], times)
    _draw_key(axes["key"])
    sums = table.groupby("how")[["held", "checked"]].sum()
    share = ", ".join(f"{row.held} of {row.checked} {row.Index}" for row in sums.itertuples())
    figure.suptitle(f"Only Table 1 of paper A crosses the border: {share} checks hold")
    note(
        figure,
        f"{run.config.rate_hz:g} messages a second and name; exact: policy against a second one",
        run,
    )
    return _twin(panels, table, times)


def _order(name: str) -> tuple[bool, int, str]:
    """Order names by the row of Table 1 that they fall under, those of none last."""
    rows = [i for i, rule in enumerate(TABLE_1) if rule.matches(name)]
    return not rows, rows[0] if rows else 0, name


def _draw_matrix(axes: Axes, cells: list[Cell], names: list[str], domains: list[int]) -> None:
    """Draw where each name was heard; the first column is the publisher's own domain."""
    from matplotlib.patches import Rectangle

    by_place = {(cell.name, cell.domain): cell for cell in cells}
    for y, name in enumerate(names):
        for x, domain in enumerate(domains):
            cell = by_place.get((name, domain))
            if cell is not None:
                axes.add_patch(
                    Rectangle((x - 0.44, y - 0.42), 0.88, 0.84, facecolor=cell.color, linewidth=0)
                )
                share = f"{100 * cell.heard:.0f}" if cell.heard > 0 else ""
                axes.text(x, y, share, ha="center", va="center", color="white", fontsize=7)
    axes.axhline(sum(in_table_1(name) for name in names) - 0.5, color="black", linewidth=1)
    axes.axvline(0.5, color="black", linewidth=1, linestyle=(0, (2, 2)))
    axes.set_xticks(range(len(domains)), [f"$D_{d}$" for d in domains])
    axes.set_yticks(range(len(names)), names, fontsize=7.5, family="monospace")
    axes.set(xlim=(-0.5, len(domains) - 0.5), ylim=(len(names) - 0.5, -0.5))
    axes.tick_params(length=0, top=True, labeltop=True, bottom=False, labelbottom=False)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)


def _draw_key(axes: Axes) -> None:
    """Draw what the colours of the matrix mean."""
    from matplotlib.patches import Patch

    meanings = {
        HEARD: "heard, as it may be (%;\nthe first are lost while\nthe path forms)",
        SILENT: "not heard, as it must not be",
        FORBIDDEN: "heard, and must not be",
        MISSING: "not heard, and should be",
    }
    patches = [Patch(facecolor=color, label=text) for color, text in meanings.items()]
    axes.legend(handles=patches, loc="upper left", fontsize=8, title="in the domain of the column")
    axes.axis("off")


def _draw_latencies(axes: Axes, times: dict[str, Any]) -> None:
    """Draw the median time from publishing to receiving, by what lies between, with its interval."""
    shown = {name: e for name, e in times.items() if name != "per router"}
    values = [e.value for e in shown.values()]
    spread = [[e.value - e.low for e in shown.values()], [e.high - e.value for e in shown.values()]]
    bars = axes.barh(
        list(shown), values, color=COLORS["network"], xerr=spread, capsize=3, height=0.5
    )
    axes.bar_label(bars, labels=[f"{v:.1f}" for v in values], padding=14, fontsize=8)
    axes.invert_yaxis()
    axes.margins(x=0.4, y=0.15)
    axes.set_xlabel("from publishing to receiving (ms),\nmedian with 95 % interval", fontsize=8.5)
    axes.grid(visible=False, axis="y")
    added = times.get("per router")
    said = (
        ""
        if added is None
        else f":\na router adds {added.value:.1f} ms [{added.low:.1f}, {added.high:.1f}]"
    )
    axes.set_title(f"all names sent at once{said}", fontsize=9.5)


def _twin(panels: dict[str, list[Cell]], table: Any, times: dict[str, Any]) -> dict[str, Any]:
    return {
        "heard": {
            source: {f"{cell.name} in D_{cell.domain}": round(cell.heard, 4) for cell in cells}
            for source, cells in panels.items()
        },
        "checks": {
            row.check: {"how": row.how, "checked": int(row.checked), "held": int(row.held)}
            for row in table.itertuples()
        },
        "latency_ms": {
            name: {"value": e.value, "low": e.low, "high": e.high} for name, e in times.items()
        },
    }

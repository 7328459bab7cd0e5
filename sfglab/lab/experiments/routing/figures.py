"""Table 1 and Eq. 1 of paper A at a glance: every name, and in which domains its messages were heard."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from sfglab.fleet.policy import TABLE_1
from sfglab.lab.checks.routing import in_table_1
from sfglab.lab.experiments.routing.analysis import GLOBAL, calls, checks, heard, latencies
from sfglab.lab.experiments.routing.experiment import Config, exp
from sfglab.lab.figures import COLORS
from sfglab.names import ResourceKind, dds_names

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from sfglab.lab.runs import Run


AGENT, GROUND = "agent_1", "ground_1"
HEARD, FORBIDDEN, SILENT, MISSING = COLORS["proxy"], COLORS["standard"], "#ececec", COLORS["fourth"]
_OWN = {AGENT: "<agent>", GROUND: "<agent>"}


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
    return [*_topic_cells(run, source), *_service_cells(run, source)]


def _topic_cells(run: Run[Config], source: str) -> list[Cell]:
    every = heard(run)[heard(run)["source"] == source]
    rows = every[~every["dds_topic"].str.contains(r"status\d+$")]
    found: dict[tuple[str, int], list[Any]] = {}
    for row in rows.itertuples():
        found.setdefault((str(row.dds_topic), int(str(row.hearer_domain))), []).append(row)
    return [
        Cell(
            name=_shown(name, source),
            domain=domain,
            heard=sum(r.received for r in group) / sum(r.sent for r in group),
            allowed=in_table_1(name) or domain == group[0].source_domain,
        )
        for (name, domain), group in found.items()
    ]


def _service_cells(run: Run[Config], source: str) -> list[Cell]:
    """Return requests of a caller and replies of a server: a call that was answered crossed with both."""
    called = calls(run)
    found: dict[tuple[str, int], list[Any]] = {}
    for row in called[(called["caller"] == source) | (called["server"] == source)].itertuples():
        request, reply = dds_names(str(row.name), ResourceKind.SERVICE)
        asks = row.caller == source
        name = _shown(request if asks else reply, str(row.server))
        domain = row.server_domain if asks else row.caller_domain
        found.setdefault((name, int(str(domain))), []).append(row)
    return [
        Cell(
            name=name,
            domain=domain,
            heard=sum(bool(r.answered) for r in group) / len(group),
            allowed=in_table_1(name) or not group[0].across,
        )
        for (name, domain), group in found.items()
    ]


def _shown(dds_name: str, party: str) -> str:
    return dds_name.replace(party, "<agent>")


@exp.figure("routing_border", size=(12, 8))
def draw_border(figure: Figure, run: Run[Config]) -> dict[str, Any]:
    """Draw who hears what: one panel for an agent's messages, one for those of the global domain."""
    table, times = checks(run), latencies(run)
    panels = {source: cells_of(run, source) for source in (AGENT, GROUND)}
    domains = sorted({int(str(p.domain)) for p in run["party"].itertuples()})
    names = sorted({c.name for cells in panels.values() for c in cells}, key=_order)
    figure.set_size_inches(12, 1.9 + 0.235 * len(names))
    axes = figure.subplot_mosaic(
        [["agent", "ground", "time"], ["agent", "ground", "key"]],
        width_ratios=(1, 1, 0.75),
        height_ratios=(1, 1.2),
    )
    draw_matrix(axes["agent"], panels[AGENT], names, [1, GLOBAL, *(d for d in domains if d > 1)])
    draw_matrix(axes["ground"], panels[GROUND], names, domains)
    axes["agent"].set_title("published in an agent's domain, $D_1$", fontsize=9.5)
    axes["ground"].set_title("published in the global domain, $D_0$", fontsize=9.5)
    axes["ground"].set_yticklabels([])
    _draw_groups(axes["ground"], names, len(domains) - 0.4)
    draw_latencies(axes["time"], times)
    _draw_key(axes["key"])
    sums = table.groupby("how")[["held", "checked"]].sum()
    share = ", ".join(f"{row.held} of {row.checked} {row.Index}" for row in sums.itertuples())
    figure.suptitle(f"What crosses the border (paper A, Table 1 and Eq. 1): {share} checks hold")
    return _twin(panels, table, times)


def _order(name: str) -> tuple[bool, int, str]:
    """Order names by the row of Table 1 that they fall under, those of none last."""
    rows = [i for i, rule in enumerate(TABLE_1) if rule.matches(name)]
    return not rows, rows[0] if rows else 0, name


def draw_matrix(axes: Axes, cells: list[Cell], names: list[str], domains: list[int]) -> None:
    """Draw where each name was heard; the first column is the publisher's own domain."""
    from matplotlib.patches import Rectangle

    by_place = {(cell.name, cell.domain): cell for cell in cells}
    for y, name in enumerate(names):
        for x, domain in enumerate(domains):
            cell = by_place.get((name, domain))
            if cell is None:
                continue
            box = Rectangle((x - 0.44, y - 0.42), 0.88, 0.84, facecolor=cell.color, linewidth=0)
            axes.add_patch(box)
            if cell.heard > 0:
                share = f"{100 * cell.heard:.0f}"
                axes.text(x, y, share, ha="center", va="center", color="white", fontsize=6.5)
    border = sum(in_table_1(name) for name in names) - 0.5
    axes.axhline(border, color="black", linewidth=1)
    axes.axvline(0.5, color="black", linewidth=1, linestyle=(0, (2, 2)))
    axes.set_xticks(range(len(domains)), [f"$D_{d}$" for d in domains])
    axes.set_yticks(range(len(names)), names, fontsize=7.5, family="monospace")
    axes.set(xlim=(-0.5, len(domains) - 0.5), ylim=(len(names) - 0.5, -0.5))
    axes.tick_params(length=0, top=True, labeltop=True, bottom=False, labelbottom=False)
    axes.grid(visible=False)
    axes.spines[:].set_visible(False)


def _draw_groups(axes: Axes, names: list[str], x: float) -> None:
    """Say beside the matrix which names are of Table 1."""
    count = sum(in_table_1(name) for name in names)
    for text, first, last in (("Table 1: crosses", 0, count), ("all else: stays", count, len(names))):
        axes.text(x, (first + last - 1) / 2, text, rotation=270, ha="left", va="center", fontsize=9)


def _draw_key(axes: Axes) -> None:
    """Draw what the colours of the matrix mean."""
    from matplotlib.patches import Patch

    meanings = {
        HEARD: "heard, as it may be (% of messages or calls;\nthe first are lost while the path forms)",
        SILENT: "not heard, as it must not be",
        FORBIDDEN: "heard, and must not be",
        MISSING: "not heard, and should be",
    }
    patches = [Patch(facecolor=color, label=text) for color, text in meanings.items()]
    axes.legend(handles=patches, loc="upper left", fontsize=8, title="in the domain of the column")
    axes.axis("off")


def draw_latencies(axes: Axes, times: dict[str, Any]) -> None:
    """Draw the median time from publishing to receiving, by what lies between, with its interval."""
    shown = {name: e for name, e in times.items() if name != "per router"}
    values = [e.value for e in shown.values()]
    spread = [[e.value - e.low for e in shown.values()], [e.high - e.value for e in shown.values()]]
    bars = axes.barh(list(shown), values, color=COLORS["network"], xerr=spread, capsize=3, height=0.5)
    axes.bar_label(bars, labels=[f"{v:.2f} ms" for v in values], padding=14, fontsize=8)
    axes.invert_yaxis()
    axes.margins(x=0.4, y=0.15)
    axes.set_xlabel("from publishing to receiving, median", fontsize=8.5)
    axes.grid(visible=False, axis="y")
    added = times.get("per router")
    axes.set_title("" if added is None else f"each router adds {added.value:.2f} ms", fontsize=9.5)


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
        "latency_ms": {name: {"value": e.value, "low": e.low, "high": e.high} for name, e in times.items()},
    }

"""The core from its table, and the mapping of Fig. 8."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from sfglab.lab.figures import house_style
from sfglab.lab.paths import find_project
from sfglab.soc import load_graph, map_communication

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from sfglab.lab.experiments.gateways.analysis import Results


def figure_core(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw the core from its table."""
    from matplotlib.figure import Figure

    from sfglab.soc.gateway.drawing import draw_core

    worlds = int(results.explorations["worlds"].sum())
    with house_style():
        figure = Figure(figsize=(14, 5.4))
        draw_core(figure.subplots())
        figure.suptitle(f"The gateway core (paper C, Fig. 4), from its table: {worlds} moments explored")
    return figure, {"worlds": worlds, "violations": int((results.explorations["violation"] != "").sum())}


def figure_mapping(results: Results) -> tuple[Figure, dict[str, Any]]:
    """Draw the example of Fig. 8 in its three stages; the log only says which run it belongs to."""
    from matplotlib.figure import Figure

    from sfglab.soc.graph_drawing import draw_mapping

    graph = load_graph(find_project().data / str(results.config["graph_file"]))
    with house_style():
        figure = Figure(figsize=(14, 5.2))
        draw_mapping(map_communication(graph), figure)
    return figure, {"stages": results.stages.to_dict(orient="list")}

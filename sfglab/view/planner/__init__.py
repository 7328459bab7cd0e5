"""The scene editor in the browser, on viser (extra ``view``). Paper A, section 4.5, Fig. 7.

A thin shell over `sfglab.spatial.scene.Editor`. Pure: `rows` (hierarchy), `fields` and `forms`
(inspector), `looks` (colours and lines), `making` (what the toolbar adds). Threads: `jobs` (all edits, in
order), `watch` (conflicts). Viser: `drawing`, `gizmo`, `viewport`, `panels`, and `server`, which joins them.
"""

from __future__ import annotations

from sfglab.view.planner.server import DEFAULT_PORT, Planner, PlannerError, show_planner

__all__ = ["DEFAULT_PORT", "Planner", "PlannerError", "show_planner"]

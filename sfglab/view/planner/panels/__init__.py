"""The panels around the viewport: hierarchy, inspector, toolbar, timeline and warnings. Thin shells.

Each shows a part of the editor's state in viser's widgets; decisions are in `sfglab.spatial.scene` and in the
pure modules beside this package. Refuses to know each other.
"""

from __future__ import annotations

from sfglab.view.planner.panels.hierarchy import Hierarchy
from sfglab.view.planner.panels.inspector import Inspector
from sfglab.view.planner.panels.timeline import Timeline
from sfglab.view.planner.panels.toolbar import Toolbar
from sfglab.view.planner.panels.warnings import Warnings

__all__ = ["Hierarchy", "Inspector", "Timeline", "Toolbar", "Warnings"]

"""From files to machines: what would change, bringing it there, and going back by a release's name."""

from __future__ import annotations

from sfglab.deploy.rollout.apply import apply_plan, look_and_plan, released, releases, steps
from sfglab.deploy.rollout.plan import Change, FileChange, Plan, Prospect, plan_changes, render_prospects
from sfglab.deploy.rollout.transport import (
    Local,
    Ssh,
    Transport,
    copy_facts,
    detect_over,
    machine_of,
    transport_to,
)

__all__ = [
    "Change",
    "FileChange",
    "Local",
    "Plan",
    "Prospect",
    "Ssh",
    "Transport",
    "apply_plan",
    "copy_facts",
    "detect_over",
    "look_and_plan",
    "machine_of",
    "plan_changes",
    "released",
    "releases",
    "render_prospects",
    "steps",
    "transport_to",
]

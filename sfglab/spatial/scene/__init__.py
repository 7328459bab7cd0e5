"""Scenes: agents, obstacles, zones, trajectories in a tree, edits that can be undone. Paper A, section 4.5.

Bottom up: `objects`, `tree` (a scene as a value), `commands` (edits and undo), `files` (YAML), `conflicts`,
`editor` (all of it behind one object, without a screen).
"""

from __future__ import annotations

from sfglab.spatial.scene.commands import (
    AlignWaypoints,
    Command,
    Move,
    Remove,
    Rename,
    Retime,
    SetPose,
    SetProperty,
    SetScene,
    SetTime,
    Several,
    Stretch,
)
from sfglab.spatial.scene.conflicts import Conflict, Ghost, conflicts
from sfglab.spatial.scene.editor import Change, ChangeKind, Editor
from sfglab.spatial.scene.files import load_scene, read_scene, scene_text
from sfglab.spatial.scene.objects import (
    KINDS,
    ROOT,
    AgentObject,
    Group,
    ObstacleObject,
    Property,
    SceneError,
    SceneObject,
    TrajectoryObject,
    WaypointObject,
    ZoneObject,
    ZoneRule,
)
from sfglab.spatial.scene.tree import SCENE_PROPERTIES, Scene

__all__ = [
    "KINDS",
    "ROOT",
    "SCENE_PROPERTIES",
    "AgentObject",
    "AlignWaypoints",
    "Change",
    "ChangeKind",
    "Command",
    "Conflict",
    "Editor",
    "Ghost",
    "Group",
    "Move",
    "ObstacleObject",
    "Property",
    "Remove",
    "Rename",
    "Retime",
    "Scene",
    "SceneError",
    "SceneObject",
    "SetPose",
    "SetProperty",
    "SetScene",
    "SetTime",
    "Several",
    "Stretch",
    "TrajectoryObject",
    "WaypointObject",
    "ZoneObject",
    "ZoneRule",
    "conflicts",
    "load_scene",
    "read_scene",
    "scene_text",
]

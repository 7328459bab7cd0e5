"""Scenes: agents, obstacles, zones, trajectories in a tree, edits that can be undone. Paper A, section 4.5.

Bottom up: `errors`, `properties`, `objects`, `tree` (a scene as a value), `commands` and `timing` (edits),
`history`, `writing`, `reading` and `files` (YAML), `ghosts`, `conflicts`, `editor` (all of it behind one
object, without a screen).
"""

from __future__ import annotations

from sfglab.spatial.scene.commands import (
    Add,
    Command,
    Move,
    Remove,
    Rename,
    SetPose,
    SetProperty,
    SetScene,
    Several,
)
from sfglab.spatial.scene.conflicts import Conflict, ConflictKind, conflicts
from sfglab.spatial.scene.editor import Change, ChangeKind, Editor
from sfglab.spatial.scene.errors import SceneError
from sfglab.spatial.scene.files import load_scene, save_scene
from sfglab.spatial.scene.ghosts import Ghost, ghosts, time_span_s
from sfglab.spatial.scene.history import History, Step
from sfglab.spatial.scene.objects import (
    KINDS,
    ROOT,
    AgentObject,
    Group,
    ObstacleObject,
    SceneObject,
    TrajectoryObject,
    WaypointObject,
    ZoneObject,
    ZoneRule,
)
from sfglab.spatial.scene.properties import Property
from sfglab.spatial.scene.reading import read_scene
from sfglab.spatial.scene.timing import AlignWaypoints, Retime, SetTime, Stretch
from sfglab.spatial.scene.tree import SCENE_PROPERTIES, Scene
from sfglab.spatial.scene.writing import scene_text

__all__ = [
    "KINDS",
    "ROOT",
    "SCENE_PROPERTIES",
    "Add",
    "AgentObject",
    "AlignWaypoints",
    "Change",
    "ChangeKind",
    "Command",
    "Conflict",
    "ConflictKind",
    "Editor",
    "Ghost",
    "Group",
    "History",
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
    "Step",
    "Stretch",
    "TrajectoryObject",
    "WaypointObject",
    "ZoneObject",
    "ZoneRule",
    "conflicts",
    "ghosts",
    "load_scene",
    "read_scene",
    "save_scene",
    "scene_text",
    "time_span_s",
]

"""Scenes: agents, obstacles, zones, trajectories in a tree, edits that can be undone. Paper A, section 4.5.

Bottom up: `objects`, `tree` (a scene as a value), `commands` (edits and undo), `files` (YAML), `conflicts`,
`editor` (all of it behind one object, without a screen).
"""

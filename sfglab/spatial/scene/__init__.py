"""Scenes: agents, obstacles, zones and trajectories in a tree, with undo and redo. Paper A, section 4.5.

`model` has the objects, `tree` the scene as a value with its rules, `files` its YAML, `editor` the edits, and
`conflicts` warnings and previews.
"""

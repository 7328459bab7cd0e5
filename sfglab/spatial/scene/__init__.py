"""Scenes: agents, obstacles, zones, trajectories in a tree, edits that can be undone. Paper A, section 4.5."""

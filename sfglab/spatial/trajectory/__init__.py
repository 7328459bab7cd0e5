"""Trajectories: timed waypoints in SE(3), and the poses between them. Paper A, section 4.5."""

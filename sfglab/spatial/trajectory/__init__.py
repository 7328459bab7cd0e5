"""Trajectories: timed waypoints in SE(3), what lies between, what they collide with. Paper A, section 4.5."""

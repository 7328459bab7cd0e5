"""Trajectories: timed waypoints in SE(3), what lies between, what they collide with. Paper A, section 4.5.

Bottom up: `path` (waypoints, headings), `motion` (polyline, Catmull-Rom and rates), `limits` (with re-timing),
`clearance` (with shapes), `exchange` (CSV and messages).
"""

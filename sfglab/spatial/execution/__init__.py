"""Execution of trajectories: goals of an action, and a server that simulates an agent.

In paper A, section 4.5, the trajectory inspector sends a trajectory to a configurable ROS 2 action server.
"""

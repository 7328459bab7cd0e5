"""Trajectories carried out: sent to an action's server, and a server that moves a simulated agent.

Paper A, section 4.5: the trajectory inspector publishes to a configurable ROS 2 action server.
"""

"""Actions: goals that take their time, with feedback on the way, a result at the end, and a way to cancel.

As ROS 2 defines them (design.ros2.org, "Actions"), on the services and topics of any node of the bus; made by
`Node.create_action_server` and `Node.create_action_client`. Because they are built of services, a peer must
frame these as rmw_cyclonedds does.
"""

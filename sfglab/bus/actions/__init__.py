"""Actions as ROS 2 defines them (design.ros2.org, "Actions"), on the services and topics of any node.

They are built of services, so a peer must frame these as rmw_cyclonedds does.
"""

"""Actions as ROS 2 defines them (design.ros2.org, "Actions"), on the services and topics of any node.

An action consists of services and topics. The transport of its services decides which peers it reaches; see
`Node.create_service`.
"""

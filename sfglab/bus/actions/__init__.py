"""Actions as ROS 2 defines them (design.ros2.org, "Actions"), on the services and topics of any node."""

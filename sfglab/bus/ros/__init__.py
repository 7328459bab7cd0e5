"""Services and actions of ROS 2's default middleware, rmw_fastrtps; see `services`."""

"""Services and actions of ROS 2's default middleware, beside DDS: see `services`."""

"""DDS behind the bus: Cyclone DDS through its C API, raw CDR, ROS 2 names and types."""

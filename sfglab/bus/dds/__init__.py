"""DDS behind the bus: Cyclone DDS by its C API, raw CDR, ROS 2 names and types."""

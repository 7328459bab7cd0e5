"""sfglab: how multi-robot ROS 2 systems move data, implemented and re-measured.

The three papers share one principle: a message crosses each boundary once. The subpackages are named after their
function; ``DESIGN.md`` lists the subpackage of each section of the papers. The import of this root is fast, because
heavy libraries are imported by the modules that use them.
"""

__all__ = ["__version__"]

__version__ = "0.1.0"

"""sfglab: how multi-robot ROS 2 systems move data, implemented and re-measured.

Three papers, one principle: a message crosses each boundary once. The subpackages are named after what
they do; ``DESIGN.md`` says which section of which paper lives where. Importing this root is cheap: heavy
libraries are imported by the modules that use them.
"""

__all__ = ["__version__"]

__version__ = "0.1.0"

"""Reading and writing of logs.

A log is one MCAP file that `ros2 bag`, Foxglove and Rerun open. It holds messages as they were on the wire,
measurements as rows of tables, and configuration and versions as metadata.

The package also reads files of killed recorders, damaged files and files of other recorders, with limits on the sizes
that a file claims. The libraries do not do this, which explains the size of the package.
"""

from sfglab.record.metadata import run_context
from sfglab.record.parts import Channel, LogError
from sfglab.record.reader import DecodedMessage, LogReader
from sfglab.record.writer import LogWriter

__all__ = [
    "Channel",
    "DecodedMessage",
    "LogError",
    "LogReader",
    "LogWriter",
    "run_context",
]

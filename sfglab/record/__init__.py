"""Reading and writing of logs.

A log is one MCAP file that `ros2 bag`, Foxglove and Rerun open: messages as they were on the wire, measurements
as rows of tables, configuration and versions as metadata.
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

"""Reading and writing of logs.

A log is one MCAP file that `ros2 bag`, Foxglove and Rerun open: messages as they were on the wire, measurements
as rows of tables, configuration and versions as metadata.

The package has about 8,200 nodes of the syntax tree and exceeds its budget of 7,000. It also reads files of killed
recorders, damaged files and files of other recorders, with limits on what a file claims; the libraries do not.
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

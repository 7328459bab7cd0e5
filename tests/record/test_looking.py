"""Logs to look at: topics with rates and sizes, one message, one field over time."""

import numpy as np
import pytest

from sfglab.messages import default_message
from sfglab.record import LogError, LogReader, LogWriter


@pytest.fixture
def log(tmp_path):
    with LogWriter(tmp_path / "a.mcap") as writer:
        for second in range(4):
            scan = default_message("sensor_msgs/msg/LaserScan")
            scan.header.frame_id = "<b>"
            scan.ranges = np.full(20, second + 0.5, np.float32)
            writer.write("/scan", scan, log_time_ns=second * 500_000_000)
    with LogReader(tmp_path / "a.mcap") as reader:
        yield reader


def test_a_log_lists_topics_with_rates_and_sizes_and_gives_one_field_over_time(log):
    head, line = log.overview()
    assert head == ("topic", "type", "messages", "Hz", "bytes")
    assert line[:4] == ("/scan", "sensor_msgs/msg/LaserScan", "4", "2")
    assert int(line[4]) > 80
    assert repr(log) == "<log a.mcap: 4 messages of 1 topics>"
    assert "LaserScan" in log._repr_html_()
    series = log.series("/scan", "ranges[2]")
    assert list(series) == [0.5, 1.5, 2.5, 3.5]
    assert list(series.index) == [0.0, 0.5, 1.0, 1.5]


def test_a_log_shows_a_message_field_by_field(log):
    shown = log.message("/scan", 3)
    assert "ranges: 20 x float32, 3.5 to 3.5" in repr(shown)
    assert "header.stamp.sec" in shown._repr_html_()
    assert "<b>" not in shown._repr_html_()
    with pytest.raises(LogError, match="given message 4, allowed: 0 to 3"):
        log.message("/scan", 4)


@pytest.mark.parametrize("field", ["speed", "ranges[99]", "header", "header.frame_id"])
def test_a_field_that_is_no_number_is_refused_by_the_fields_there_are(log, field):
    with pytest.raises(LogError, match=r"/scan: field: given .*, allowed: a number of header.stamp.sec"):
        log.series("/scan", field)

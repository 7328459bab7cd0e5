import importlib.util
import os
import subprocess
import sys
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.stream_reader import StreamReader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

RERUN = Path(sys.executable).with_name("rerun")
needs_rerun = pytest.mark.skipif(
    importlib.util.find_spec("rerun") is None or not RERUN.exists(),
    reason="rerun-sdk is not installed",
)


def test_the_plain_mcap_library_reads_it_and_every_crc_holds(given):
    with given.open("rb") as stream:
        records = list(StreamReader(stream, validate_crcs=True).records)
    assert sum(type(record).__name__ == "Message" for record in records) == 6
    [end] = [record for record in records if type(record).__name__ == "DataEnd"]
    assert end.data_section_crc != 0
    with given.open("rb") as stream:
        reader = make_reader(stream, validate_crcs=True)
        assert reader.get_header().profile == "ros2"
        assert {(s.encoding, c.message_encoding) for s, c, _ in reader.iter_messages()} == {
            ("ros2msg", "cdr")
        }
        schemas = {schema.name: schema.data for schema in reader.get_summary().schemas.values()}
        assert (
            b"float64 mean_s  # Mean latency, in seconds.\n" in schemas["sfglab_rows/msg/MeterRow"]
        )
        assert {index.compression for index in reader.get_summary().chunk_indexes} == {"zstd"}


@needs_rerun
@pytest.mark.live
@pytest.mark.parametrize("command", [["check", "--full"], ["convert"]])
def test_rerun_opens_it(tmp_path, given, command):
    output = ["-o", str(tmp_path / "run.rrd")] if command == ["convert"] else []
    done = subprocess.run(
        [RERUN, "mcap", *command, *output, given],
        capture_output=True,
        text=True,
        timeout=60,
        check=True,
        env=os.environ
        | {"HOME": str(tmp_path), "XDG_CONFIG_HOME": str(tmp_path), "RUST_LOG": "info"},
    )
    said = done.stdout + done.stderr
    for topic in ("/image", "/tf_static", "/table/meter"):
        assert topic in said


def test_rosbags_reads_it_with_the_types_of_jazzy(given):
    """The first test has the definitions of the log; these are a distribution's own."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(given) as reader:
        found = [(c.msgtype, data) for c, _, data in reader.messages() if c.msgtype in store.types]
    assert len(found) == 5
    for kind, data in found:
        again = bytes(store.serialize_cdr(store.deserialize_cdr(data, kind), kind))
        assert again == data[: len(again)]

"""Record real ROS 2 beside ours into reference logs of their own: ``python tests/ros2/record_baselines.py``.

Two minutes in the profile quick; the machine should have nothing else to do. `make figures` draws them. With an
experiment's name only that is recorded, with fields of its configuration as ``name=value`` behind it; what was
broken off goes on when the same is called again. The validation takes some hours:

    python tests/ros2/record_baselines.py paper transmission
"""

import asyncio
import sys
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import Writer

import sfglab
from sfglab.lab.baselines import PART, compared
from sfglab.lab.bench import Options
from sfglab.lab.experiments import experiment, transmission
from sfglab.lab.notebooks import read_parameters
from sfglab.lab.paths import find_project

PARTS = Options(only=frozenset({PART, "validation"}))


async def record(profile="quick", name="", *changes):
    project = find_project()
    for exp in map(experiment, [name] if name else ("discovery", "latency", "decode_once")):
        path = (
            project.runs / f"{exp.name}_{PART}.mcap"
        )  # beside it is what a broken-off run goes on from
        path.unlink(missing_ok=True)
        run = await exp.run(profile, path=path, options=PARTS, **read_parameters(changes))
        found = transmission.validated(run) if exp is transmission.exp else compared(exp, run)
        sys.stdout.write(f"{path.name}\n{run.skipped(PART)}\n{found.to_string()}\n")
        reference = project.reference_logs / path.name
        packed = path.with_suffix(".packed.mcap")
        pack(path, packed)
        packed.replace(reference)
        path.unlink()


def pack(source: Path, target: Path) -> None:
    """Write a log again, in as few chunks as possible."""
    with source.open("rb") as unpacked, target.open("wb") as packed:
        reader, writer = make_reader(unpacked), Writer(packed)
        writer.start("ros2", f"sfglab {sfglab.__version__}")
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        channels = {}
        for schema, channel, message in reader.iter_messages():
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, number, channel.metadata
                )
            times = {"log_time": message.log_time, "publish_time": message.publish_time}
            writer.add_message(channels[channel.id], data=message.data, **times)
        writer.finish()


if __name__ == "__main__":
    asyncio.run(record(*sys.argv[1:]))

"""Run the experiment `ros2` into its committed logs: ``make ros2``.

    python tests/ros2/record.py PROFILE [PART ...]

The machine should have nothing else to do. Without parts the tests and the baselines are recorded, each into a log
of its own. The part ``transmission`` is that experiment's validation, which takes some hours; if it is
interrupted, the next call continues it.
"""

import asyncio
import sys
from pathlib import Path

sys.path.append(str(Path(__file__).parents[1]))  # where tests find what they share

from mcap.reader import make_reader
from mcap.writer import Writer

import sfglab
from sfglab.lab.bench import Options
from sfglab.lab.experiments import ros2, transmission
from sfglab.lab.paths import find_project


async def record(profile, *parts):
    """Record parts, one after the other."""
    project = find_project()
    for part in parts or ("tests", *ros2.BASELINES):
        exp = transmission.exp if part == "transmission" else ros2.exp
        own = "validation" if part == "transmission" else part
        name = "ros2" if part == "tests" else f"{part}_ros2"
        path = project.runs / f"{name}.mcap"  # beside it is what an interrupted run continues
        path.unlink(missing_ok=True)
        run = await exp.run(profile, path=path, options=Options(only=frozenset({own})))
        sys.stdout.write(f"{path.name}: {run.skipped(own) or 'recorded'}\n")
        if not run.skipped(own):
            pack(path, project.reference_logs / path.name)
        path.unlink()


def pack(source: Path, target: Path) -> None:
    """Write a log again, in as few chunks as possible."""
    with source.open("rb") as unpacked, target.open("wb") as packed:
        reader, writer = make_reader(unpacked), Writer(packed)
        writer.start("ros2", f"sfglab {sfglab.__version__}")
        for record in reader.iter_metadata():
            writer.add_metadata(record.name, record.metadata)
        for file in reader.iter_attachments():
            writer.add_attachment(
                file.create_time, file.log_time, file.name, file.media_type, file.data
            )
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

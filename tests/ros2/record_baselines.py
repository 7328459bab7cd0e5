"""Record real ROS 2 beside ours into reference logs of their own: ``python tests/ros2/record_baselines.py``.

Two minutes in the profile quick; the machine should have nothing else to do. `make figures` draws them. With an
experiment's name only that is recorded, with fields of its configuration as ``name=value`` behind it; what was
broken off goes on when the same is called again. The validation, an hour, and the whole grid, another:

    python tests/ros2/record_baselines.py paper transmission

Whole rounds of `cooperation` once, in both modes, twenty minutes:

    python tests/ros2/record_baselines.py quick cooperation ros2_s=120
"""

import asyncio
import math
import sys
from pathlib import Path

from sfglab.lab.baselines import PART, compared
from sfglab.lab.bench import Options
from sfglab.lab.experiments import cooperation, experiment, transmission
from sfglab.lab.notebooks import read_parameters
from sfglab.lab.paths import find_project
from sfglab.record import LogReader, LogWriter

PARTS = Options(only=frozenset({PART, transmission.validation.TABLE}))


async def record(profile="quick", name="", *changes):
    project = find_project()
    for exp in map(experiment, [name] if name else ("discovery", "latency", "decode_once")):
        path = (
            project.runs / f"{exp.name}_{PART}.mcap"
        )  # beside it is what a broken-off run goes on from
        path.unlink(missing_ok=True)
        run = await exp.run(profile, path=path, options=PARTS, **read_parameters(changes))
        found = (
            transmission.validation.validated(run)
            if exp is transmission.exp
            else compared(exp, run)
        )
        found = run[PART] if exp is cooperation.exp else found
        sys.stdout.write(f"{path.name}\n{run.skipped(PART)}\n{found.to_string()}\n")
        reference = project.reference_logs / path.name
        packed = path.with_suffix(".packed.mcap")
        pack(path, packed)
        packed.replace(reference)
        path.unlink()


def pack(source: Path, target: Path) -> None:
    """Write a log again, in as few chunks as possible."""
    with (
        LogReader(source) as log,
        LogWriter(target, overwrite=True, flush_after_s=math.inf) as packed,
    ):
        for name in log.metadata_names:
            packed.write_metadata(name, log.metadata(name))
        for topic, info in log.topics.items():
            packed.define(info.type_name, log.definition(topic))
        for message in log.messages():
            times = {"log_time_ns": message.log_time_ns, "publish_time_ns": message.publish_time_ns}
            qos = log.offered_qos(message.topic)
            packed.write_raw(message.topic, message.type_name, message.cdr, qos=qos, **times)


if __name__ == "__main__":
    asyncio.run(record(*sys.argv[1:]))

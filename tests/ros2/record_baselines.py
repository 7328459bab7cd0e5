"""Record real ROS 2 beside ours into reference logs of their own: ``python tests/ros2/record_baselines.py``.

Two minutes in the profile quick; the machine should have nothing else to do. `make figures` draws them.
"""

import asyncio
import sys

from sfglab.lab.baselines import PART, compared
from sfglab.lab.bench import Options
from sfglab.lab.experiments import experiment
from sfglab.lab.paths import find_project


async def record(profile="quick"):
    for name in ("discovery", "latency", "decode_once"):
        path = find_project().reference_logs / f"{name}_{PART}.mcap"
        path.unlink(missing_ok=True)
        exp = experiment(name)
        run = await exp.run(profile, path=path, options=Options(only=frozenset({PART})))
        sys.stdout.write(f"{path.name}\n{run.skipped(PART) or compared(exp, run).to_string()}\n")


if __name__ == "__main__":
    asyncio.run(record(*sys.argv[1:]))

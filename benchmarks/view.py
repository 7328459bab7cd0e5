"""The delay that the view's bridge adds to an image, beside Rerun's own call.

A camera publishes raw images of 640 x 360 30 times a second over DDS on loopback. A sink in another process
receives what is drawn. Both arms alternate in rounds, so that other load on the machine affects both. Printed are
percentiles of the time until the sink has an image, and what the bridge adds. The experiment `visualisation`
judges the same measurement with fewer images.

    python benchmarks/view.py --rounds 10 --images 150
"""

from __future__ import annotations

import argparse
import asyncio

import pandas as pd

from sfglab.lab.experiments.visualisation.live import camera_and_sink, time_pictures
from sfglab.lab.testbed import free_port, held_domains
from sfglab.processes import ProcessGroup

SHARES = [0.5, 0.95, 0.99]


async def measure(rounds: int, images: int) -> pd.DataFrame:
    """Return the time of each image by arm, ms."""
    port = free_port()
    with held_domains() as (domain_id,):
        async with ProcessGroup([camera_and_sink(domain_id, port)]):
            taken_ms = await time_pictures(port, domain_id, rounds=rounds, pictures=images)
    return pd.DataFrame(taken_ms)


def main() -> None:
    """Print percentiles by arm."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--rounds", type=int, default=10)
    parser.add_argument("--images", type=int, default=150, help="images of an arm in one round")
    arguments = parser.parse_args()
    times = asyncio.run(measure(arguments.rounds, arguments.images))
    table = times.describe(percentiles=SHARES).T
    table.loc["added"] = table.loc["bridge"] - table.loc["bare"]
    print(table.round(2).to_string())


if __name__ == "__main__":
    main()

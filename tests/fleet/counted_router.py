"""A router's process that tells when asked how many objects of each type it has, its garbage included."""

import asyncio
import gc
from collections import Counter

from sfglab.component import beside, run_component
from sfglab.fleet.router.config import RouterConfig
from sfglab.fleet.router.node import run_router


async def serve(config, report, orders):
    gc.disable()  # so that whatever is not freed at once stays, and is counted
    async with beside(run_router(config, report)):
        while True:
            await orders.get()
            await asyncio.sleep(1.0)  # what leaves has its time to
            report(
                {"is": "counts", "counts": Counter(type(o).__qualname__ for o in gc.get_objects())}
            )


if __name__ == "__main__":
    run_component(RouterConfig, serve)

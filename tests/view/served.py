"""An agent to send trajectories to."""

import asyncio
import threading
from contextlib import contextmanager

from waiting import DEADLINE_S

from sfglab.bus import Node
from sfglab.spatial.execution.server import TrajectoryServer


@contextmanager
def agent_at_work(name, domain_id, action=""):
    """An agent that follows the trajectories of an action, in a thread of its own."""
    ready, ended = threading.Event(), threading.Event()

    async def serve():
        node = Node(name, domain_id=domain_id, interface="lo")
        async with node, TrajectoryServer(node, name, name=action):
            ready.set()
            await asyncio.to_thread(ended.wait)

    thread = threading.Thread(target=lambda: asyncio.run(serve()))
    thread.start()
    try:
        assert ready.wait(DEADLINE_S)
        yield
    finally:
        ended.set()
        thread.join()

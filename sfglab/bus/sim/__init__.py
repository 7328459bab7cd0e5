"""Simulated bus: nodes as in `sfglab.bus`, in a seeded world with virtual time.

Components run here unchanged, and many of them share one process:

```python
async def main(world):
    async with world.node("talker", host="a") as talker, world.node("listener", host="b") as listener:
        publisher = talker.create_publisher("std_msgs/msg/String", "/chatter")
        subscription = listener.create_subscription("std_msgs/msg/String", "/chatter")
        await publisher.wait_for_subscriptions()
        publisher.publish(String(data="hello"))
        print(await subscription.take())

run_simulated(main, seed=1, latency_s=0.01)
```

A node belongs to a host and a domain: a domain of the network (`reach="network"`), or one of the host's
loopback interface (`reach="host"`). `world.connect("a", connected=False)` disconnects a host. The world
has no model of these: computing times of components beyond `Costs`; bytes, rates and losses of links;
lifespans; limits and memory of shared-memory publishers; lists of nodes, so `Graph.nodes()` is empty. It does
not check serialized messages.
"""

from sfglab.bus.sim.loop import DeadlockError, TimeLimitError
from sfglab.bus.sim.settings import Costs
from sfglab.bus.sim.world import World, run_simulated

__all__ = [
    "Costs",
    "DeadlockError",
    "TimeLimitError",
    "World",
    "run_simulated",
]

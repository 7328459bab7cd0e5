"""Zenoh behind the bus, between robots or beside ROS 2 nodes with rmw_zenoh_cpp; extra `zenoh`.

```python
from functools import partial

from sfglab.bus import Node
from sfglab.bus.zenoh.backend import ZenohBackend
from sfglab.bus.zenoh.session import ZenohConfig

hub = ZenohConfig(domain_id=7, connect=("tcp/192.168.1.1:7447",))
async with Node("talker", join=partial(ZenohBackend, hub)) as node:
    publisher = node.create_publisher("std_msgs/msg/String", "/chatter")
```

Keys, tokens, attachments and type hashes are those of rmw_zenoh_cpp (`layout`). A node is a Zenoh session with a
thread, which makes all declarations, calls and sends that may have to wait. Zenoh has no rules for incompatible
QoS; the readers and writers here match by those of DDS. There is no shared memory over Zenoh.
"""
